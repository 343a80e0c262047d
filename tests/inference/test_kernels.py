# SPDX-License-Identifier: GPL-3.0-or-later
"""The library of compiled kernels: structures, loading, cross-compiling, and compilers' checks of what it does."""

import ctypes
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from inference.kernels import structures
from inference.kernels.build import SOURCES, TARGETS, BuildError, build, library_path, this_platform
from inference.kernels.library import Kernels, Unavailable, load_kernels
from tests.support.paths import ROOT

KERNELS = load_kernels()
HEADER = (SOURCES / "kernels.h").read_text()
FUZZ_SECONDS = 60
CHECKED = [
    "-std=c99", "-O1", "-g", "-ffp-contract=off", "-fno-strict-aliasing", "-fPIC", "-shared", "-DVARIANT=baseline",
    "-DMRPNN_ONE_VARIANT", str(SOURCES / "march.c"), str(SOURCES / "dispatch.c"), "-lm"]  # fmt: skip


@pytest.mark.parametrize("name", re.findall(r"^} (\w+);", HEADER, re.MULTILINE))
def test_structures_are_those_of_the_header(name):
    (body,) = re.findall(rf"typedef struct {{([^}}]*)}} {name};", HEADER)
    body = re.sub(r"/\*.*?\*/", "", body, flags=re.DOTALL)
    declared = [re.search(r"(\w+)(\[\w+\])?$", part.strip())[1] for part in re.split(r"[;,]", body) if part.strip()]
    assert [field[0] for field in getattr(structures, name)._fields_] == declared


def test_interfaces_have_one_number():
    assert int(re.search(r"MRPNN_INTERFACE (\d+)", HEADER)[1]) == structures.INTERFACE


def test_a_library_of_another_interface_is_refused(monkeypatch):
    monkeypatch.setattr("inference.kernels.library.INTERFACE", structures.INTERFACE + 1)
    with pytest.raises(Unavailable, match=f"interface {structures.INTERFACE} instead of {structures.INTERFACE + 1}"):
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
@pytest.mark.parametrize("platform", TARGETS)
def test_every_platforms_library_is_built_by_one_command(platform):
    if importlib.util.find_spec("ziglang") is None and not library_path(platform).exists():
        with pytest.raises(BuildError, match="ziglang"):
            build(platform)
        pytest.skip("ziglang is not installed")
    library = build(platform).read_bytes()
    assert len(library) < 1e6
    magic = {"linux-x64": b"\x7fELF", "windows-x64": b"MZ", "macos-arm64": b"\xcf\xfa\xed\xfe"}[platform]
    assert library.startswith(magic)
    if platform == "linux-x64":
        needed = [tuple(map(int, found.split(b"."))) for found in re.findall(rb"GLIBC_([\d.]+)", library)]
        assert max(needed) <= (2, 28)


@pytest.mark.slow
def test_no_content_of_volumes_leads_outside_the_arrays(tmp_path):
    """Under the address and undefined-behaviour sanitizers of gcc, which end the process at a first fault."""
    if shutil.which("gcc") is None or this_platform() != "linux-x64":
        pytest.skip("needs gcc on Linux")
    library = tmp_path / "checked.so"
    subprocess.run(
        ["gcc", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", *CHECKED, "-o", library], check=True
    )
    runtime = subprocess.run(["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True).stdout
    run = subprocess.run(
        [sys.executable, "-m", "tests.support.fuzz_march", library, str(FUZZ_SECONDS)], cwd=ROOT, capture_output=True,
        text=True, timeout=10 * FUZZ_SECONDS,
        env={**os.environ, "LD_PRELOAD": runtime.strip(), "ASAN_OPTIONS": "detect_leaks=0"})  # fmt: skip
    assert run.returncode == 0, run.stderr[-5000:]
    assert int(run.stdout.split()[0]) > 0


def test_pointers_of_structures_are_as_wide_as_the_headers():
    assert ctypes.sizeof(ctypes.c_void_p) == 8
    assert ctypes.sizeof(structures.Gathered) == 8 * len(structures.Gathered._fields_)
