# SPDX-License-Identifier: GPL-3.0-or-later
"""Sliders in the compositor change lights as a render with other lights does."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes
from tests.support.exr_files import channels

HALF = 2.0**-11


@pytest.fixture
def cloud(scene, tmp_path):
    """A cloud lit by a sun, a lamp and the World."""
    scene.render.resolution_x, scene.render.resolution_y = 24, 18
    scene.mrpnn.depth_samples = 2
    scene.render.engine, scene.render.film_transparent = "MRPNN", True
    blender_scenes.cloud_scene(scene, tmp_path)
    lamp = bpy.data.lights.new("Lamp", "POINT")
    lamp.energy, lamp.color = 60.0, (1.0, 0.6, 0.3)
    blender_scenes.add_object(scene, "Lamp", lamp).location = 1.5, -1.0, 1.0
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.3
    return scene


def relight_node(scene):
    tree = scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.node_tree
    return next(node for node in tree.nodes if node.get("mrpnn_composite") == "relight")


def change_lights():
    """Half the sun, and bluer; three times the lamp; no World."""
    sun, lamp = bpy.data.lights["Sun"], bpy.data.lights["Lamp"]
    sun.energy, sun.color = 0.5 * sun.energy, (0.4, 0.7, 1.0)
    lamp.energy *= 3.0
    bpy.context.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0


def move_sliders(node):
    node.inputs["Sun Strength"].default_value = 0.5
    node.inputs["Sun Color"].default_value = 0.4, 0.7, 1.0, 1.0
    node.inputs["Lamp Strength"].default_value = 3.0
    node.inputs["World Strength"].default_value = 0.0


@pytest.mark.slow
def test_sliders_are_a_render_in_the_changed_light(cloud, tmp_path):
    assert bpy.ops.mrpnn.relight() == {"FINISHED"}
    node = relight_node(cloud)
    before = blender_scenes.rendered(cloud, tmp_path)
    cloud.render.use_compositing = False
    np.testing.assert_allclose(before, blender_scenes.rendered(cloud, tmp_path), atol=HALF * before.max())
    cloud.render.use_compositing = True
    move_sliders(node)
    shown = blender_scenes.rendered(cloud, tmp_path)
    change_lights()
    cloud.render.use_compositing = False
    expected = blender_scenes.rendered(cloud, tmp_path)
    np.testing.assert_allclose(shown, expected, atol=HALF * expected.max())
    assert np.abs(shown - before).max() > 0.05 * expected.max()


def test_a_second_call_keeps_values_and_knows_new_lights(cloud, tmp_path):
    bpy.ops.mrpnn.relight()
    relight_node(cloud).inputs["Sun Strength"].default_value = 0.25
    blender_scenes.add_sun(cloud, "Fill", rotation=(1.0, 0.0, 1.0))
    bpy.ops.mrpnn.relight()
    node = relight_node(cloud)
    assert node.inputs["Sun Strength"].default_value == 0.25 and node.inputs["Fill Strength"].default_value == 1.0
    assert sum(tree.name.startswith("MRPNN Relight") for tree in bpy.data.node_groups) == 1
    assert all(node.inputs[name].is_linked for name in ("Image", "Sun", "Fill", "Lamp", "World"))


def test_light_groups_are_one_light_each(cloud, tmp_path):
    cloud.view_layers[0].lightgroups.add(name="all")
    for name in ("Sun", "Lamp"):
        bpy.data.objects[name].lightgroup = "all"
    assert bpy.ops.mrpnn.relight() == {"FINISHED"}
    node = relight_node(cloud)
    assert [socket.name for socket in node.inputs] == ["Image", "all", "all Strength", "all Color"]
    assert not cloud.view_layers[0].mrpnn.use_pass_lights
    node.inputs["all Strength"].default_value = 2.0
    shown = blender_scenes.rendered(cloud, tmp_path)
    for name in ("Sun", "Lamp"):
        bpy.data.lights[name].energy *= 2.0
    cloud.render.use_compositing = False
    expected = blender_scenes.rendered(cloud, tmp_path)
    np.testing.assert_allclose(shown, expected, atol=HALF * expected.max())


def test_the_volumes_of_a_composite_are_relit(cloud, tmp_path):
    assert bpy.ops.mrpnn.composite(shadows=False) == {"FINISHED"}
    cloud.cycles.samples, cloud.cycles.use_denoising, cloud.cycles.device = 1, False, "CPU"
    assert bpy.ops.mrpnn.relight() == {"FINISHED"}
    move_sliders(relight_node(cloud))
    shown = blender_scenes.rendered(cloud, tmp_path)
    change_lights()
    assert bpy.ops.mrpnn.composite_remove() == {"FINISHED"}
    cloud.render.engine, cloud.render.use_compositing = "MRPNN", False
    expected = blender_scenes.rendered(cloud, tmp_path)
    np.testing.assert_allclose(shown, expected, atol=HALF * expected.max())


def test_passes_of_each_light_are_in_files_and_add_up(cloud, tmp_path):
    layer = cloud.view_layers[0]
    layer.lightgroups.add(name="Lamp")
    layer.mrpnn.use_pass_lights = True
    bpy.data.objects["Sun"].lightgroup = "Lamp"
    blender_scenes.write_multilayer(cloud)
    cloud.render.filepath = str(tmp_path / "f12.exr")
    bpy.ops.render.render(write_still=True)
    bpy.ops.mrpnn.render(filepath=str(tmp_path / "volumes.exr"))
    for name in ("f12", "volumes"):
        found = channels(tmp_path / f"{name}.exr")
        parts = {key.split(".")[1] for key in found if "Combined_" in key}
        # The light's name is that of a group, which another light is in.
        assert parts == {"Combined_Lamp", "Combined_Lamp (light)", "Combined_World"}
        for letter in "RGB":
            whole = sum(found[f"ViewLayer.{part}.{letter}"] for part in parts)
            np.testing.assert_allclose(whole, found[f"ViewLayer.Combined.{letter}"], rtol=1e-4, atol=1e-5)


def test_scenes_without_lights_or_with_another_engine_are_refused(cloud):
    cloud.render.engine = "CYCLES"
    with pytest.raises(RuntimeError, match="choose the render engine"):
        bpy.ops.mrpnn.relight()
    cloud.render.engine = "MRPNN"
    for name in ("Sun", "Lamp"):
        bpy.data.objects.remove(bpy.data.objects[name])
    cloud.world = None
    with pytest.raises(RuntimeError, match="no light"):
        bpy.ops.mrpnn.relight()
