# SPDX-License-Identifier: GPL-3.0-or-later
"""Why onnxruntime cannot be imported, by what the system's loader says."""

import ctypes
import importlib
import re
import sys
import traceback
from functools import cache

# Parts of the loaders' sentences, in English. On Windows they are in the user's language, see `_windows_error`.
LOADERS = {
    "runtime": ("initialization routine failed",),
    "glibc": ("version `GLIBC", "version `GLIBCXX", "version `CXXABI"),
    "macos": ("which is newer than running OS", "was built for newer macOS"),
    "platform": (
        "not a valid Win32 application",
        "conflicts with this version of Python",
        "invalid ELF header",
        "wrong ELF class",
        "incompatible architecture",
        "wrong architecture",
        "not a mach-o file",
    ),
    "numpy": ("multiarray failed to import", "_ARRAY_API not found", "compiled against API version", "NumPy 1.x"),
    "library": (
        "specified module could not be found",
        "specified procedure could not be found",
        "cannot open shared object file",
        "Library not loaded",
    ),
}
WINDOWS_ERRORS = {1114: "runtime", 193: "platform", 126: "library", 127: "library"}
MISSING_LIBRARY = re.compile(r"(\S+\.so[.\d]*): cannot open shared object file")


@cache
def import_fault(folder: str, version: str | None) -> tuple[str, str] | None:
    """Import onnxruntime: None where that succeeds, else a key of LOADERS, "package" or "damaged", and a name.

    The name is that of a missing library or package, or "". The reason is also printed to the console. folder, version:
    of the onnxruntime that is found; what failed is not tried again while they stay.
    """
    try:
        return None if hasattr(importlib.import_module("onnxruntime"), "InferenceSession") else ("damaged", "")
    except Exception as error:  # A package may raise anything.
        print(f"onnxruntime {version} in {folder} cannot be imported:", file=sys.stderr)
        traceback.print_exc()
        return _kind(error)


def _kind(error: Exception) -> tuple[str, str]:
    if isinstance(error, ModuleNotFoundError) and error.name:
        if error.name.endswith("onnxruntime_pybind11_state"):
            return "platform", ""
        return ("damaged", "") if error.name.startswith("onnxruntime") else ("package", error.name)
    said = str(error)
    for code, kind in WINDOWS_ERRORS.items():
        if (sentence := _windows_error(code)) and sentence in said:
            return kind, ""
    for kind, parts in LOADERS.items():
        if any(part in said for part in parts):
            library = MISSING_LIBRARY.search(said)
            return kind, library[1] if library else ""
    return "damaged", ""


def _windows_error(code: int) -> str:
    """What Windows says about an error, in the user's language; "" on other systems."""
    if sys.platform == "win32":
        return ctypes.FormatError(code).strip()
    return ""
