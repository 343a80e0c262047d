# SPDX-License-Identifier: GPL-3.0-or-later
"""Soft suns and the World as parallel lights, against integrals and Cycles."""

import importlib
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import SceneError
from tests.support import blender_scenes


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


# Soft suns


@pytest.mark.parametrize("degrees, count", [(0.5, 1), (8.0, 4), (30.0, 7), (90.0, 19)])
def test_a_soft_sun_keeps_its_irradiance_and_its_angle(addon, scene, tmp_path, degrees, count):
    blender_scenes.cloud_scene(scene, tmp_path)
    lamp = scene.objects["Sun"].data
    lamp.angle, lamp.energy = math.radians(degrees), 3.0
    described = read(addon)
    assert len(described.suns) == count and not described.warnings
    axis = np.array(scene.objects["Sun"].matrix_world)[:3, 2]
    cosine = np.array([sun.direction @ axis for sun in described.suns])
    light = np.array([sun.irradiance[0] for sun in described.suns])
    # A surface that faces the sun receives its strength; over a uniform cap the mean cosine is that of its middle
    # and rim.
    assert light @ cosine == pytest.approx(3.0, rel=1e-4)
    rim = math.cos(math.radians(degrees) / 2.0)
    assert light @ cosine / light.sum() == pytest.approx(0.5 * (1.0 + rim), rel=1e-4)
    if degrees > 12.0:
        assert light @ cosine**2 / light.sum() == pytest.approx((1.0 + rim + rim**2) / 3.0, rel=5e-3)


@pytest.mark.slow
def test_a_wide_sun_lights_thin_fog_as_much_more_as_in_cycles(addon, scene, tmp_path):
    """Against a sun of angle 0 and the same strength; the fog scatters isotropically and casts almost no shadow."""
    cloud = blender_scenes.cloud_scene(scene, tmp_path, density=0.02)
    cloud.data.materials[0].node_tree.nodes["Principled Volume"].inputs["Anisotropy"].default_value = 0.0
    scene.camera.location.z, scene.camera.data.angle = 6.0, 0.2
    scene.render.resolution_x = scene.render.resolution_y = 16
    seen, light = [], []
    for degrees in (0.0, 120.0):
        scene.objects["Sun"].data.angle = math.radians(degrees)
        light.append(sum(sun.irradiance[0] for sun in read(addon).suns))
        seen.append(blender_scenes.render_cycles(scene, tmp_path, samples=256)[..., :3].mean())
    assert light[1] / light[0] == pytest.approx(4.0 / 3.0, rel=1e-4)
    assert seen[1] / seen[0] == pytest.approx(light[1] / light[0], rel=0.02)


# The World


def fluence(light):
    """(3,) of suns and environments."""
    return light.irradiance if hasattr(light, "irradiance") else light.fluence()


def world_lights(addon):
    return [light for light in read(addon).lights if "World" in light.name]


def background(scene, strength=1.0, colour=(1.0, 1.0, 1.0)):
    node = scene.world.node_tree.nodes["Background"]
    node.inputs["Strength"].default_value, node.inputs["Color"].default_value = strength, (*colour, 1.0)
    return node


def test_a_coloured_world_is_light_from_all_directions(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    background(scene, 0.5, (0.2, 0.4, 0.8))
    found = world_lights(addon)
    assert len(found) == 1 and read(addon).environment
    np.testing.assert_allclose(fluence(found[0]), 0.5 * 4 * math.pi * np.array([0.2, 0.4, 0.8]), rtol=1e-5)
    bpy.data.objects.remove(scene.objects["Sun"])
    assert not read(addon).suns and len(read(addon).lights) == 1
    scene.world.cycles_visibility.scatter = False
    with pytest.raises(SceneError, match="no sun"):
        read(addon)


def test_a_world_that_cannot_be_shown_is_named(addon, scene, tmp_path, monkeypatch):
    blender_scenes.cloud_scene(scene, tmp_path)
    tree, node = scene.world.node_tree, background(scene)
    tree.links.new(tree.nodes.new("ShaderNodeTexSky").outputs["Color"], node.inputs["Color"])
    # A process that fails at its task.
    broken = tmp_path / "broken.py"
    broken.write_text("raise SystemExit('no Cycles here')")
    monkeypatch.setattr(importlib.import_module("mrpnn.mrpnn_addon.world.process"), "WORKER", broken)
    (warning,) = read(addon).warnings
    assert "World" in warning and "Sky Texture" in warning and "no Cycles here" in warning
    assert "its light is not rendered" in warning and not world_lights(addon)
    fog = tree.nodes.new("ShaderNodeVolumeScatter")
    tree.links.new(fog.outputs[0], tree.get_output_node("CYCLES").inputs["Volume"])
    assert any("its fog is not rendered" in text for text in read(addon).warnings)


def panorama(width, height):
    """An environment image with a bright spot on a gradient, float32."""
    image = bpy.data.images.new("Around", width, height, float_buffer=True)
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    colours = np.stack([0.2 + u, 0.3 + v, 0.5 + 0.4 * np.sin(2 * np.pi * u), np.ones_like(u)], axis=2)
    colours[int(0.7 * height), int(0.3 * width), :3] = 40.0
    image.pixels.foreach_set(colours.astype(np.float32).ravel())
    image.pack()
    return image


@pytest.mark.slow
def test_an_environment_image_lights_as_in_cycles(addon, scene, tmp_path):
    """Thin, isotropically scattering fog shows its fluence: radiance = alpha albedo fluence / 4 pi."""
    cloud = blender_scenes.cloud_scene(scene, tmp_path, density=0.1)
    shader = cloud.data.materials[0].node_tree.nodes["Principled Volume"]
    shader.inputs["Anisotropy"].default_value = 0.0
    scene.objects["Sun"].hide_render = True
    tree, node = scene.world.node_tree, background(scene)
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = panorama(512, 256)
    tree.links.new(texture.outputs[0], node.inputs["Color"])
    described = read(addon)
    light = sum(map(fluence, described.lights))
    albedo = described.volumes[0][1].albedo
    scene.camera.location.z, scene.camera.data.angle = 6.0, 0.2
    scene.render.resolution_x = scene.render.resolution_y = 16
    seen = blender_scenes.render_cycles(scene, tmp_path, samples=512).mean(axis=(0, 1))
    # Little light is lost on its way in.
    lost = math.exp(-0.5 * seen[3])
    np.testing.assert_allclose(seen[3] * albedo * light / (4 * math.pi) * lost, seen[:3], rtol=0.06)


def test_cycles_renders_only_worlds_whose_image_cannot_be_read(addon, scene, tmp_path):
    """Whether it has to is found out without reading the image."""
    blender_scenes.cloud_scene(scene, tmp_path)
    scene.objects["Sun"].hide_render = True
    tree, node = scene.world.node_tree, background(scene)
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    tree.links.new(texture.outputs[0], node.inputs["Color"])
    wanted = importlib.import_module("mrpnn.mrpnn_addon.world.lighting").is_wanted
    assert wanted(blender_scenes.depsgraph())
    texture.image = panorama(64, 32)
    assert not wanted(blender_scenes.depsgraph()) and read(addon).environment
    path = tmp_path / "surroundings.exr"
    texture.image.filepath_raw, texture.image.file_format = str(path), "OPEN_EXR"
    texture.image.save()
    texture.image = bpy.data.images.load(str(path))
    assert not wanted(blender_scenes.depsgraph()) and not texture.image.has_data
    texture.image.filepath = str(tmp_path / "missing.exr")
    assert wanted(blender_scenes.depsgraph())


@pytest.mark.slow
def test_directions_are_those_at_which_cycles_sees_the_image(addon, scene, tmp_path):
    """A panoramic camera sees what the nodes give for the direction of each pixel."""
    world = importlib.import_module("mrpnn.mrpnn_addon.world.lighting")
    environment = importlib.import_module("mrpnn.mrpnn_addon.world.sphere")
    tree, node = scene.world.node_tree, background(scene)
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = panorama(64, 32)
    tree.links.new(texture.outputs[0], node.inputs["Color"])
    # Up, forwards and to the right of a camera that looks along its -Z: a narrow view in each direction.
    camera = blender_scenes.add_camera(scene)
    camera.data.angle = 0.02
    blender_scenes.set_up_cycles(scene, samples=16)
    scene.render.resolution_x = scene.render.resolution_y = 2
    for rotation in ((1.2, 0.0, 0.4), (0.3, 0.0, 2.0), (2.0, 0.2, -1.1)):
        camera.rotation_euler = rotation
        bpy.context.view_layer.update()
        seen = blender_scenes.rendered(scene, tmp_path, transparent=False)[..., :3].mean(axis=(0, 1))
        sphere = environment.Sphere(2)
        sphere.directions = -np.array(camera.matrix_world)[None, :3, 2]
        found = world._radiance(scene.world, tree.get_output_node("CYCLES"), sphere)
        np.testing.assert_allclose(found[0], seen, rtol=0.03)


def test_a_world_that_depends_on_the_view_is_named(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    tree, node = scene.world.node_tree, background(scene)
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    for output, named in (("Reflection", False), ("Camera", True), ("Window", True)):
        tree.links.new(coordinates.outputs[output], node.inputs["Color"])
        said = [text for text in read(addon).warnings if "depends on the view" in text]
        assert bool(said) == named and (not named or f'World "World" reads Texture Coordinate > {output}' in said[0])


@pytest.mark.parametrize("strength, said", [(-1.0, "negative"), (math.nan, "not finite")])
def test_a_world_that_is_no_light_is_named(addon, scene, tmp_path, strength, said):
    blender_scenes.cloud_scene(scene, tmp_path)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = strength
    found = read(addon)
    (warning,) = [text for text in found.warnings if "World" in text]
    assert said in warning and not found.environment
    behind = addon.mrpnn_addon.scene.film.world_behind(blender_scenes.depsgraph())
    assert not np.isnan(behind).any() and behind.min() >= 0.0
