# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths and names whose bytes are not UTF-8, in real Blender, and texts that are made safe for it at one place."""

import ast
import os
import re
import shutil
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference.runtime.progress import Progress
from tests.support import blender_scenes
from tests.support.exr_files import channels
from tests.support.paths import ROOT

# Two bytes of UTF-8, and two that are none: as many, so that files may be patched.
PLAIN, WRONG = "QQ", b"\xff\xfe"
ODD = os.fsdecode(WRONG)
# Methods of Blender that take a text.
TEXT_METHODS = {"report", "label", "update_stats", "status_text_set", "stamp_data_add_field"}

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="file names are bytes on Linux only")


@pytest.fixture
def cloud(scene, tmp_path):
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.mrpnn.depth_samples = 1
    return blender_scenes.cloud_scene(scene, tmp_path)


def pixels(name: str) -> np.ndarray:
    image = bpy.data.images[name]
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    return values


def refused(door) -> str:
    with pytest.raises(RuntimeError) as caught:
        door()
    return str(caught.value)


def still(path: str):
    def door():
        bpy.context.scene.render.engine = "MRPNN"
        bpy.context.scene.render.filepath = path
        bpy.ops.render.render(write_still=True)

    return door


def test_texts_reach_blender_through_one_module():
    for path in sorted(
        path for folder in ("mrpnn_addon", "operators", "panels") for path in (ROOT / folder).rglob("*.py")
    ):
        if path.name == "text.py" and path.parent.name == "runtime":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in TEXT_METHODS:
                given = [*node.args, *(keyword.value for keyword in node.keywords)]
                assert all(isinstance(value, ast.Constant) for value in given), f"{path}:{node.lineno}"


def test_messages_about_what_is_left_out_have_one_end():
    """Users and docs know such a message by its end, so a sentence does not say it in words of its own."""
    written = []
    for path in sorted(
        path for folder in ("mrpnn_addon", "operators", "panels") for path in (ROOT / folder).rglob("*.py")
    ):
        tree = ast.parse(path.read_text())
        documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        docs = {
            node.body[0].value for node in ast.walk(tree) if isinstance(node, documented) and ast.get_docstring(node)
        }
        written += [
            (path.relative_to(ROOT).as_posix(), node.value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in docs
            if re.search("(left|leaves?) out", node.value)
        ]
    assert written == [
        ("mrpnn_addon/objects/visibility.py", " (left out)"),
        # The plan of `--command mrpnn report`: lights that do not change the picture.
        ("operators/command_actions.py", "  leaves out "),
    ]


def test_safe_texts_show_the_bytes_and_reports_never_raise(addon, capfd):
    text = addon.mrpnn_addon.runtime.text
    assert text.safe_text(f"cloud{ODD} \ud800 café") == r"cloud\xff\xfe \ud800 café"
    assert text.safe_text("a\0b") == r"a\x00b"
    # Nothing to report to.
    text.report(None, "ERROR", f"lost {ODD}")
    assert r"lost \xff\xfe" in capfd.readouterr().err


def test_work_that_goes_on_is_never_said_to_be_done(addon):
    from mrpnn.mrpnn_addon.runtime.text import percent

    told = []
    progress = Progress(lambda fraction, message: told.append(percent(fraction)))
    for stage in ("shadows", "transport", "lattices", "march", "network"):
        progress.expect(stage, 1.0)
        progress.advance(stage, 2.0, seconds=1.0)
    progress.message("more than was expected")
    assert told[-1] == "99%"
    progress.finish()
    assert told[-1] == "100%"


def test_a_file_is_rendered_and_written_whatever_bytes_its_path_has(addon, scene, cloud, tmp_path):
    assert bpy.ops.mrpnn.render() == {"FINISHED"}
    expected = pixels("MRPNN")
    folder = tmp_path / f"folder{ODD}"
    folder.mkdir()
    shutil.move(bpy.path.abspath(cloud.data.filepath), folder / f"cloud{ODD}.vdb")
    cloud.data.filepath = str(folder / f"cloud{ODD}.vdb")
    lost = bpy.data.volumes.new("Lost")
    lost.filepath = str(folder / f"lost{ODD}.vdb")
    blender_scenes.add_object(scene, "Lost", lost)
    blender_scenes.depsgraph().update()
    assert bpy.ops.mrpnn.check() == {"FINISHED"}
    warnings = addon.mrpnn_addon.status.scene_check.last_check().warnings
    assert any("Lost" in warning and "file not found" in warning for warning in warnings)
    layer = folder / f"layer{ODD}.exr"
    assert bpy.ops.mrpnn.render(filepath=str(layer)) == {"FINISHED"}
    np.testing.assert_array_equal(pixels("MRPNN"), expected)
    shutil.copy(layer, tmp_path / "layer.exr")
    assert channels(tmp_path / "layer.exr")
    still(str(folder / f"still{ODD}.png"))()
    assert (folder / f"still{ODD}.png").stat().st_size > 0


@pytest.mark.slow
def test_light_is_baked_into_a_folder_whatever_bytes_its_path_has(addon, scene, cloud, tmp_path):
    folder = tmp_path / f"light{ODD}"
    assert bpy.ops.mrpnn.bake_light(folder=str(folder)) == {"FINISHED"}
    (path,) = folder.rglob("*.vdb")
    assert [data for data in bpy.data.volumes if data.filepath == str(path) and data.grids.load() and len(data.grids)]


@pytest.mark.parametrize("content", [b"", b"not a volume"])
def test_a_file_that_cannot_be_read_is_named_at_every_door(addon, scene, cloud, tmp_path, content):
    path = tmp_path / f"cloud{ODD}.vdb"
    path.write_bytes(content)
    cloud.data.filepath = str(path)
    blender_scenes.depsgraph().update()
    for door in (bpy.ops.mrpnn.check, bpy.ops.mrpnn.render, still(str(tmp_path / "still.png"))):
        message = refused(door)
        assert r"cloud\xff\xfe.vdb" in message and "bug" not in message and "Traceback" not in message
    assert not (tmp_path / "still.png").exists()


def test_grids_beside_one_whose_name_is_not_utf8_are_rendered(addon, scene, cloud, tmp_path):
    openvdb = addon.mrpnn_addon.vdb.openvdb_module.load_openvdb()
    path = bpy.path.abspath(cloud.data.filepath)
    flame = openvdb.FloatGrid()
    flame.name = f"flame{PLAIN}"
    density = openvdb.read(path, "density")
    openvdb.write(str(tmp_path / "two.vdb"), grids=[density, flame])
    (tmp_path / "odd.vdb").write_bytes((tmp_path / "two.vdb").read_bytes().replace(PLAIN.encode(), WRONG))
    cloud.data.filepath = str(tmp_path / "odd.vdb")
    blender_scenes.depsgraph().update()
    assert bpy.ops.mrpnn.render() == {"FINISHED"}
    still(str(tmp_path / "still.png"))()


def saved_with_wrong_names(folder):
    """Opens the file again, with bytes that are not UTF-8 in place of PLAIN."""
    path = folder / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=False)
    path.write_bytes(path.read_bytes().replace(PLAIN.encode(), WRONG))
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.context.scene


def test_names_that_are_not_utf8_are_told(addon, scene, cloud, tmp_path):
    """Of a file that another program wrote: Blender's Python cannot read such names."""
    scene.name = f"Scene{PLAIN}"
    cloud.name = f"Cloud{PLAIN}"
    saved_with_wrong_names(tmp_path)
    doors = {
        "check": bpy.ops.mrpnn.check,
        "render": bpy.ops.mrpnn.render,
        "bake": bpy.ops.mrpnn.bake_light,
        "F12": still(str(tmp_path / "still.png")),
        "composite": lambda: (setattr(bpy.context.scene.render, "engine", "CYCLES"), bpy.ops.mrpnn.composite()),
    }
    for name, door in doors.items():
        message = refused(door)
        assert r"\xff\xfe" in message and "is not UTF-8; rename it" in message, (name, message)
        assert "bug" not in message and "Traceback" not in message


def test_an_animation_tells_names_that_are_not_utf8_in_words(addon, scene, cloud, tmp_path):
    """Of the camera, without which there is no empty picture either."""
    scene.camera.name, scene.frame_end = f"Camera{PLAIN}", 2
    scene = saved_with_wrong_names(tmp_path)
    scene.render.engine, scene.render.filepath = "MRPNN", str(tmp_path / "frame#")
    message = refused(lambda: bpy.ops.render.render(animation=True))
    assert r"Camera\xff\xfe" in message and "rename it" in message and "codec" not in message, message


@pytest.mark.slow
def test_a_scene_whose_name_is_not_utf8_is_compared(addon, scene, cloud, tmp_path):
    scene.name, scene.render.engine = f"Scene{PLAIN}", "MRPNN"
    saved_with_wrong_names(tmp_path)
    bpy.ops.mrpnn.compare(samples=1, ladder=1, scale=25, folder=str(tmp_path / "comparison"))
    assert r"Scene\xff\xfe" in (tmp_path / "comparison" / "report.html").read_text()
