# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles the kernels into build/kernels/<platform>-<digest of the sources>/ with the `ziglang` package."""

import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from dataclasses import dataclass
from pathlib import Path

SOURCES = Path(__file__).resolve().parent
BUILD = SOURCES.parents[1] / "build" / "kernels"
# Contraction and fast mathematics would make processors differ. Straight-line code is not vectorised: gathering single
# numbers into vectors takes up to twice as long.
FLAGS = (
    "-std=c99",
    "-O3",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-slp-vectorize",
    "-fno-strict-aliasing",
    "-fvisibility=hidden",
    "-Wall",
    "-Wextra",
    "-Wshadow",
    "-Werror",
)
# Kinds of x86-64 processors, in the order of dispatch.c.
X86_VARIANTS = {"baseline": "x86_64", "avx2": "x86_64_v3", "avx512": "x86_64_v4"}
# Files that are compiled once for each kind of processor.
VARYING = (
    "ahead.c",
    "boxes.c",
    "columns.c",
    "flow.c",
    "gather.c",
    "kriging.c",
    "lamps.c",
    "march.c",
    "moments.c",
    "nearby.c",
    "paths.c",
    "photons.c",
    "pixels.c",
    "products.c",
    "pyramid.c",
    "raster.c",
    "sweeps.c",
)


class BuildError(Exception):
    """The library cannot be built here; says why."""


@dataclass(frozen=True)
class Target:
    """A platform that the library is built for.

    triple: of the compiler, with the oldest system that is supported; "" for this platform. tag: of the platform in the
    names of wheels. library: file name. variants: names of the kinds of processors, and the compiler's names of them.
    """

    triple: str
    tag: str
    library: str
    variants: dict[str, str]


# By Blender's names of the platforms. Blender 4.2 needs glibc 2.28 and macOS 11.2.
SHIPPED = {
    "linux-x64": Target("x86_64-linux-gnu.2.28", "manylinux_2_28_x86_64", "mrpnn_kernels.so", X86_VARIANTS),
    "linux-arm64": Target(
        "aarch64-linux-gnu.2.28", "manylinux_2_28_aarch64", "mrpnn_kernels.so", {"baseline": "generic"}
    ),
    "windows-x64": Target("x86_64-windows-gnu", "win_amd64", "mrpnn_kernels.dll", X86_VARIANTS),
    "windows-arm64": Target("aarch64-windows-gnu", "win_arm64", "mrpnn_kernels.dll", {"baseline": "generic"}),
    "macos-x64": Target("x86_64-macos.11.0", "macosx_11_0_x86_64", "mrpnn_kernels.dylib", X86_VARIANTS),
    "macos-arm64": Target("aarch64-macos.11.0", "macosx_11_0_arm64", "mrpnn_kernels.dylib", {"baseline": "apple_m1"}),
}


#: Any other platform, for itself.
NATIVE = "native"
_PROCESSOR = {"amd64": "x64", "x86_64": "x64", "arm64": "arm64", "aarch64": "arm64"}.get(platform.machine().lower())
_TAG = sysconfig.get_platform().replace("-", "_").replace(".", "_")
_VARIANTS = X86_VARIANTS if _PROCESSOR == "x64" else {"baseline": "native"}
TARGETS = SHIPPED | {NATIVE: Target("", _TAG, "mrpnn_kernels.lib", _VARIANTS)}


def this_platform() -> str:
    """The key of TARGETS that this process runs on."""
    system = {"linux": "linux", "win32": "windows", "darwin": "macos"}.get(sys.platform)
    name = f"{system}-{_PROCESSOR}"
    return name if name in SHIPPED else NATIVE


def sources() -> list[Path]:
    """The C files and headers; none where there are headers alone, as in an installed extension."""
    files = sorted(path for path in SOURCES.iterdir() if path.suffix in (".c", ".h"))
    return files if any(path.suffix == ".c" for path in files) else []


def library_path(name: str) -> Path:
    """Path of a platform's library, built from the present sources."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for path in sources():
        digest.update(path.read_bytes())
    return BUILD / f"{name}-{digest.hexdigest()[:16]}" / TARGETS[name].library


def build(name: str) -> Path:
    """Build the library of a platform unless it is there already; returns its path. Raises BuildError."""
    library = library_path(name)
    if library.exists():
        return library
    if importlib.util.find_spec("ziglang") is None:
        raise BuildError("the Python package ziglang, which compiles it, is not installed: pip install ziglang")
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=BUILD) as folder:
        built = _compile(TARGETS[name], Path(folder))
        # Another process may be building the same.
        os.replace(built, library)
    for old in BUILD.glob(f"{name}-*"):
        if old != library.parent:
            shutil.rmtree(old, ignore_errors=True)
    return library


def _compile(target: Target, folder: Path) -> Path:
    objects = []
    for source in sorted(SOURCES.glob("*.c")):
        kinds = target.variants if source.name in VARYING else {"baseline": target.variants["baseline"]}
        for variant, processor in kinds.items():
            objects.append(folder / f"{source.stem}_{variant}.o")
            _zig(
                target,
                folder,
                *FLAGS,
                f"-mcpu={processor}",
                "-fPIC",
                f"-DVARIANT={variant}",
                "-c",
                source,
                "-o",
                objects[-1],
            )
    library = folder / target.library
    name = ["-Wl,-install_name,@rpath/" + target.library] if "macos" in target.triple else []
    _zig(target, folder, "-shared", "-s", *name, *objects, "-o", library)
    if "windows" in target.triple:
        _remove_time(library)
    return library


def _remove_time(library: Path) -> None:
    """Set the time of a Windows library to 0, so that its bytes depend on the sources alone: TimeDateStamp in
    Microsoft's "PE Format".
    """
    content = bytearray(library.read_bytes())
    time = int.from_bytes(content[0x3C:0x40], "little") + 8
    content[time : time + 4] = bytes(4)
    library.write_bytes(content)


def _zig(target: Target, folder: Path, *arguments: str | Path) -> None:
    triple = ["-target", target.triple] if target.triple else []
    command = [sys.executable, "-m", "ziglang", "cc", *triple, *map(str, arguments)]
    environment = {**os.environ, "ZIG_LOCAL_CACHE_DIR": str(folder / "cache")}
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if run.returncode != 0:
        raise BuildError(f"the compiler failed: {(run.stderr or run.stdout).strip()[-2000:]}")
