# SPDX-License-Identifier: GPL-3.0-or-later
"""What users are told where onnxruntime does not load: packages on disk, imported by a real Blender's Python."""

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

pytest.importorskip("bpy")

from tests.support.paths import ROOT

# Of the broken packages' module, in the words of the systems' loaders.
DLL = "DLL load failed while importing onnxruntime_pybind11_state: "
OLD_RUNTIME = f"{DLL}A dynamic link library (DLL) initialization routine failed."
NO_DLL = f"{DLL}The specified module could not be found."
OTHER_PYTHON = f"{DLL}Module use of python313.dll conflicts with this version of Python."
NO_LIBRARY = "libgomp.so.1: cannot open shared object file: No such file or directory"
OLD_LINUX = "/lib64/libm.so.6: version `GLIBC_2.38' not found (required by onnxruntime_pybind11_state.so)"
OLD_MACOS = "dlopen(onnxruntime_pybind11_state.so): (built for macOS 14.0 which is newer than running OS)"
NUMPY = "numpy.core.multiarray failed to import"

# Each case: version, source of the package, whether it lies outside of the extensions, and what the message must say.
SHIPPED, NEWER = "shipped", "1.99.0"
RIVAL = 'disable "Rival" in Preferences > Add-ons, and restart Blender'
REINSTALL = "Uninstall MRPNN Volumes, restart Blender, and install the zip for"
STATE = "from .onnxruntime_pybind11_state import *"
CASES = {
    "old runtime, another's": (
        NEWER,
        OLD_RUNTIME,
        False,
        ["onnxruntime 1.99.0 needs a newer Visual C++ runtime", RIVAL],
    ),
    "old runtime, ours": (SHIPPED, OLD_RUNTIME, False, ["needs a newer Visual C++ runtime", "Redistributable (x64)"]),
    "old runtime, elsewhere": (NEWER, OLD_RUNTIME, True, ["newer Visual C++ runtime", "lies in", "remove it there"]),
    "no DLL": (NEWER, NO_DLL, False, ["onnxruntime 1.99.0", RIVAL]),
    "other Python": (NEWER, OTHER_PYTHON, False, ["for another system or another Python", RIVAL]),
    "no library": (SHIPPED, NO_LIBRARY, False, ["system library libgomp.so.1, which", "is missing. Install it"]),
    "old Linux": (SHIPPED, OLD_LINUX, False, ["This Linux is too old", "glibc 2.28 or later"]),
    "old Linux, another's": (NEWER, OLD_LINUX, False, ["This Linux is too old for onnxruntime 1.99.0", RIVAL]),
    "old macOS": (SHIPPED, OLD_MACOS, False, ["This macOS is too old", "macOS 14 or later"]),
    "numpy": (NEWER, NUMPY, False, ["does not work with numpy", RIVAL]),
    "a broken file": (SHIPPED, STATE, False, ["damaged or incomplete", REINSTALL]),
    "a file of another system": (SHIPPED, STATE, False, ["for another system or another Python", REINSTALL]),
    "an empty package": (SHIPPED, "", False, ["damaged or incomplete", REINSTALL]),
    "a package is missing": (
        NEWER,
        "import no_such_package",
        False,
        ["needs the Python package no_such_package", RIVAL],
    ),
    "too old": ("1.9.0", "", True, ["onnxruntime 1.9.0 is too old", "remove it there"]),
}
# Cases that are rendered: one for each way in which the import fails.
RENDERED = ("old runtime, another's", "an empty package", "too old")

SCRIPT = """
    import json, pathlib, sys, time
    import bpy, numpy
    from benchmarks.support.extension import extension
    from inference import RenderCache
    from tests.support import blender_scenes

    folder, root = pathlib.Path(sys.argv[1]), extension()
    check, preview = root.mrpnn_addon.runtime.onnxruntime_version, root.mrpnn_addon.engine.preview
    blender_scenes.cloud_scene(blender_scenes.empty_scene(), folder)
    bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = 16
    searched, said = list(sys.path), {}

    def told(door):
        try:
            door()
        except RuntimeError as error:
            return str(error)

    def shown():
        described = root.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
        camera, settings = described.camera, bpy.context.scene.mrpnn.settings()
        rendered = preview.Preview(described, camera, settings, preview.Prepared(RenderCache()))
        while not rendered.done:
            time.sleep(0.01)
        return rendered.message

    def pixels():
        return numpy.array(bpy.data.images["MRPNN"].pixels[:])

    pictures = []
    for case in json.loads((folder / "cases.json").read_text()):
        sys.path[:] = [case["site"], *searched]
        said[case["name"]] = [check.runtime_problem(), told(bpy.ops.mrpnn.check)]
        if case["rendered"]:
            said[case["name"]] += [told(bpy.ops.mrpnn.render), shown() or None]
            pictures.append(pixels())
        assert check.check_runtime() == [] and numpy.array_equal(pictures[0], pictures[-1])
        # Another start of Blender.
        for name in [name for name in sys.modules if name.partition(".")[0] == "onnxruntime"]:
            del sys.modules[name]
    # One that loads, of another extension: its files are those of this environment.
    sys.path[:] = [sys.argv[2], *searched]
    assert not told(bpy.ops.mrpnn.render)
    numpy.testing.assert_allclose(pixels(), pictures[0], rtol=0.0, atol=1e-5 * pictures[0].max())
    said["newer"] = check.check_runtime()
    (folder / "said.json").write_text(json.dumps(said))
"""


def package(site: Path, version: str, source: str) -> None:
    """A package onnxruntime of a version, whose import runs or, where it is a loader's sentence, says `source`."""
    module = site / "onnxruntime"
    module.mkdir(parents=True)
    raises = source and not source.startswith(("from ", "import "))
    (module / "__init__.py").write_text(f"raise ImportError({source!r})" if raises else source)
    metadata = site / f"onnxruntime-{version}.dist-info" / "METADATA"
    metadata.parent.mkdir()
    metadata.write_text(f"Metadata-Version: 2.1\nName: onnxruntime\nVersion: {version}\n")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="what Linux says of files of other systems")
@pytest.mark.slow
def test_every_reason_is_told_with_what_helps_and_pictures_are_the_same(tmp_path):
    import onnxruntime

    version = {SHIPPED: onnxruntime.__version__}
    extensions = tmp_path / "resources" / "extensions"
    rival = extensions / "user_default" / "rival" / "blender_manifest.toml"
    rival.parent.mkdir(parents=True)
    rival.write_text(f'name = "Rival"\nwheels = ["./wheels/onnxruntime-{NEWER}-cp311-cp311-win_amd64.whl"]\n')
    damaged = extensions / "user_default" / "damaged" / "blender_manifest.toml"
    damaged.parent.mkdir()
    damaged.write_text("name = ")
    cases = []
    for number, (name, (number_of, source, outside, _)) in enumerate(CASES.items()):
        site = (tmp_path if outside else extensions / ".local") / str(number)
        package(site, version.get(number_of, number_of), source)
        cases.append({"name": name, "site": str(site), "rendered": name in RENDERED})
        if name == "a broken file":
            (site / "onnxruntime" / "onnxruntime_pybind11_state.so").write_bytes(b"\x7fELF")
        if name == "a file of another system":
            (site / "onnxruntime" / "onnxruntime_pybind11_state.pyd").write_bytes(b"MZ")
    newer = extensions / ".local" / "newer"
    package(newer, NEWER, "")
    (newer / "onnxruntime" / "__init__.py").unlink()
    (newer / "onnxruntime").rmdir()
    (newer / "onnxruntime").symlink_to(Path(onnxruntime.__file__).parent)
    (tmp_path / "cases.json").write_text(json.dumps(cases))
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(SCRIPT), tmp_path, newer],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "PYTHONPATH": str(ROOT), "BLENDER_USER_RESOURCES": str(tmp_path / "resources")},
    )
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-3000:]
    said = json.loads((tmp_path / "said.json").read_text())
    (warning,) = said.pop("newer")
    assert f'onnxruntime {NEWER} of extension "Rival" is used' in warning
    for name, (problem, *doors) in said.items():
        # The networks run without it.
        assert not any(doors), (name, doors)
        for part in CASES[name][3]:
            assert part in problem, (name, problem)
        # The loader's and Python's words are on the console only.
        assert not [word for word in ("ImportError", "DLL load", "GLIBC_", "cannot open") if word in problem], problem
    assert OLD_RUNTIME in run.stderr
