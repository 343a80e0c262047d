# SPDX-License-Identifier: GPL-3.0-or-later
"""The onnxruntime of the Windows zip, under Wine: it loads beside Blender's C++ runtime and computes as on Linux.

Blender's own msvcp140.dll is loaded before any extension's, and 4.2 to 5.0 bring one of Visual Studio 2019.
"""

import importlib.util
import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

import build_extension
from tests.support.paths import ROOT
from tests.support.windows_dlls import compile_c, idle_python

WEIGHTS = ROOT / "inference" / "weights"
NETWORKS = sorted(WEIGHTS.rglob("*.onnx"))
RUNTIMES = {
    version: f"msvc_runtime-{version}.{build}-{python}-{python}-win_amd64.whl"
    for version, build, python in (("14.29", "30133", "cp39"), ("14.44", "35112", "cp311"))
}
# Wine's own copies of these are not used.
NATIVE = "msvcp140,msvcp140_1,vcruntime140,vcruntime140_1=n;mscoree,mshtml="
TYPES = {"tensor(float)": (1, np.float32), "tensor(int32)": (6, np.int32)}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("wine") is None, reason="Wine is not installed; .ci/run installs it"),
    pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="needs ziglang"),
]


@pytest.fixture(scope="module")
def beside(zips, tmp_path_factory):
    """beside(python, runtime, *arguments): the program run beside the zip's wheel for a Python and a C++ runtime."""
    folder = tmp_path_factory.mktemp("windows")
    program = compile_c(
        ROOT / "tests" / "support" / "onnxruntime_check.c", folder / "onnxruntime_check.exe", "-std=c99"
    )
    (package,) = [path for path in zips if "windows_x64" in path.name]
    environment = {**os.environ, "WINEPREFIX": str(folder / "wine"), "WINEDEBUG": "-all", "WINEDLLOVERRIDES": NATIVE}

    def libraries(python: str, runtime: str) -> Path:
        place = folder / f"{python}-{runtime}"
        if place.exists():
            return place
        place.mkdir()
        shutil.copy(program, place)
        with zipfile.ZipFile(package) as archive:
            (name,) = [name for name in archive.namelist() if "onnxruntime-" in name and f"-{python}-" in name]
            wheel = archive.extract(name, place)
        lock = ROOT / "tests" / "package" / "requirements-windows.txt"
        for source in (wheel, build_extension.fetch(build_extension.BUILD / "runtimes" / RUNTIMES[runtime], lock)):
            with zipfile.ZipFile(source) as archive:
                for item in archive.namelist():
                    if item.endswith((".dll", ".pyd")):
                        (place / Path(item).name).write_bytes(archive.read(item))
        idle_python(place / "onnxruntime_pybind11_state.pyd", place)
        return place

    def run(python: str, runtime: str, *arguments) -> tuple[int, str]:
        place = libraries(python, runtime)
        done = subprocess.run(
            ["wine", "onnxruntime_check.exe", *map(str, arguments)],
            cwd=place,
            env=environment,
            capture_output=True,
            text=True,
            timeout=300,
        )
        # Blender's runtime, not that of Wine.
        assert f"{place.name}\\msvcp140.dll" in done.stdout, done.stdout + done.stderr[-2000:]
        return done.returncode, done.stdout

    return run


# Blender 4.2 to 5.0 have Python 3.11, and users may start them beside a newer runtime; 5.1 and later have 3.13.
@pytest.mark.parametrize("python, runtime", [("cp311", "14.29"), ("cp311", "14.44"), ("cp313", "14.44")])
def test_the_zips_onnxruntime_loads_and_gives_the_results_of_linux(beside, tmp_path, python, runtime):
    # What Blender's Python imports.
    assert beside(python, runtime, "onnxruntime_pybind11_state.pyd")[0] == 0
    expected = {path: _case(path, tmp_path / f"{n}") for n, path in enumerate(NETWORKS)}
    status, said = beside(python, runtime, "--run", *(tmp_path / f"{n}" for n in range(len(NETWORKS))))
    assert status == 0, said
    for n, (path, values) in enumerate(expected.items()):
        found = np.fromfile(tmp_path / f"{n}.out", np.float32).reshape(values.shape)
        assert np.abs(found - values).max() <= 1e-5 * np.abs(values).max(), path


def test_a_newer_onnxruntime_does_not_load_beside_the_runtime_of_2019(beside):
    """Why Python 3.11 gets another version. Once this fails, all Pythons may get the same."""
    for library in ("onnxruntime_pybind11_state.pyd", "onnxruntime.dll"):
        status, said = beside("cp313", "14.29", library)
        assert status == 2 and f"{library} does not load" in said


def _case(network: Path, name: Path) -> np.ndarray:
    """Copy a network to NAME.onnx, write random inputs to NAME.in, and return what this system's onnxruntime gives."""
    shutil.copy(network, f"{name}.onnx")
    session = onnxruntime.InferenceSession(network, providers=["CPUExecutionProvider"])
    random, count = np.random.default_rng(0), 64
    (output,) = [found.name for found in session.get_outputs()]
    inputs, content = {}, _text(output) + np.int64(len(session.get_inputs())).tobytes()
    for asked in session.get_inputs():
        kind, dtype = TYPES[asked.type]
        shape = [size if isinstance(size, int) else {"A": 3, "C": 3}.get(size, count) for size in asked.shape]
        # Integers are places in a list of views.
        values = random.random(shape, np.float32) if kind == 1 else random.integers(0, count, shape, dtype)
        inputs[asked.name] = values
        content += _text(asked.name) + np.array([kind, len(shape), *shape], np.int64).tobytes() + values.tobytes()
    Path(f"{name}.in").write_bytes(content)
    return session.run([output], inputs)[0]


def _text(name: str) -> bytes:
    return name.encode().ljust(32, b"\0")
