# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's point, spot and area lamps: what they light is what Cycles lights."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import AreaLight, PointLight, Settings, SpotLight, render
from tests.support import blender_scenes


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def add_lamp(scene, kind, location=(1.3, -0.9, 0.6), **values):
    """A lamp that looks at the origin."""
    lamp = bpy.data.lights.new("Lamp", kind)
    lamp.energy = 50.0
    for name, value in values.items():
        setattr(lamp, name, value)
    added = blender_scenes.add_object(scene, "Lamp", lamp)
    added.location = location
    added.rotation_euler = added.location.to_track_quat("Z", "Y").to_euler()
    return added


def smoke(scene, folder, density=1.0, anisotropy=0.0):
    """A small cloud of edge 2 at the origin without a sun."""
    path = blender_scenes.write_vdb(folder, blender_scenes.blob(), blender_scenes.centred(16, 2.0))
    blender_scenes.add_volume(scene, path, Density=density, Color=(0.9, 0.9, 0.9, 1.0), Anisotropy=anisotropy)
    blender_scenes.add_camera(scene)
    scene.render.resolution_x = scene.render.resolution_y = 16


SHAPES = {
    "point": ("POINT", dict(shadow_soft_size=0.0)),
    "soft point": ("POINT", dict(shadow_soft_size=0.5, use_soft_falloff=True)),
    "sphere": ("POINT", dict(shadow_soft_size=0.5, use_soft_falloff=False)),
    "inside": ("POINT", dict(shadow_soft_size=0.1, location=(0.1, 0.2, 0.1), energy=5.0)),
    "spot": ("SPOT", dict(shadow_soft_size=0.0, spot_size=0.8, spot_blend=0.4)),
    "soft spot": ("SPOT", dict(shadow_soft_size=0.2, spot_size=0.8, spot_blend=0.4)),
    "square": ("AREA", dict(size=0.8)),
    "rectangle": ("AREA", dict(shape="RECTANGLE", size=1.2, size_y=0.3)),
    "disk": ("AREA", dict(shape="DISK", size=0.8)),
    "ellipse": ("AREA", dict(shape="ELLIPSE", size=0.9, size_y=0.4)),
    "spread": ("AREA", dict(size=0.8, spread=math.radians(60.0))),
    "beam": ("AREA", dict(size=0.8, spread=0.0)),
    "coloured": ("POINT", dict(color=(1.0, 0.5, 0.2), shadow_soft_size=0.0)),
}
# Not in every version of Blender.
NEWER = {
    "warm": ("POINT", dict(use_temperature=True, temperature=3000.0, exposure=1.5, shadow_soft_size=0.0)),
    "per surface": ("POINT", dict(normalize=False, shadow_soft_size=0.3)),
    "per area": ("AREA", dict(normalize=False, shape="DISK", size=0.7)),
}
FINE = ("inside", "spot", "soft spot", "beam")


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SHAPES, *NEWER])
def test_single_scattering_is_that_of_cycles(addon, scene, tmp_path, name):
    kind, values = {**SHAPES, **NEWER}[name]
    if name in NEWER and "normalize" not in bpy.types.Light.bl_rna.properties:
        pytest.skip("this Blender's lamps have neither")
    smoke(scene, tmp_path, density=4.0, anisotropy=0.4)
    add_lamp(scene, kind, **values)
    # Light that varies within a pixel is compared in means over several.
    pixels = 3 if name in FINE else 1
    scene.render.resolution_x = scene.render.resolution_y = 16 * pixels
    described = read(addon)
    layer = render(described.volumes, described.lights, described.camera, Settings(multiple=False))
    reference = blender_scenes.render_cycles(scene, tmp_path, samples=512 if pixels == 1 else 256)[..., :3]
    assert not described.warnings
    found, expected = (image.reshape(16, pixels, 16, pixels, 3).mean(axis=(1, 3)) for image in (layer.rgb, reference))
    # Limited spread is a sum over a few points of the lamp.
    rel = 0.03 if name == "spread" else 0.02
    assert found.mean(axis=(0, 1)) == pytest.approx(expected.mean(axis=(0, 1)), rel=rel)
    # The reference is noisy.
    assert np.abs(found - expected).mean() < 0.08 * expected.mean()


@pytest.mark.slow
def test_a_lamp_inside_smoke_is_that_of_cycles(addon, scene, tmp_path):
    smoke(scene, tmp_path, density=12.0)
    scene.render.resolution_x = scene.render.resolution_y = 48
    add_lamp(scene, "POINT", (0.1, 0.2, 0.1), energy=5.0, shadow_soft_size=0.1)
    described = read(addon)
    layer = render(described.volumes, described.lights, described.camera, Settings(depth_samples=16))
    reference = blender_scenes.render_cycles(scene, tmp_path, samples=400, bounces=1024)[..., :3]
    assert layer.multiple.mean() > 0.5 * reference.mean()
    assert layer.rgb.mean() == pytest.approx(reference.mean(), rel=0.15)


def test_each_kind_becomes_its_light(addon, scene, tmp_path):
    smoke(scene, tmp_path)
    for kind, light in (("POINT", PointLight), ("SPOT", SpotLight), ("AREA", AreaLight)):
        lamp = add_lamp(scene, kind)
        (found,) = read(addon).lights
        assert isinstance(found, light) and '"Lamp"' in found.name
        bpy.data.objects.remove(lamp)


SCALES = {
    "wide": (2.0, 1.0, 1.0),
    "long": (1.0, 1.0, 2.0),
    "mirrored": (-1.0, 2.0, 0.5),
    "sheared": (1.0, -2.0, 1.0),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind, scale",
    [*[("SPOT", scale) for scale in SCALES], ("POINT", "sheared"), ("SUN", "sheared"), ("AREA", "mirrored")],
)
def test_scaled_lamps_light_as_in_cycles(addon, scene, tmp_path, kind, scale):
    """The cone of a spot is round in the spot's own frame, which its scale and its parents' stretch."""
    smoke(scene, tmp_path, density=4.0)
    # Farther away, so that a wide cone has its edge in the smoke.
    lamp = add_lamp(scene, kind, location=(2.2, -1.5, 1.0))
    lamp.scale = SCALES[scale]
    if kind == "SPOT":
        lamp.data.spot_size, lamp.data.spot_blend, lamp.data.shadow_soft_size = 0.4, 0.2, 0.1
    if scale == "sheared":
        lamp.parent = blender_scenes.add_object(scene, "Parent", None)
        lamp.parent.scale, lamp.parent.rotation_euler = (1.4, 1.0, 0.7), (0.1, 0.2, 0.1)
    scene.render.resolution_x = scene.render.resolution_y = 48
    described = read(addon)
    layer = render(described.volumes, described.lights, described.camera, Settings(16, multiple=False))
    reference = blender_scenes.render_cycles(scene, tmp_path, samples=64)[..., :3]
    assert not described.warnings
    found, expected = (image.reshape(16, 3, 16, 3, 3).mean(axis=(1, 3)) for image in (layer.rgb, reference))
    assert found.mean() == pytest.approx(expected.mean(), rel=0.03)
    assert np.abs(found - expected).mean() < 0.08 * expected.mean()


def test_a_sheared_area_lamp_is_named(addon, scene, tmp_path):
    smoke(scene, tmp_path)
    lamp = add_lamp(scene, "AREA", size=0.5)
    lamp.parent = blender_scenes.add_object(scene, "Parent", None)
    lamp.parent.scale = 1.4, 1.0, 0.7
    [warning] = read(addon).warnings
    assert '"Lamp" is sheared' in warning


def test_scaled_and_turned_area_lamps_keep_their_power(addon, scene, tmp_path):
    smoke(scene, tmp_path)
    lamp = add_lamp(scene, "AREA", size=0.5)
    lamp.scale = (2.0, -1.0, 3.0)
    (found,) = read(addon).lights
    assert found.area == pytest.approx(0.5)
    assert found.power == pytest.approx(50.0)
    # Towards the origin.
    assert found.normal @ -np.array(lamp.location) > 0.0


def test_a_flat_area_lamp_shines(addon, scene, tmp_path):
    smoke(scene, tmp_path)
    add_lamp(scene, "AREA", size=0.5).scale = (1.0, 1.0, 0.0)
    (found,) = read(addon).lights
    assert found.area == pytest.approx(0.25)


def test_hidden_and_empty_lamps_are_left_out_by_name(addon, scene, tmp_path):
    smoke(scene, tmp_path)
    blender_scenes.add_sun(scene)
    add_lamp(scene, "POINT").visible_volume_scatter = False
    described = read(addon)
    assert not described.lamps
    assert described.warnings == ['point light "Lamp" lights nothing that is rendered (left out)']


def test_the_default_scene_needs_nothing_deleted(addon, tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=False)
    scene = bpy.context.scene
    path = blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 2.0))
    blender_scenes.add_volume(scene, path, Density=4.0)[0].location = (0.0, 0.0, 2.2)
    described = read(addon)
    (lamp,) = described.lamps
    assert lamp.power == pytest.approx(1000.0) and described.environments
    scene.render.resolution_x, scene.render.resolution_y = 48, 27
    described = read(addon)
    layer = render(
        described.volumes, described.lights, described.camera, Settings(depth_samples=4), surfaces=described.surfaces
    )
    assert layer.report.counts["lamps"] == 1 and layer.single.max() > 0.02 and layer.multiple.max() > 0.02


def lamp_nodes(lamp):
    """The lamp's tree and its Emission."""
    lamp.use_nodes = True
    return lamp.node_tree, lamp.node_tree.nodes["Emission"]


def grouped(lamp):
    """An Emission inside a group, driven by the group's inputs."""
    tree, emission = lamp_nodes(lamp)
    group = bpy.data.node_groups.new("Bulb", "ShaderNodeTree")
    group.interface.new_socket("Strength", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Light", in_out="OUTPUT", socket_type="NodeSocketShader")
    inner, entry, leave = (
        group.nodes.new(kind) for kind in ("ShaderNodeEmission", "NodeGroupInput", "NodeGroupOutput")
    )
    group.links.new(entry.outputs[0], inner.inputs["Strength"])
    group.links.new(inner.outputs[0], leave.inputs[0])
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    node.inputs["Strength"].default_value = 2.5
    tree.links.new(node.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])


def mixed(lamp):
    """Half a blackbody and half of what has a quadratic falloff."""
    tree, emission = lamp_nodes(lamp)
    other, mix, body, falloff = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("Emission", "MixShader", "Blackbody", "LightFalloff")
    )
    body.inputs[0].default_value, falloff.inputs["Strength"].default_value = 2500.0, 3.0
    tree.links.new(body.outputs[0], emission.inputs["Color"])
    tree.links.new(falloff.outputs["Quadratic"], other.inputs["Strength"])
    for node, socket in ((emission, 1), (other, 2)):
        tree.links.new(node.outputs[0], mix.inputs[socket])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])


@pytest.mark.parametrize("nodes", [grouped, mixed])
def test_nodes_of_lamps_scale_their_light_as_in_cycles(addon, scene, tmp_path, nodes):
    blender_scenes.cloud_scene(scene, tmp_path, density=1.0)
    bpy.data.objects.remove(scene.objects["Sun"])
    scene.render.resolution_x = scene.render.resolution_y = 8
    lamp = bpy.data.lights.new("Lamp", "POINT")
    blender_scenes.add_object(scene, "Lamp", lamp).location = (2.0, 1.0, 2.0)
    seen, power = [], []
    for change in (lambda lamp: None, nodes):
        change(lamp)
        power.append(addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph()).lamps[0].power)
        seen.append(blender_scenes.render_cycles(scene, tmp_path, samples=8)[..., :3].mean(axis=(0, 1)))
    np.testing.assert_allclose(power[1] / power[0], seen[1] / seen[0], rtol=0.01)


def test_nodes_of_lamps_that_are_not_rendered_are_named(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    tree, emission = lamp_nodes(scene.objects["Sun"].data)
    lamp = bpy.data.lights.new("Lamp", "POINT")
    blender_scenes.add_object(scene, "Lamp", lamp)
    for kind, output, name in (
        ("TexIES", "Fac", "IES Texture"),
        ("LightFalloff", "Linear", "Light Falloff"),
        ("TexNoise", 0, "Noise Texture"),
    ):
        node = tree.nodes.new(f"ShaderNode{kind}")
        tree.links.new(node.outputs[output], emission.inputs["Strength"])
        described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
        assert not described.suns and len(described.lamps) == 1
        assert any('sun "Sun"' in text and name in text for text in described.warnings), described.warnings


def test_a_lamp_whose_nodes_lead_nowhere_is_black_as_in_cycles(addon, scene, tmp_path):
    smoke(scene, tmp_path)
    lamp = add_lamp(scene, "POINT")
    lamp.data.use_nodes = True
    lamp.data.node_tree.nodes.clear()
    frame = addon.mrpnn_addon.scene.reader.read_frame(blender_scenes.depsgraph())
    assert not any(light.power.any() for light in frame.lights)
    assert not blender_scenes.render_cycles(scene, tmp_path, samples=4)[..., :3].any()


def test_a_dark_frame_says_that_its_lamp_has_no_area(addon, scene, tmp_path):
    smoke(scene, tmp_path)
    add_lamp(scene, "AREA", size=0.0)
    (dark,) = [
        text
        for text in addon.mrpnn_addon.scene.reader.read_frame(blender_scenes.depsgraph()).warnings
        if "black" in text
    ]
    assert "no area" in dark and "hidden" not in dark
