"""Materials and lamps as extinction, albedo and irradiance, against Cycles' own renders."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from . import blender_scenes

CELLS, EDGE = 12, 3.0
STRENGTH = 2.0


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    """A homogeneous cube of edge 3 and density 1; its ramps end inside Cycles' bounds."""
    return blender_scenes.write_vdb(
        tmp_path_factory.mktemp("box"), np.ones((CELLS,) * 3), blender_scenes.centred(CELLS, EDGE), low=(2, 2, 2))


def build(scene, box, shader="ShaderNodeVolumePrincipled", **inputs):
    """The box seen and lit straight from above; gives (object, shader node, sun)."""
    scene.render.resolution_x = scene.render.resolution_y = 4
    cloud, node = blender_scenes.add_volume(scene, box, shader=shader, **inputs)
    # Centre the shifted grid under the camera.
    cloud.location = (-0.5, -0.5, -0.5)
    sun = blender_scenes.add_sun(scene, strength=STRENGTH, rotation=(0.0, 0.0, 0.0))
    blender_scenes.add_camera(scene, ortho_scale=0.4)
    return cloud, node, sun


def assert_cycles_agrees(addon, scene, folder, tolerance=0.03):
    """Single scattering of what was read, in closed form, equals Cycles' image.

    With camera and sun on one axis: alpha = 1 - exp(-sigma_t L) and
    radiance = E albedo p(-1) (1 - exp(-2 sigma_t L)) / 2.
    """
    described = addon.mrpnn_addon.scene.read_scene(blender_scenes.depsgraph())
    (volume, medium), (sun,) = described.volumes[0], described.suns
    # The box's length along the view, in world units.
    length = CELLS * np.linalg.norm(volume.world_from_index[:3, 2])
    depth = medium.sigma_t * length
    g = medium.anisotropy
    phase = (1.0 - g * g) / (4.0 * math.pi * (1.0 + g) ** 3)
    radiance = sun.irradiance * medium.albedo * phase * (1.0 - np.exp(-2.0 * depth)) / 2.0
    pixel = blender_scenes.render_cycles(scene, folder, samples=512).mean(axis=(0, 1))
    assert pixel[3] > 0.02, "Cycles shows no volume"
    np.testing.assert_allclose(pixel[3], np.mean(1.0 - np.exp(-depth)), rtol=tolerance)
    np.testing.assert_allclose(pixel[:3], radiance, rtol=tolerance, atol=1e-6)
    return medium


@pytest.mark.parametrize("inputs", [
    {"Density": 0.2, "Color": (0.5, 0.5, 0.5, 1.0)},
    {"Density": 0.1, "Color": (0.8, 0.4, 0.1, 1.0), "Anisotropy": -0.3},
    {"Density": 0.1, "Color": (0.5, 0.5, 0.5, 1.0), "Absorption_Color": (0.25, 0.25, 0.25, 1.0)},
    # Scattering above 1 leaves nothing to absorb: extinction grows, albedo is 1.
    {"Density": 0.1, "Color": (2.0, 2.0, 2.0, 1.0)},
], ids=["grey", "colour", "absorption colour", "colour above 1"])
def test_principled_volume(addon, scene, box, tmp_path, inputs):
    build(scene, box, **inputs)
    assert_cycles_agrees(addon, scene, tmp_path)


def link_grid(node, source, output, factor=None):
    """Link `source`'s output to the shader's Density, through a multiplication where a factor is given."""
    tree = node.id_data
    source = tree.nodes.new(source)
    if source.bl_idname == "ShaderNodeAttribute":
        source.attribute_name = "density"
    output = source.outputs[output]
    if factor is not None:
        math_node = tree.nodes.new("ShaderNodeMath")
        math_node.operation = 'MULTIPLY'
        math_node.inputs[1].default_value = factor
        tree.links.new(output, math_node.inputs[0])
        output = math_node.outputs[0]
    tree.links.new(output, node.inputs["Density"])


@pytest.mark.parametrize("source, output, factor", [
    ("ShaderNodeAttribute", "Fac", None), ("ShaderNodeAttribute", "Fac", 0.3), ("ShaderNodeVolumeInfo", "Density", 0.3),
])
def test_volume_scatter_reads_the_grid_through_a_link(addon, scene, box, tmp_path, source, output, factor):
    _, node, _ = build(scene, box, "ShaderNodeVolumeScatter", Color=(0.6, 0.6, 0.6, 1.0), Anisotropy=0.2)
    link_grid(node, source, output, factor)
    medium = assert_cycles_agrees(addon, scene, tmp_path)
    np.testing.assert_array_equal(medium.albedo, 1.0)


def test_no_material_is_cycles_default(addon, scene, box, tmp_path):
    cloud, _, _ = build(scene, box)
    cloud.data.materials.clear()
    assert_cycles_agrees(addon, scene, tmp_path)


@pytest.mark.parametrize("space", ["OBJECT", "WORLD"])
def test_object_scale_acts_on_density_as_in_cycles(addon, scene, box, tmp_path, space):
    cloud, _, _ = build(scene, box, Density=0.1)
    cloud.data.render.space = space
    cloud.scale = (1.0, 2.0, 3.0)
    cloud.rotation_euler = (0.0, 0.0, 0.7)
    cloud.location = (0.0, 0.0, -1.5)
    assert_cycles_agrees(addon, scene, tmp_path)


@pytest.mark.parametrize("lamp", [
    {"color": (0.2, 0.5, 1.0)}, {"exposure": 1.0}, {"use_temperature": True, "temperature": 3000.0},
    {"normalize": False, "angle": 0.3},
], ids=lambda lamp: next(iter(lamp)))
def test_lamp_settings(addon, scene, box, tmp_path, lamp):
    _, _, sun = build(scene, box, Density=0.1)
    sun.data.angle = 0.0
    for name, value in lamp.items():
        setattr(sun.data, name, value)
    assert_cycles_agrees(addon, scene, tmp_path)


def test_lamp_nodes(addon, scene, box, tmp_path):
    _, _, sun = build(scene, box, Density=0.1)
    sun.data.use_nodes = True
    emission = sun.data.node_tree.nodes["Emission"]
    emission.inputs["Color"].default_value = (0.5, 0.25, 1.0, 1.0)
    emission.inputs["Strength"].default_value = 2.0
    assert_cycles_agrees(addon, scene, tmp_path)


def glow(node):
    node.inputs["Emission Strength"].default_value = 1.0


def burn(node):
    node.inputs["Blackbody Intensity"].default_value = 1.0


def link_noise(node):
    tree = node.id_data
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs[0], node.inputs["Density"])


def link_colour_ramp(node):
    tree = node.id_data
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    tree.links.new(ramp.outputs[0], node.inputs["Color"])


def colour_by_grid(node):
    node.inputs["Color Attribute"].default_value = "density"


def clear_attribute(node):
    node.inputs["Density Attribute"].default_value = ""


def use_grid_twice(node):
    link_grid(node, "ShaderNodeVolumeInfo", "Density")


def mute(node):
    node.mute = True


def unlink(node):
    node.id_data.links.clear()


@pytest.mark.parametrize("change, named", [
    (glow, "Emission Strength"), (burn, "Blackbody Intensity"), (link_noise, "Noise Texture"),
    (link_colour_ramp, "Color Ramp"), (colour_by_grid, "Color Attribute"), (clear_attribute, "Density Attribute"),
    (use_grid_twice, "Density Attribute"), (mute, "muted"), (unlink, "Volume socket"),
])
def test_what_cannot_be_rendered_is_refused_by_name(addon, scene, box, change, named):
    _, node, _ = build(scene, box)
    change(node)
    with pytest.raises(addon.inference.SceneError, match="Cloud") as refusal:
        addon.mrpnn_addon.scene.read_scene(blender_scenes.depsgraph())
    assert "Cloud fog" in str(refusal.value) and named in str(refusal.value)


def test_an_unknown_shader_and_scatter_without_grid_are_refused(addon, scene, box):
    _, node, _ = build(scene, box, "ShaderNodeVolumeScatter")
    with pytest.raises(addon.inference.SceneError, match="does not read a grid"):
        addon.mrpnn_addon.scene.read_scene(blender_scenes.depsgraph())
    tree = node.id_data
    absorption = tree.nodes.new("ShaderNodeVolumeAbsorption")
    tree.links.new(absorption.outputs[0], tree.get_output_node('CYCLES').inputs["Volume"])
    with pytest.raises(addon.inference.SceneError, match="\"Volume Absorption\" is not supported"):
        addon.mrpnn_addon.scene.read_scene(blender_scenes.depsgraph())
