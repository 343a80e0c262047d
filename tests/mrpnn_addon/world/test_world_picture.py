# SPDX-License-Identifier: GPL-3.0-or-later
"""Worlds rendered by Cycles: against the nodes evaluated in numpy, and the sun discs of skies."""

import importlib
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import SceneError
from tests.support import blender_scenes


@pytest.fixture
def pictures(addon):
    return importlib.import_module("mrpnn.mrpnn_addon.world.picture")


def shown(scene, pictures):
    depsgraph = blender_scenes.depsgraph()
    return pictures.world_picture(scene.world.evaluated_get(depsgraph), depsgraph.scene)


def feed(scene, kind, output=0):
    tree = scene.world.node_tree
    node = tree.nodes.new(kind)
    tree.links.new(node.outputs[output], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = 1.0
    return node


def test_a_picture_equals_the_evaluated_nodes(scene, pictures):
    """Colours that follow the direction, whatever the camera is shown, and without the World's fog."""
    environment, world = (importlib.import_module(f"mrpnn.mrpnn_addon.world.{name}") for name in ("sphere", "lighting"))
    tree, coordinates = scene.world.node_tree, feed(scene, "ShaderNodeTexCoord", "Generated")
    assert coordinates.outputs["Generated"].is_linked
    sphere = environment.Sphere(32)
    expected = world._radiance(scene.world, tree.get_output_node("CYCLES"), sphere)
    mixed, path, black = (tree.nodes.new(f"ShaderNode{name}") for name in ("MixShader", "LightPath", "Background"))
    black.inputs["Strength"].default_value = 0.0
    tree.links.new(path.outputs["Is Camera Ray"], mixed.inputs[0])
    tree.links.new(tree.nodes["Background"].outputs[0], mixed.inputs[1])
    tree.links.new(black.outputs[0], mixed.inputs[2])
    output = tree.get_output_node("CYCLES")
    tree.links.new(mixed.outputs[0], output.inputs["Surface"])
    tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], output.inputs["Volume"])
    picture = shown(scene, pictures)
    assert not len(picture.suns)
    np.testing.assert_allclose(np.maximum(picture.radiance(sphere.directions), 0.0), expected, atol=0.02)
    # It is kept until something visible changes.
    assert shown(scene, pictures) is picture
    tree.nodes["Background"].location = 100.0, 20.0
    assert shown(scene, pictures) is picture


@pytest.mark.slow
def test_the_sun_disc_of_a_sky_becomes_a_sun(scene, pictures):
    sky = feed(scene, "ShaderNodeTexSky")
    sky.sun_elevation, sky.sun_rotation = 0.5, 0.8
    first = shown(scene, pictures)
    (sun,) = first.suns
    assert math.asin(sun[2]) == pytest.approx(0.5, abs=2e-4)
    # Limb darkening makes the disc look a little smaller than it is.
    assert 0.9 * sky.sun_size < sun[6] < sky.sun_size
    sky.sun_rotation, sky.sun_intensity, sky.sun_size = 0.8 + math.pi / 2, 0.25, 4.0 * sky.sun_size
    second = shown(scene, pictures)
    (turned,) = second.suns
    # A quarter of a turn, a quarter of the light, whatever the disc's size.
    assert turned[2] == pytest.approx(sun[2], abs=2e-4) and abs(turned[:2] @ sun[:2]) < 1e-3
    np.testing.assert_allclose(turned[3:6], 0.25 * sun[3:6], rtol=0.03)
    assert turned[6] == pytest.approx(4.0 * sun[6], rel=0.03)
    # The disc is not part of the sky around it.
    assert second.sky.max() < 0.01 * sun[3] / (math.pi * (sky.sun_size / 8) ** 2)


def test_a_sky_lights_a_volume_beside_its_sun(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    bpy.data.objects.remove(scene.objects["Sun"])
    feed(scene, "ShaderNodeTexSky").sun_elevation = 0.5
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    assert not described.warnings
    discs = [sun for sun in described.suns if sun.name.startswith("sun of World")]
    assert len(discs) == 1 and len(described.lights) == 2 and described.environment
    brightest = max(described.suns, key=lambda sun: sun.irradiance.sum())
    assert brightest is discs[0]
    scene.world.cycles_visibility.scatter = False
    with pytest.raises(SceneError, match="no sun"):
        addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def test_a_thread_has_the_world_rendered_and_can_be_cancelled(addon, scene, tmp_path, pictures):
    """Reading starts the World's render beside the volumes; once that is known there is nothing to wait for."""
    reading, loading = (importlib.import_module(f"mrpnn.mrpnn_addon.volumes.{name}") for name in ("reader", "loading"))
    blender_scenes.cloud_scene(scene, tmp_path)
    feed(scene, "ShaderNodeTexSky", "Color").sun_elevation = 0.325
    wanted = reading.VolumeReader().wanted(blender_scenes.depsgraph())
    assert [source.key[0] for source in wanted[1:]] == ["world"]
    stopped = loading.VolumeLoading(reading.VolumeReader(), wanted[1:])
    stopped.stop()
    stopped.wait(30.0)
    assert stopped.done and stopped.cancelled
    assert len(reading.VolumeReader().wanted(blender_scenes.depsgraph())) == 2
    done = loading.VolumeLoading(reading.VolumeReader(), wanted[1:])
    done.wait()
    assert done.error is None
    assert len(reading.VolumeReader().wanted(blender_scenes.depsgraph())) == 1
    assert shown(scene, pictures).sky.max() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("output", ["Is Shadow Ray", "Is Volume Scatter Ray", "Ray Length", "Ray Depth"])
def test_light_paths_have_their_values_for_light_that_volumes_scatter(addon, scene, tmp_path, output):
    """One of two colours lights a thin cloud, the same as in Cycles."""
    blender_scenes.cloud_scene(scene, tmp_path, density=0.5)
    bpy.data.objects.remove(scene.objects["Sun"])
    scene.render.resolution_x = scene.render.resolution_y = 8
    tree = scene.world.node_tree
    mixed, path, red = (tree.nodes.new(f"ShaderNode{name}") for name in ("MixShader", "LightPath", "Background"))
    if output not in path.outputs:
        pytest.skip("this Blender's Light Path has no such output")
    blue = tree.nodes["Background"]
    blue.inputs["Strength"].default_value = 1.0
    blue.inputs["Color"].default_value, red.inputs["Color"].default_value = (0.0, 0.0, 1.0, 1.0), (1.0, 0.0, 0.0, 1.0)
    tree.links.new(path.outputs[output], mixed.inputs[0])
    tree.links.new(blue.outputs[0], mixed.inputs[1])
    tree.links.new(red.outputs[0], mixed.inputs[2])
    tree.links.new(mixed.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    found = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    colour = found.environments[0].radiance.mean(axis=(0, 1))
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=16)[..., :3].mean(axis=(0, 1))
    np.testing.assert_allclose(colour / colour.sum(), expected / expected.sum(), atol=0.02)
    assert any("Ray Depth of 1" in text for text in found.warnings) == (output == "Ray Depth")
