# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames without a volume, without light or with a fault, in animations, stills, the command and the bake."""

import json
import shutil

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference.network import network
from inference.network.baselines import register_baselines
from tests.support import blender_scenes
from tests.support.exr_files import combined

GREY = (0.2, 0.3, 0.4)
# Frames of the sequence, and why three of them show nothing.
WHOLE, DAMAGED, WITHOUT_GRID, MISSING, LAST = 1, 2, 3, 4, 5


@pytest.fixture
def cloud(scene, tmp_path):
    """A sequence of five frames, three of which cannot be shown."""
    scene.render.resolution_x, scene.render.resolution_y = 16, 12
    scene.mrpnn.depth_samples = 1
    scene.render.engine = "MRPNN"
    scene.render.film_transparent = True
    blender_scenes.write_multilayer(scene)
    cloud = blender_scenes.cloud_scene(scene, tmp_path)
    for frame in (WHOLE, LAST):
        shutil.copy(cloud.data.filepath, tmp_path / f"fog_{frame}.vdb")
    (tmp_path / f"fog_{DAMAGED}.vdb").write_bytes(b"half a file")
    other = blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), name="flame")
    shutil.copy(other, tmp_path / f"fog_{WITHOUT_GRID}.vdb")
    data = cloud.data
    data.filepath = str(tmp_path / "fog_1.vdb")
    data.is_sequence, data.frame_start, data.frame_duration = True, 1, LAST
    scene.frame_start, scene.frame_end = WHOLE, LAST
    scene.frame_set(WHOLE)
    return cloud


def animated(scene, folder):
    """What the engine writes of each frame: float32 (H, W, 4)."""
    scene.render.filepath = str(folder / "frame_#")
    bpy.ops.render.render(animation=True)
    frames = range(scene.frame_start, scene.frame_end + 1)
    return {frame: combined(folder / f"frame_{frame}.exr") for frame in frames}


def still(scene, folder, frame):
    """F12 of one frame."""
    scene.frame_set(frame)
    scene.render.filepath = str(folder / "still.exr")
    bpy.ops.render.render(write_still=True)
    return combined(folder / "still.exr")


def keyed(owner, path, values):
    """Set a property in each frame, until another changes it."""
    *parts, name = path.split(".")
    holder = owner
    for part in parts:
        holder = getattr(holder, part)
    for frame, value in values.items():
        setattr(holder, name, value)
        assert holder.keyframe_insert(name, frame=frame)


def warned(capfd):
    """What the engine has said: Blender prints its reports."""
    said = capfd.readouterr()
    return said.out + said.err


def shows(picture):
    return picture[..., 3].max() > 0.1 and picture[..., :3].max() > 0.01


def test_an_animation_goes_on_after_frames_that_show_nothing(addon, scene, cloud, tmp_path):
    frames = animated(scene, tmp_path)
    assert shows(frames[WHOLE]) and shows(frames[LAST])
    for frame in (MISSING, DAMAGED, WITHOUT_GRID):
        assert not frames[frame].any()
        # A still of the same frame is the same picture.
        np.testing.assert_array_equal(still(scene, tmp_path, frame), frames[frame])
        found = addon.mrpnn_addon.status.last_render.last_render()
        assert any(f"frame {frame}" in warning and '"Cloud"' in warning for warning in found.warnings)
        check = addon.mrpnn_addon.status.scene_check.check_scene(blender_scenes.depsgraph())
        assert not check.error and any(f"frame {frame}" in warning for warning in check.warnings)
        assert bpy.ops.mrpnn.render() == {"FINISHED"}
        assert not any(bpy.data.images["MRPNN"].pixels)


def test_such_a_frame_shows_the_world_where_the_film_is_not_transparent(addon, scene, cloud, tmp_path):
    scene.render.film_transparent = False
    background = scene.world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value, background.inputs["Strength"].default_value = (*GREY, 1.0), 1.0
    found = still(scene, tmp_path, MISSING)
    np.testing.assert_allclose(found, np.broadcast_to((*GREY, 1.0), found.shape), rtol=1e-6)


def test_other_volumes_are_rendered_in_such_a_frame(addon, scene, cloud, tmp_path):
    path = blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 1.0))
    blender_scenes.add_volume(scene, path, "Other")
    assert still(scene, tmp_path, MISSING)[..., 3].any()
    found = addon.mrpnn_addon.status.last_render.last_render()
    assert any("fog_4.vdb" in warning and '"Cloud"' in warning for warning in found.warnings)


@pytest.mark.parametrize(
    "path, off", [("hide_render", True), ("visible_camera", False), ("scale", (0.0, 0.0, 0.0)), ("hide_viewport", True)]
)
def test_a_volume_may_vanish_by_keyframes(addon, scene, cloud, tmp_path, path, off):
    on = tuple(getattr(cloud, path)) if path == "scale" else getattr(cloud, path)
    cloud.data.is_sequence = False
    keyed(cloud, path, {1: on, 2: off, 3: on})
    scene.frame_end = 3
    frames = animated(scene, tmp_path)
    assert shows(frames[1]) and shows(frames[3])
    if path == "hide_viewport":
        # Renders show it.
        assert shows(frames[2])
    else:
        assert not frames[2].any() and not still(scene, tmp_path, 2).any()
    scene.frame_set(2)
    assert bpy.ops.mrpnn.render() == {"FINISHED"}
    found = addon.mrpnn_addon.status.last_render.last_render()
    assert any("frame 2" in warning and '"Cloud"' in warning for warning in found.warnings)
    assert not any(bpy.data.images["MRPNN"].pixels)


LIGHTS = {
    "strength": lambda scene: keyed(scene.objects["Sun"].data, "energy", {1: 1.0, 2: 0.0}),
    "hidden": lambda scene: keyed(scene.objects["Sun"], "hide_render", {1: False, 2: True}),
    "world": lambda scene: world_alone(scene),
    "glow": lambda scene: glow_alone(scene),
}


def world_alone(scene):
    bpy.data.objects.remove(scene.objects["Sun"])
    keyed(scene.world.node_tree.nodes["Background"].inputs["Strength"], "default_value", {1: 1.0, 2: 0.0})


def glow_alone(scene):
    bpy.data.objects.remove(scene.objects["Sun"])
    shader = scene.objects["Cloud"].data.materials[0].node_tree.nodes["Principled Volume"]
    keyed(shader.inputs["Emission Strength"], "default_value", {1: 1.0, 2: 0.0})


@pytest.mark.parametrize("lamp", LIGHTS)
def test_without_light_a_frame_is_black_with_its_alpha(addon, scene, cloud, tmp_path, lamp):
    """As Cycles shows it."""
    cloud.data.is_sequence = False
    LIGHTS[lamp](scene)
    scene.frame_end = 2
    frames = animated(scene, tmp_path)
    assert shows(frames[1])
    assert not frames[2][..., :3].any()
    # A volume that glows is shaded with finer voxels.
    np.testing.assert_allclose(frames[2][..., 3], frames[1][..., 3], atol=1e-4)
    np.testing.assert_array_equal(still(scene, tmp_path, 2), frames[2])
    found = addon.mrpnn_addon.status.last_render.last_render()
    assert any("frame 2 is black" in warning for warning in found.warnings)
    assert lamp not in ("strength", "hidden") or any('"Sun"' in warning for warning in found.warnings)
    if lamp == "strength":
        cycles = blender_scenes.render_cycles(scene, tmp_path, samples=32)
        assert not cycles[..., :3].any()
        assert abs(cycles[..., 3].mean() / frames[2][..., 3].mean() - 1.0) < 0.1


def test_light_groups_without_light_are_black(addon, scene, cloud, tmp_path):
    view_layer = scene.view_layers[0]
    view_layer.lightgroups.add(name="Key")
    scene.objects["Sun"].lightgroup = "Key"
    scene.objects["Sun"].hide_render = True
    found = still(scene, tmp_path, WHOLE)
    assert not found[..., :3].any() and found[..., 3].max() > 0.1


def test_a_still_of_a_file_that_does_not_exist_is_an_error(addon, scene, cloud, tmp_path):
    for gone, sequence in (("gone.vdb", False), ("gone_1.vdb", True)):
        cloud.data.filepath, cloud.data.is_sequence = str(tmp_path / gone), sequence
        with pytest.raises(RuntimeError, match=gone):
            still(scene, tmp_path, WHOLE)
        with pytest.raises(RuntimeError, match=gone):
            bpy.ops.mrpnn.render()
    scene.frame_end = 2
    assert not any(picture.any() for picture in animated(scene, tmp_path).values())
    bpy.data.objects.remove(cloud)
    with pytest.raises(RuntimeError, match="shows no Volume object"):
        still(scene, tmp_path, WHOLE)
    assert not any(picture.any() for picture in animated(scene, tmp_path).values())


def test_a_view_layer_without_a_volume_that_cycles_would_show_stays_empty(addon, scene, cloud, tmp_path):
    scene.view_layers.new("Other")
    cloud.data.is_sequence = False
    held = bpy.data.collections.new("Held")
    scene.collection.children.link(held)
    held.objects.link(cloud)
    scene.collection.objects.unlink(cloud)
    scene.view_layers["Other"].layer_collection.children["Held"].indirect_only = True
    scene.render.filepath = str(tmp_path / "layers.exr")
    bpy.ops.render.render(write_still=True)
    assert shows(combined(tmp_path / "layers.exr", "ViewLayer."))
    assert not combined(tmp_path / "layers.exr", "Other.").any()


def test_composited_volumes_may_be_absent_from_frames(addon, scene, cloud, tmp_path):
    scene.cycles.samples, scene.cycles.device = 1, "CPU"
    scene.frame_end = MISSING
    assert bpy.ops.mrpnn.composite() == {"FINISHED"}
    scene.render.filepath = str(tmp_path / "frame_#")
    bpy.ops.render.render(animation=True)
    assert (tmp_path / f"frame_{WHOLE}.exr").is_file() and (tmp_path / f"frame_{MISSING}.exr").is_file()


@pytest.fixture
def breaks(addon, monkeypatch):
    """A network that cannot be loaded the second time, as a bug would have it."""
    register_baselines()
    loaded = []

    def load():
        loaded.append(None)
        if len(loaded) == 2:
            raise ZeroDivisionError("in frame 2")
        return network._systems["single-scattering"]()

    monkeypatch.setitem(network._systems, "breaks", load)
    return load


def test_an_animation_goes_on_after_a_bug(addon, scene, cloud, tmp_path, breaks, capfd):
    cloud.data.is_sequence = False
    scene.view_layers[0].use_pass_z = True
    scene.mrpnn.model, scene.frame_end = "breaks", 3
    frames = animated(scene, tmp_path)
    assert shows(frames[1]) and not frames[2].any() and shows(frames[3])
    said = warned(capfd)
    assert "frame 2 is an empty picture: MRPNN failed, which is a bug: ZeroDivisionError" in said


@pytest.fixture
def command(addon):
    return addon.operators.command.main


def test_the_command_renders_every_frame(command, scene, cloud, tmp_path, capsys):
    arguments = ["--output", str(tmp_path / "a#.exr"), "--frames", "1-5", "--json", str(tmp_path / "facts.json")]
    assert command(["render", *arguments]) == 0
    said = capsys.readouterr().err
    for frame in range(WHOLE, LAST + 1):
        alpha = combined(tmp_path / f"a{frame}.exr")[..., 3]
        assert alpha.any() == (frame in (WHOLE, LAST))
        assert (f"frame {frame}" in said) == (frame not in (WHOLE, LAST))
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert [one["frame"] for one in facts["frames"]] == [1, 2, 3, 4, 5] and facts["error"] is None
    # The current frame alone, too.
    scene.frame_set(MISSING)
    assert command(["render", "--output", str(tmp_path / "one.exr")]) == 0
    assert command(["render", "--output", str(tmp_path / "none.exr"), "--strict"]) == 1
    assert not (tmp_path / "none.exr").exists() and "fog_4.vdb" in capsys.readouterr().err
    assert command(["report"]) == 0
    # What never changes is an error, alone.
    cloud.data.filepath, cloud.data.is_sequence = str(tmp_path / "gone.vdb"), False
    assert command(["render", "--output", str(tmp_path / "none.exr")]) == 1
    assert command(["render", "--output", str(tmp_path / "none#.exr"), "--frames", "1-2"]) == 0
    assert not (tmp_path / "none.exr").exists() and not combined(tmp_path / "none1.exr").any()


def test_a_bug_in_one_frame_of_the_command_ends_in_status_1(command, scene, cloud, tmp_path, capsys, breaks):
    cloud.data.is_sequence = False
    scene.mrpnn.model = "breaks"
    facts = tmp_path / "facts.json"
    arguments = ["--output", str(tmp_path / "a#.exr"), "--frames", "1-3", "--json", str(facts)]
    assert command(["render", *arguments]) == 1
    assert [(tmp_path / f"a{frame}.exr").exists() for frame in (1, 2, 3)] == [True, False, True]
    found = json.loads(facts.read_text())
    assert "1 of 3 frames failed: frame 2: MRPNN failed, which is a bug" in found["error"]
    assert found["error"] in capsys.readouterr().err


def test_the_bake_goes_on_after_frames_that_show_nothing(command, scene, cloud, tmp_path, capsys):
    folder, saved = tmp_path / "light", tmp_path / "lit.blend"
    arguments = ["--frames", "1-5", "--folder", str(folder), "--save", str(saved), "--no-directions"]
    assert command(["bake", *arguments]) == 0
    assert sorted(path.stem[-4:] for path in folder.glob("*.vdb")) == ["0001", "0005"]
    said = capsys.readouterr().err
    assert all(f"frame {frame}" in said for frame in (MISSING, DAMAGED, WITHOUT_GRID))
    bpy.ops.wm.open_mainfile(filepath=str(saved))
    light = bpy.data.objects["Cloud Light"].data
    loads = []
    for frame in range(WHOLE, LAST + 1):
        bpy.context.scene.frame_set(frame)
        shown = blender_scenes.depsgraph().objects["Cloud Light"].data.grids
        # Blender says that it cannot in a frame after one without a file.
        shown.load()
        loads.append(len(shown) > 0)
    assert loads == [True, False, False, False, True] and light.is_sequence
    # A frame without a volume has no light to bake.
    assert command(["bake", "--frames", str(MISSING), "--folder", str(tmp_path / "none"), "--save", str(saved)]) == 0
    assert not (tmp_path / "none").exists()
