# SPDX-License-Identifier: GPL-3.0-or-later
"""Windows' libraries: which names they import, and a Python library that has those names and does nothing."""

import struct
import subprocess
import sys
from pathlib import Path

TRIPLE = "x86_64-windows-gnu"


def compile_c(source: Path, target: Path, *options: str) -> Path:
    """Compile a C file for Windows; returns `target`."""
    subprocess.run(
        [sys.executable, "-m", "ziglang", "cc", "-target", TRIPLE, *options, source, "-o", target], check=True
    )
    return target


def imports(library: Path) -> dict[str, list[str]]:
    """Names that a 64-bit library imports, by the library that has them; see Microsoft's "PE Format"."""
    content = library.read_bytes()
    header = struct.unpack_from("<I", content, 0x3C)[0] + 4
    (sections,), (optional,) = (
        struct.unpack_from("<H", content, header + 2),
        struct.unpack_from("<H", content, header + 16),
    )
    table = header + 20 + optional
    spans = [struct.unpack_from("<4I", content, table + 40 * n + 8) for n in range(sections)]

    def offset(address: int) -> int:
        (found,) = [address - start + raw for size, start, _, raw in spans if start <= address < start + size]
        return found

    def text(address: int) -> str:
        start = offset(address)
        return content[start : content.index(0, start)].decode()

    found: dict[str, list[str]] = {}
    # The second of the data directories, which begin at byte 112.
    entry = offset(struct.unpack_from("<I", content, header + 20 + 112 + 8)[0])
    while True:
        lookup, _, _, name, _ = struct.unpack_from("<5I", content, entry)
        if not name:
            return found
        names, at = found.setdefault(text(name), []), offset(lookup)
        while value := struct.unpack_from("<Q", content, at)[0]:
            # The highest bit marks an import by number. A name comes after two bytes.
            if not value >> 63:
                names.append(text(value + 2))
            at += 8
        entry += 20


def idle_python(module: Path, folder: Path) -> Path:
    """The pythonXY.dll that a compiled module asks for, made in `folder`: it has all names and does nothing.

    With it Windows loads the module and runs its initialisers, as at an import, short of calling into Python.
    """
    ((name, names),) = [item for item in imports(module).items() if item[0].lower().startswith("python")]
    source = folder / f"{name}.c"
    # Functions are not called, and variables are read as zeros.
    source.write_text("".join(f"__declspec(dllexport) char {export}[512];\n" for export in names))
    return compile_c(source, folder / name, "-shared")
