# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake Animation: frames of a turning sun, what a second bake skips, and that a stopped one goes on."""

import json
import os
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes

FRAMES = 3


@pytest.fixture
def turning(scene, tmp_path):
    """A small cloud, and a sun that turns from frame 1 to 3."""
    scene.render.resolution_x = scene.render.resolution_y = 16
    blender_scenes.cloud_scene(scene, tmp_path, density=20.0)
    scene.render.engine = "CYCLES"
    sun = scene.objects["Sun"]
    for frame, angle in ((1, 0.0), (FRAMES, 1.0)):
        sun.rotation_euler[0] = angle
        sun.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_start, scene.frame_end = 1, FRAMES
    scene.frame_set(2)
    return scene


def bake(folder):
    return bpy.ops.mrpnn.bake_animation(folder=str(folder), directional=False)


def shown_files():
    """The file that is shown in each frame."""
    [shown] = [one for one in bpy.context.scene.objects if "mrpnn_light" in one]
    found = []
    for frame in range(1, FRAMES + 1):
        bpy.context.scene.frame_set(frame)
        grids = shown.evaluated_get(blender_scenes.depsgraph()).data.grids
        assert grids.load()
        found.append(os.path.abspath(grids.frame_filepath))
    return found


def contents(paths):
    return [Path(path).read_bytes() for path in paths]


def index(folder):
    return json.loads((folder / "baked_light.json").read_text())["lights"]


def test_each_frame_shows_its_own_light(addon, turning, tmp_path):
    assert bake(tmp_path) == {"FINISHED"}
    assert turning.frame_current == 2 and len(index(tmp_path)) == FRAMES
    files = shown_files()
    assert len(set(contents(files))) == FRAMES
    # Each frame's brightness is its own.
    nodes = turning.objects["Cloud Light"].data.materials[0].node_tree.nodes
    scales = []
    for frame in range(1, FRAMES + 1):
        turning.frame_set(frame)
        evaluated = turning.objects["Cloud Light"].evaluated_get(blender_scenes.depsgraph()).data.materials[0]
        scales.append(evaluated.node_tree.nodes[nodes[0].name].outputs[0].default_value)
    written = {light["file"]: light["scale"] for light in index(tmp_path).values()}
    assert scales == pytest.approx([written[os.path.basename(path)] for path in files], rel=1e-5)


@pytest.mark.slow
def test_frames_that_have_not_changed_are_not_baked_again(addon, turning, tmp_path):
    bake(tmp_path)
    first = contents(shown_files())
    before = {key: light["scale"] for key, light in index(tmp_path).items()}
    # The last frame alone changes.
    sun = turning.objects["Sun"]
    sun.rotation_euler[0] = 1.3
    sun.keyframe_insert("rotation_euler", frame=FRAMES)
    for curve in _curves(sun):
        for point in curve.keyframe_points:
            point.interpolation = "CONSTANT"
    bake(tmp_path)
    second, after = contents(shown_files()), index(tmp_path)
    assert second[0] == first[0] and second[2] != first[2]
    assert set(before) < set(after)


def test_frames_without_a_volume_do_not_count_as_unchanged(addon, turning, tmp_path, capfd):
    cloud = turning.objects["Cloud"]
    for frame in range(1, FRAMES + 1):
        cloud.hide_render = frame == 2
        cloud.keyframe_insert("hide_render", frame=frame)
    for sentence in ("baked the light of 2 of 3 frames; 1 shows", "0 of 3 frames; 2 have not changed; 1 shows"):
        assert bake(tmp_path) == {"FINISHED"}
        assert f"{sentence} no volume" in capfd.readouterr().out


def _curves(shown):
    action = shown.animation_data.action
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    return [
        curve for layer in action.layers for strip in layer.strips for bag in strip.channelbags for curve in bag.fcurves
    ]


@pytest.mark.slow
def test_a_stopped_bake_goes_on(addon, turning, tmp_path):
    """What Esc leaves: an index of the frames that are done."""
    turning.frame_end = 1
    bake(tmp_path)
    [first] = index(tmp_path)
    stamp = os.stat(tmp_path / index(tmp_path)[first]["file"])
    turning.frame_end = FRAMES
    bake(tmp_path)
    assert first in index(tmp_path) and len(index(tmp_path)) == FRAMES
    assert os.stat(shown_files()[0]).st_mtime_ns == stamp.st_mtime_ns


@pytest.mark.slow
def test_the_command_and_the_button_share_what_is_baked(addon, turning, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    command, facts = addon.operators.command.main, tmp_path / "facts.json"
    arguments = ["bake", "--frames", f"1-{FRAMES}", "--no-directions", "--folder", str(tmp_path), "--json", str(facts)]
    assert command(arguments) == 0
    keys = set(index(tmp_path))
    bake(tmp_path)
    assert set(index(tmp_path)) == keys
    assert command(arguments) == 0
    assert [frame["seconds"] for frame in json.loads(facts.read_text())["frames"]] == [0.0] * FRAMES


def test_a_broken_index_is_baked_anew(addon, turning, tmp_path):
    (tmp_path / "baked_light.json").write_text('{"version": 1, "lights": {"a": {"file": 3}}}')
    assert bake(tmp_path) == {"FINISHED"} and len(index(tmp_path)) == FRAMES


@pytest.mark.slow
def test_light_with_other_directions_is_read_back(addon, turning, tmp_path):
    turning.frame_end = 1
    bpy.ops.mrpnn.bake_animation(folder=str(tmp_path))
    [shown] = [one for one in turning.objects if "mrpnn_light" in one]
    names = [(node.bl_idname, node.name) for node in shown.data.materials[0].node_tree.nodes]
    bpy.ops.mrpnn.bake_animation(folder=str(tmp_path))
    [shown] = [one for one in turning.objects if "mrpnn_light" in one]
    assert [(node.bl_idname, node.name) for node in shown.data.materials[0].node_tree.nodes] == names


@pytest.mark.parametrize("frames", [[-1, 0], [1, 3], []])
def test_frames_that_files_cannot_number_are_refused(addon, frames):
    with pytest.raises(addon.inference.scene.SceneError, match="frames"):
        addon.operators.bake.light_frames(frames)
