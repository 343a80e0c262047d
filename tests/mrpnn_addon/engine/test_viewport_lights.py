# SPDX-License-Identifier: GPL-3.0-or-later
"""The preview of Rendered shading reaches its last picture with lights of every kind, and without any."""

import time
from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import RenderCache, Settings, render
from inference import scene as descriptions
from tests.support import blender_scenes
from tests.support.lights import NO_LIGHTS, one_of_each

SETTINGS = Settings(depth_samples=2)


@pytest.fixture
def cloud(addon, scene, tmp_path):
    scene.render.resolution_x, scene.render.resolution_y = 24, 16
    blender_scenes.add_volume(
        scene,
        blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 2.0)),
        Density=2.0,
    )
    blender_scenes.add_camera(scene)
    return scene


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def last_picture(addon, description):
    """Of a preview from nothing, which goes through all of its steps."""
    preview = addon.mrpnn_addon.engine.preview
    shown = preview.Preview(description, description.camera, SETTINGS, preview.Prepared(RenderCache()))
    end = time.monotonic() + 120.0
    while not shown.done and time.monotonic() < end:
        time.sleep(0.01)
    assert shown.done and not shown.message and shown.number == 4, shown.message
    assert shown.picture[..., :3].max() > 1e-3
    return shown.picture


def check_last_picture(addon, description):
    """It is the render."""
    layer = render(description.volumes, description.lights, description.camera, SETTINGS, surfaces=description.surfaces)
    np.testing.assert_array_equal(last_picture(addon, description)[::-1, :, :3], layer.rgb)


def test_every_class_of_light_is_known():
    """A class that is added to the descriptions of scenes is among the lights here, or is said to be none."""
    members = {getattr(descriptions, name) for name in descriptions.__all__}
    classes = {member for member in members if isinstance(member, type)}
    assert {type(light) for light in one_of_each()} == classes - NO_LIGHTS


@pytest.mark.slow
def test_lights_of_every_class(addon, cloud):
    blender_scenes.add_sun(cloud)
    description = read(addon)
    for light in one_of_each():
        last_picture(addon, replace(description, suns=[light]))


@pytest.mark.slow
def test_lamps_of_every_kind_and_a_world(addon, cloud):
    """As Blender lists the kinds."""
    for kind in bpy.types.Light.bl_rna.properties["type"].enum_items:
        data = bpy.data.lights.new(kind.name, kind.identifier)
        data.energy = 3.0 if kind.identifier == "SUN" else 300.0
        blender_scenes.add_object(cloud, kind.name, data).location = (0.0, 0.0, 3.0)
    background = cloud.world.node_tree.nodes["Background"].inputs
    background["Color"].default_value, background["Strength"].default_value = (0.2, 0.4, 0.8, 1.0), 0.5
    description = read(addon)
    assert len(description.lights) == 5 and not description.left_out
    check_last_picture(addon, description)


@pytest.mark.slow
def test_a_glowing_mesh_and_no_light(addon, cloud):
    mesh = bpy.data.meshes.new("Panel")
    mesh.from_pydata([(-1, -1, 2), (1, -1, 2), (1, 1, 2), (-1, 1, 2)], [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("Glow")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = 5.0
    tree.links.new(emission.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    mesh.materials.append(material)
    panel = blender_scenes.add_object(cloud, "Panel", mesh)
    panel.visible_camera = False
    description = read(addon)
    assert not description.lights
    check_last_picture(addon, description)


def test_emission_and_no_light(addon, cloud):
    node = cloud.objects["Cloud"].data.materials[0].node_tree.nodes["Principled Volume"]
    node.inputs["Emission Strength"].default_value = 1.0
    description = read(addon)
    assert not description.lights
    check_last_picture(addon, description)


def test_lights_that_light_nothing(addon, cloud):
    """Black ones, and ones that are linked to other objects, beside one that shines."""
    blender_scenes.add_sun(cloud)
    description = read(addon)
    sun, point, *_ = one_of_each()
    dark, elsewhere = replace(sun, irradiance=0.0), replace(point, receivers=frozenset({"wall"}))
    check_last_picture(addon, replace(description, suns=[elsewhere, dark, sun]))
