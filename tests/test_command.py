"""Rendering from the command line: files, messages and exit status."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

# After bpy: its compiled libraries must come first.
import OpenEXR

from . import blender_scenes

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def blend(scene, tmp_path):
    """A saved scene whose cloud is a sequence of two frames, the second one denser."""
    for number in (1, 2):
        density = number * blender_scenes.blob()
        path = blender_scenes.write_vdb(tmp_path, density, blender_scenes.centred(16, 2.0))
        shutil.move(path, tmp_path / f"fog_{number}.vdb")
    cloud, _ = blender_scenes.add_volume(scene, tmp_path / "fog_1.vdb", Density=2.0)
    cloud.data.is_sequence, cloud.data.frame_start, cloud.data.frame_duration = True, 1, 2
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)
    scene.render.resolution_x, scene.render.resolution_y = 20, 16
    scene.mrpnn.depth_samples = 1
    scene.frame_set(1)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    cloud.data.filepath = "//fog_1.vdb"
    bpy.ops.wm.save_mainfile()
    return tmp_path / "scene.blend"


@pytest.fixture
def command(addon):
    return addon.operators.command.main


def files(folder):
    return {name for name in os.listdir(folder) if not name.startswith(("fog_", "scene."))}


def read_exr(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}, dict(file.header())


def test_it_writes_the_frame_that_is_asked_for(command, blend, capsys):
    folder = blend.parent
    assert command(["render", "--output", str(folder / "a.exr")]) == 0
    assert f"wrote {folder / 'a.exr'}" in capsys.readouterr().out
    assert command(["render", "--output", str(folder / "b.exr"), "--frame", "2", "--depth-samples", "2",
                    "--seed", "7", "--threads", "1", "--model", "mrpnn"]) == 0
    first, second = read_exr(folder / "a.exr"), read_exr(folder / "b.exr")
    alphas = [np.clip(channels["ViewLayer.Alpha.A"], 0, 0.999) for channels, _ in (first, second)]
    # Twice the density: twice the optical depth.
    np.testing.assert_allclose(-np.log1p(-alphas[1]), -2 * np.log1p(-alphas[0]), rtol=1e-3, atol=1e-4)
    assert (first[1]["Frame"], second[1]["Frame"]) == (1, 2)
    assert (second[1]["mrpnn.depthSamples"], second[1]["mrpnn.seed"]) == (2, 7)
    assert bpy.context.scene.mrpnn.depth_samples == 1
    assert files(folder) == {"a.exr", "b.exr"}


def test_png_has_the_layers_alpha(command, blend):
    folder = blend.parent
    assert command(["render", "--output", str(folder / "a.png")]) == 0
    assert command(["render", "--output", str(folder / "a.exr")]) == 0
    from PIL import Image
    with Image.open(folder / "a.png") as png:
        alpha = np.asarray(png)[..., 3] / 255.0
    np.testing.assert_allclose(alpha, read_exr(folder / "a.exr")[0]["ViewLayer.Alpha.A"], atol=1 / 255)
    assert files(folder) == {"a.exr", "a.png"}


@pytest.mark.parametrize("arguments, said", [
    ([], "render"),
    (["render"], "--output"),
    (["paint"], "paint"),
    (["render", "--output", "picture.jpg"], "must end in .exr or .png"),
    (["render", "--output", "missing_folder/picture.exr"], "folder of --output does not exist"),
    (["render", "--output", "x.exr", "--depth-samples", "0"], "depth samples"),
    (["render", "--output", "x.exr", "--depth-samples", "many"], "many"),
    (["render", "--output", "x.exr", "--threads", "-1"], "threads"),
    (["render", "--output", "x.exr", "--model", "nothing"], "nothing"),
])
def test_wrong_arguments_are_one_line_and_status_1(command, blend, capsys, monkeypatch, arguments, said):
    monkeypatch.chdir(blend.parent)
    assert command(arguments) == 1
    errors = capsys.readouterr().err
    assert errors.startswith("mrpnn: error: ") and errors.count("\n") == 1 and said in errors
    assert files(blend.parent) == set()


@pytest.mark.parametrize("ending", ["exr", "png"])
def test_a_scene_that_cannot_be_rendered_leaves_the_old_file(command, blend, capsys, ending):
    output = blend.parent / f"out.{ending}"
    output.write_bytes(b"old")
    (blend.parent / "fog_1.vdb").unlink()
    assert command(["render", "--output", str(output)]) == 1
    errors = capsys.readouterr().err
    assert "Volume object \"Cloud\"" in errors and "fog_1.vdb" in errors and errors.count("\n") == 1
    assert output.read_bytes() == b"old" and files(blend.parent) == {output.name}


def test_warnings_go_to_stderr(command, blend, capsys):
    blender_scenes.add_object(bpy.context.scene, "Ground", bpy.data.meshes.new("Ground"))
    assert command(["render", "--output", str(blend.parent / "a.exr")]) == 0
    assert "mrpnn: warning: mesh object \"Ground\"" in capsys.readouterr().err


def test_help_is_status_0(command, capsys):
    assert command(["render", "--help"]) == 0
    assert "--depth-samples" in capsys.readouterr().out


SCRIPT = """
import importlib.util, sys
import bpy
spec = importlib.util.spec_from_file_location("mrpnn", sys.argv[1], submodule_search_locations=[sys.argv[2]])
package = importlib.util.module_from_spec(spec)
sys.modules["mrpnn"] = package
spec.loader.exec_module(package)
package.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[3])
status = package.operators.command.main(["render", "--output", sys.argv[4]])
bpy.ops.mrpnn.render(filepath="//operator.exr")
package.unregister()
sys.exit(status)
"""


def test_a_process_of_its_own_ends_cleanly(blend):
    """As a script would run it: the file is there, nothing leaks and nothing hangs."""
    folder = blend.parent
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(ROOT / "__init__.py"), str(ROOT), str(blend), str(folder / "command.exr")],
        capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "Not freed memory" not in run.stdout + run.stderr
    by_command, by_operator = (read_exr(folder / f"{name}.exr")[0] for name in ("command", "operator"))
    for name, values in by_command.items():
        np.testing.assert_array_equal(values, by_operator[name])
