# SPDX-License-Identifier: GPL-3.0-or-later
"""The library of compiled kernels: structures, loading, cross-compiling, and compilers' checks of what it does."""

import ctypes
import importlib.util
import os
import re
import shutil
import struct
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from inference import Camera, Medium, SceneError, Settings, bake, predict_multiple, render
from inference.kernels import library, structures
from inference.kernels.build import (
    NATIVE,
    SHIPPED,
    SOURCES,
    TARGETS,
    BuildError,
    Target,
    build,
    library_path,
    this_platform,
)
from inference.kernels.library import Kernels, Unavailable, load_kernels
from tests.support.paths import ROOT
from tests.support.volumes import SUN, cloud
from tests.support.windows_dlls import imports

KERNELS = load_kernels()
SOURCE_FILES = [str(path) for path in sorted(SOURCES.glob("*.c"))]
FUZZ_SECONDS = 25
CHECKED = [
    "-std=c99", "-O1", "-g", "-ffp-contract=off", "-fno-strict-aliasing", "-fPIC", "-shared", "-DVARIANT=baseline",
    "-DMRPNN_ONE_VARIANT", *SOURCE_FILES, "-lm"]  # fmt: skip
# Debian's libraries for arm64, and what runs libraries of other platforms.
ARM64 = "/usr/aarch64-linux-gnu"
RUNNERS = {"linux-x64": [], "linux-arm64": ["qemu-aarch64", "-L", ARM64], "windows-x64": ["wine"]}
# What a compiler adds to check what the code does; both end the process at a first fault. gcc checks addresses alone:
# zig finds what is undefined, and to compile both checks takes gcc more than twice as long.
CHECKS = {
    "gcc": ["gcc", "-fsanitize=address"],
    "zig": [sys.executable, "-m", "ziglang", "cc", "-fsanitize=undefined,bounds", "-fsanitize-trap=undefined"],
}


@pytest.mark.slow
def test_structures_lie_in_memory_as_the_compiler_lays_them_out(tmp_path):
    """Sizes, and the places of all fields, of every structure of the headers."""
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    text = "".join((SOURCES / header).read_text() for header in ("kernels.h", "fields.h"))
    names = re.findall(r"^} (\w+);", text, re.MULTILINE)
    assert len(names) > 30
    expected = {}
    for name in names:
        structure = getattr(structures, name)
        expected[f"sizeof({name})"] = ctypes.sizeof(structure)
        for field, *_ in structure._fields_:
            expected[f"offsetof({name}, {field})"] = getattr(structure, field).offset
    # The compiler alone decides: a program to run would have to be linked with zig's libraries, which takes a minute.
    checks = [f'_Static_assert({asked} == {value}, "{asked}");' for asked, value in expected.items()]
    source = tmp_path / "sizes.c"
    source.write_text("\n".join(["#include <stddef.h>", '#include "fields.h"', *checks, ""]))
    command = [sys.executable, "-m", "ziglang", "cc", f"-I{SOURCES}", "-c", source, "-o", tmp_path / "sizes.o"]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr[-5000:]


def test_instances_differ_from_what_they_are_copies_of_where_told():
    """As if each had been made by itself."""
    heights, rng = np.zeros((2, 3), np.float32), np.random.default_rng(0)
    linear, offset = rng.random((3, 3, 3)), rng.random((3, 3))
    kinds = [structures.ShadowMap(heights=heights, rows=rows, columns=3) for rows in (1, 2)]
    found = structures.instances_of(kinds, [1, 0, 1], linear=linear, offset=offset)
    for n, rows in enumerate((2, 1, 2)):
        own = structures.ShadowMap(heights=heights, rows=rows, columns=3, linear=linear[n], offset=offset[n])
        assert bytes(found[n]) == bytes(own)
    assert structures.instances_of([], []) is None


def test_structures_take_numpy_booleans():
    """Without the warning of numpy versions that will refuse them."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert structures.LampSlices(inside=np.bool_(True)).inside == 1


DOORS = {
    "render": lambda: render([(cloud(2), Medium(5.0))], [SUN], CAMERA, Settings(multiple=False)),
    "bake": lambda: bake([(cloud(2), Medium(5.0))], [SUN], CAMERA),
    "predict_multiple": lambda: predict_multiple(cloud(2), Medium(5.0), SUN, np.zeros((1, 3)), np.eye(3)[:1]),
}
CAMERA = Camera(np.eye(4), resolution=(8, 8))


@pytest.mark.parametrize("door", DOORS)
def test_every_door_says_what_to_do_without_the_compiled_part(door, monkeypatch, tmp_path):
    monkeypatch.setattr(library, "_kernels", None)
    monkeypatch.setattr(library.build, "SOURCES", tmp_path)
    with pytest.raises(SceneError, match="compiled part of the renderer cannot be used: .* is missing. Uninstall"):
        DOORS[door]()


@pytest.mark.slow
def test_the_kernels_compile_natively_where_nothing_is_shipped(monkeypatch):
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    monkeypatch.setattr(sys, "platform", "freebsd14")
    assert this_platform() == NATIVE
    assert Kernels(build(NATIVE)).best == KERNELS.best


def test_a_library_of_another_interface_is_refused(monkeypatch):
    monkeypatch.setitem(structures._DEFINED, "INTERFACE", structures.INTERFACE + 1)
    with pytest.raises(Unavailable, match=f"interface {structures.INTERFACE - 1} instead of {structures.INTERFACE}"):
        Kernels(KERNELS.path)


def test_a_file_that_is_no_library_is_refused(tmp_path):
    broken = tmp_path / "mrpnn_kernels.so"
    broken.write_bytes(b"not a library")
    with pytest.raises(Unavailable, match="cannot be loaded"):
        Kernels(broken)


def test_the_best_variant_is_what_the_processor_has():
    if sys.platform != "linux":
        pytest.skip("reads /proc/cpuinfo")
    flags = set(re.search(r"^flags\s*:(.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)[1].split())
    avx512 = {"avx512f", "avx512dq", "avx512cd", "avx512bw", "avx512vl"}
    assert KERNELS.best == (2 if avx512 <= flags else 1 if "avx2" in flags else 0)


@pytest.mark.slow
@pytest.mark.parametrize("platform", SHIPPED)
def test_every_platforms_library_is_built_by_one_command(platform):
    if importlib.util.find_spec("ziglang") is None and not library_path(platform).exists():
        with pytest.raises(BuildError, match="ziglang"):
            build(platform)
        pytest.skip("ziglang is not installed")
    library = build(platform).read_bytes()
    assert len(library) < 1e6
    system = platform.partition("-")[0]
    magic = {"linux": b"\x7fELF", "windows": b"MZ", "macos": b"\xcf\xfa\xed\xfe"}[system]
    assert library.startswith(magic)
    if system == "linux":
        needed = [tuple(map(int, found.split(b"."))) for found in re.findall(rb"GLIBC_([\d.]+)", library)]
        assert max(needed) <= (2, 28)
    if system == "windows":
        # Whatever else it imports, every Windows has.
        assert set(imports(build(platform))) <= {"KERNEL32.dll", "ntdll.dll"} | {
            name for name in imports(build(platform)) if name.startswith("api-ms-win-crt-")
        }
    if system == "macos":
        assert oldest_macos(library) == (11, 0)
    # Each function that Python declares.
    names = ["interface", "best_variant", "scratch_bytes", "march", *structures.FUNCTIONS]
    assert not [name for name in names if b"mrpnn_" + name.encode() not in library]


def oldest_macos(library: bytes) -> tuple[int, int]:
    """The least macOS that loads a library: LC_BUILD_VERSION, see Apple's mach-o/loader.h."""
    (commands,), at = struct.unpack_from("<I", library, 16), 32
    for _ in range(commands):
        kind, size = struct.unpack_from("<2I", library, at)
        if kind == 0x32:
            system, least = struct.unpack_from("<2I", library, at + 8)
            assert system == 1
            return least >> 16, least >> 8 & 0xFF
        at += size
    raise AssertionError("no version")


@pytest.mark.slow
@pytest.mark.parametrize("compiler", CHECKS)
def test_no_content_of_volumes_leads_outside_the_arrays(compiler, tmp_path):
    if this_platform() != "linux-x64" or (compiler == "gcc" and shutil.which("gcc") is None):
        pytest.skip("needs gcc on Linux")
    if compiler == "zig" and importlib.util.find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    library, environment = tmp_path / "checked.so", dict(os.environ)
    subprocess.run([*CHECKS[compiler], *CHECKED, "-o", library], check=True)
    if compiler == "gcc":
        runtime = subprocess.run(
            ["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True
        ).stdout.strip()
        environment |= {"LD_PRELOAD": runtime, "ASAN_OPTIONS": "detect_leaks=0"}
    run = subprocess.run(
        [sys.executable, "-m", "tests.support.fuzz_kernels", library, str(FUZZ_SECONDS)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=10 * FUZZ_SECONDS,
        env=environment,
    )
    assert run.returncode == 0, run.stderr[-5000:]
    assert int(run.stdout.split()[0]) > 0


def known_cases(target: Target, folder: Path) -> Path:
    """The program that runs a library's kernels on cases whose results are known, compiled for a platform."""
    program = folder / f"kernel_check{'.exe' if 'windows' in target.triple else ''}"
    # Optimized as the library, for which zig has built its own libraries already.
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target.triple, "-std=c99", "-O3", f"-I{SOURCES}"]
    subprocess.run([*command, ROOT / "tests" / "support" / "kernel_check.c", "-o", program, "-lm"], check=True)
    return program


@pytest.mark.slow
@pytest.mark.parametrize("platform", RUNNERS)
def test_every_variant_finds_known_results(platform, tmp_path):
    """Under Wine for Windows and under qemu for another processor; it comes without Python."""
    loader = RUNNERS[platform]
    if this_platform() != "linux-x64" or importlib.util.find_spec("ziglang") is None:
        pytest.skip("needs ziglang on Linux")
    if loader and (shutil.which(loader[0]) is None or (platform == "linux-arm64" and not Path(ARM64).is_dir())):
        pytest.skip(f"{loader[0]} is not installed; .ci/run installs it")
    program, library = known_cases(TARGETS[platform], tmp_path), build(platform)
    run = subprocess.run(
        [*loader, program, library],
        capture_output=True,
        text=True,
        timeout=600,
        cwd=tmp_path,
        env={**os.environ, "WINEPREFIX": str(tmp_path / "wine"), "WINEDEBUG": "-all"},
    )
    assert run.returncode == 0, run.stdout + run.stderr[-2000:]
    variants = KERNELS.best + 1 if platform.endswith("x64") else 1
    assert run.stdout.split() == [str(variants), "variants,", "0", "faults"]
