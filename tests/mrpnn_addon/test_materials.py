# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials and lamps read as extinction, albedo and irradiance, against Cycles' renders."""

import importlib
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import SceneError, render
from tests.support import blender_scenes

CELLS, EDGE = 12, 3.0
STRENGTH = 2.0


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    """A homogeneous cube of edge 3 and density 1, whose boundary ramps lie inside Cycles' bounds."""
    return blender_scenes.write_vdb(
        tmp_path_factory.mktemp("box"), np.ones((CELLS,) * 3), blender_scenes.centred(CELLS, EDGE), low=(2, 2, 2)
    )


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
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    volume, medium = described.volumes[0]
    # A soft sun's directions share its light.
    irradiance = sum(sun.irradiance for sun in described.suns)
    # Along the view through the middle, in world units; the density is linear between voxels.
    middle = volume.density[volume.density.shape[0] // 2, volume.density.shape[1] // 2]
    depth = medium.sigma_t * float(middle.sum()) * np.linalg.norm(volume.world_from_index[:3, 2])
    g = medium.anisotropy
    phase = (1.0 - g * g) / (4.0 * math.pi * (1.0 + g) ** 3)
    radiance = irradiance * medium.albedo * phase * (1.0 - np.exp(-2.0 * depth)) / 2.0
    pixel = blender_scenes.render_cycles(scene, folder, samples=512).mean(axis=(0, 1))
    assert pixel[3] > 0.02, "Cycles shows no volume"
    np.testing.assert_allclose(pixel[3], np.mean(1.0 - np.exp(-depth)), rtol=tolerance)
    np.testing.assert_allclose(pixel[:3], radiance, rtol=tolerance, atol=1e-6)
    return medium


@pytest.mark.parametrize(
    "inputs",
    [
        {"Density": 0.2, "Color": (0.5, 0.5, 0.5, 1.0)},
        {"Density": 0.1, "Color": (0.8, 0.4, 0.1, 1.0), "Anisotropy": -0.3},
        {"Density": 0.1, "Color": (0.5, 0.5, 0.5, 1.0), "Absorption_Color": (0.25, 0.25, 0.25, 1.0)},
        # Scattering above 1 leaves no absorption: extinction grows, albedo is 1.
        {"Density": 0.1, "Color": (2.0, 2.0, 2.0, 1.0)},
    ],
    ids=["grey", "colour", "absorption colour", "colour above 1"],
)
def test_principled_volume(addon, scene, box, tmp_path, inputs):
    build(scene, box, **inputs)
    assert_cycles_agrees(addon, scene, tmp_path)


def link_grid(node, source, output, factor=None):
    """Link an output of `source` to the shader's Density, multiplied by a factor if one is given."""
    tree = node.id_data
    source = tree.nodes.new(source)
    if source.bl_idname == "ShaderNodeAttribute":
        source.attribute_name = "density"
    output = source.outputs[output]
    if factor is not None:
        math_node = tree.nodes.new("ShaderNodeMath")
        math_node.operation = "MULTIPLY"
        math_node.inputs[1].default_value = factor
        tree.links.new(output, math_node.inputs[0])
        output = math_node.outputs[0]
    tree.links.new(output, node.inputs["Density"])


@pytest.mark.parametrize(
    "name, output", [("thickness", "Fac"), ("tint", "Fac"), ("color", "Alpha"), ("scale", "Color")]
)
def test_an_attribute_of_the_object_is_its_property(addon, scene, box, tmp_path, name, output):
    """A number, a list, and properties of Blender's; each object that shares a volume has its own."""
    cloud, node, _ = build(scene, box, Color=(0.6, 0.6, 0.6, 1.0), Anisotropy=0.2)
    cloud["thickness"], cloud["tint"], cloud.color = 0.4, [0.2, 0.5, 1.1], (0.0, 0.1, 0.2, 0.7)
    cloud.scale = 0.9, 0.95, 1.0
    cloud.data.render.space = "WORLD"
    attribute = node.id_data.nodes.new("ShaderNodeAttribute")
    attribute.attribute_type, attribute.attribute_name = "OBJECT", name
    node.id_data.links.new(attribute.outputs[output], node.inputs["Density"])
    assert_cycles_agrees(addon, scene, tmp_path)


def test_objects_that_share_a_volume_have_attributes_of_their_own(addon, scene, box):
    cloud, node, _ = build(scene, box)
    other = blender_scenes.add_object(scene, "Other", cloud.data)
    other.location.x, cloud["thickness"], other["thickness"] = 5.0, 0.5, 1.5
    attribute = node.id_data.nodes.new("ShaderNodeAttribute")
    attribute.attribute_type, attribute.attribute_name = "OBJECT", "thickness"
    node.id_data.links.new(attribute.outputs["Fac"], node.inputs["Density"])
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    first, second = (medium.sigma_t * volume.density.max() for volume, medium in described.volumes)
    np.testing.assert_allclose(second, 3.0 * first)
    # One that neither object has is 0.
    attribute.attribute_name = "absent"
    with pytest.raises(SceneError, match="neither scatters, absorbs nor emits"):
        addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


@pytest.mark.parametrize(
    "source, output, factor",
    [
        ("ShaderNodeAttribute", "Fac", None),
        ("ShaderNodeAttribute", "Fac", 0.3),
        ("ShaderNodeVolumeInfo", "Density", 0.3),
    ],
)
def test_volume_scatter_reads_the_grid_through_a_link(addon, scene, box, tmp_path, source, output, factor):
    _, node, _ = build(scene, box, "ShaderNodeVolumeScatter", Color=(0.6, 0.6, 0.6, 1.0), Anisotropy=0.2)
    link_grid(node, source, output, factor)
    medium = assert_cycles_agrees(addon, scene, tmp_path)
    np.testing.assert_array_equal(medium.albedo, 1.0)


def test_without_a_material_cycles_default_applies(addon, scene, box, tmp_path):
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


@pytest.mark.parametrize(
    "lamp",
    [
        {"color": (0.2, 0.5, 1.0)},
        {"exposure": 1.0},
        {"use_temperature": True, "temperature": 3000.0},
        {"normalize": False, "angle": 0.3},
    ],
    ids=lambda lamp: next(iter(lamp)),
)
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


def link(node, kind, *inputs, into="Density", **values):
    """Feed a new node from `inputs` sockets and into one of the shader's; gives the new node."""
    tree = node.id_data
    added = tree.nodes.new(f"ShaderNode{kind}")
    for socket, source in zip(added.inputs, inputs):
        tree.links.new(source, socket)
    for name, value in values.items():
        added.inputs[name.replace("_", " ")].default_value = value
    if into:
        tree.links.new(added.outputs[0], node.inputs[into])
    return added


def density_grid(node):
    return link(node, "VolumeInfo", into=None).outputs["Density"]


@pytest.mark.parametrize("chain", ["map range", "color ramp", "curve and mix"])
def test_a_chain_of_nodes_shapes_the_density(addon, scene, box, tmp_path, chain):
    _, node, _ = build(scene, box, Color=(0.6, 0.5, 0.4, 1.0))
    # The grid is 1: shifted into the curved part of the nodes.
    half = link(node, "Math", density_grid(node), into=None)
    half.operation, half.inputs[1].default_value = "MULTIPLY", 0.37
    if chain == "map range":
        link(node, "MapRange", half.outputs[0], To_Max=0.5).interpolation_type = "SMOOTHERSTEP"
    elif chain == "color ramp":
        ramp = link(node, "ValToRGB", half.outputs[0]).color_ramp
        ramp.elements.new(0.4).color = (0.1, 0.4, 0.2, 1.0)
    else:
        curve = link(node, "FloatCurve", into=None)
        node.id_data.links.new(half.outputs[0], curve.inputs["Value"])
        mix = link(node, "Mix", into=None)
        mix.inputs[2].default_value, mix.inputs[3].default_value = 0.0, 0.4
        node.id_data.links.new(curve.outputs[0], mix.inputs[0])
        node.id_data.links.new(mix.outputs[0], node.inputs["Density"])
    assert_cycles_agrees(addon, scene, tmp_path)


def test_the_density_attribute_multiplies_the_linked_density(addon, scene, box, tmp_path):
    _, node, _ = build(scene, box)
    link_grid(node, "ShaderNodeVolumeInfo", "Density", 0.1)
    assert_cycles_agrees(addon, scene, tmp_path)


def shaders(node, *kinds, joined):
    """Replace the shader by several of `kinds`, all with a tenth of the grid's density, joined by a node."""
    tree = node.id_data
    added = []
    for kind in kinds:
        shader = tree.nodes.new(f"ShaderNodeVolume{kind}")
        shader.inputs["Color"].default_value = (0.7, 0.5, 0.2, 1.0)
        link_grid(shader, "ShaderNodeVolumeInfo", "Density", 0.1)
        added.append(shader)
    join = tree.nodes.new(f"ShaderNode{joined}Shader")
    for shader, socket in zip(added, [socket for socket in join.inputs if socket.type == "SHADER"]):
        tree.links.new(shader.outputs[0], socket)
    tree.links.new(join.outputs[0], tree.get_output_node("CYCLES").inputs["Volume"])
    return join


@pytest.mark.parametrize("joined", ["Add", "Mix"])
def test_scatter_and_absorption_together(addon, scene, box, tmp_path, joined):
    _, node, _ = build(scene, box)
    join = shaders(node, "Scatter", "Absorption", joined=joined)
    if joined == "Mix":
        join.inputs["Fac"].default_value = 0.3
    medium = assert_cycles_agrees(addon, scene, tmp_path)
    assert len(set(medium.albedo)) == 3 and medium.albedo.max() < 1.0


def test_volume_coefficients(addon, scene, box, tmp_path):
    if not hasattr(bpy.types, "ShaderNodeVolumeCoefficients"):
        pytest.skip("this version has no Volume Coefficients node")
    _, node, _ = build(scene, box, "ShaderNodeVolumeCoefficients", Anisotropy=0.3)
    for kind, colour in (("Scatter", (0.1, 0.2, 0.3)), ("Absorption", (0.3, 0.1, 0.0))):
        product = link(node, "VectorMath", density_grid(node), into=f"{kind} Coefficients")
        product.operation, product.inputs[1].default_value = "MULTIPLY", colour
    assert_cycles_agrees(addon, scene, tmp_path)


@pytest.mark.parametrize(
    "phase, inputs",
    [
        ("RAYLEIGH", ()),
        ("MIE", (3.0,)),
        *(
            pytest.param(phase, inputs, marks=pytest.mark.slow)
            for phase, inputs in (
                ("DRAINE", (0.6, 3.0)),
                ("MIE", (0.05,)),
                ("MIE", (0.8,)),
                ("MIE", (20.0,)),
                ("FOURNIER_FORAND", (1.33, 0.1)),
            )
        ),
    ],
    ids=str,
)
def test_phase_functions_equal_those_of_cycles(addon, scene, box, tmp_path, phase, inputs):
    """Single scattering at two angles: Cycles' render, the phase function and the layer agree."""
    found = importlib.import_module("mrpnn.mrpnn_addon.nodes.phase_functions")
    _, node, sun = build(scene, box, "ShaderNodeVolumeScatter")
    node.phase = phase
    names = {"DRAINE": ("Anisotropy", "Alpha"), "MIE": ("Diameter",), "FOURNIER_FORAND": ("IOR", "Backscatter")}
    for name, value in zip(names.get(phase, ()), inputs):
        node.inputs[name].default_value = value
    link_grid(node, "ShaderNodeVolumeInfo", "Density", 0.02)

    density = found.phase_function(phase, *inputs)
    mean, seen = density.mean_cosine(), []
    for angle in (0.3, 2.4):
        # Forward scattering has angle 0; the camera looks down.
        sun.rotation_euler = (math.pi - angle, 0.0, 0.0)
        seen.append(blender_scenes.render_cycles(scene, tmp_path, samples=256)[..., 0].mean())
        described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
        layer = render(described.volumes, described.suns, described.camera)
        assert layer.single[..., 0].mean() == pytest.approx(seen[-1], rel=0.06)
    assert seen[0] / seen[1] == pytest.approx(density(math.cos(0.3)) / density(math.cos(2.4)), rel=0.06)
    assert described.volumes[0][1].anisotropy == pytest.approx(mean)
    assert any(f"{mean:.3f}" in warning and "an Anisotropy of" in warning for warning in described.warnings)


def link_layer_weight(node):
    link(node, "LayerWeight")


def ramp_in_colour(node):
    link(node, "ValToRGB", density_grid(node), into="Color")


def colour_by_a_grid_beside_its_own(node):
    node.inputs["Color Attribute"].default_value = "density"


def clear_attribute(node):
    node.inputs["Density Attribute"].default_value = ""


def fog_without_end(node):
    clear_attribute(node)
    link(node, "Math", density_grid(node))


def tint_scattering(node):
    """Volume Scatter's extinction is what it scatters: here red where thin, blue where dense."""
    scatter = node.id_data.nodes.new("ShaderNodeVolumeScatter")
    scatter.inputs["Anisotropy"].default_value = 0.5
    ramp, dense = node.id_data.nodes.new("ShaderNodeValToRGB"), node.id_data.nodes.new("ShaderNodeMath")
    ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (1, 0.2, 0.1, 1), (0.0, 0.3, 1, 1)
    dense.operation, dense.inputs[1].default_value = "MULTIPLY", 4.0
    for target in (ramp, dense):
        node.id_data.links.new(density_grid(node), target.inputs[0])
    node.id_data.links.new(ramp.outputs[0], scatter.inputs["Color"])
    node.id_data.links.new(dense.outputs[0], scatter.inputs["Density"])
    node.id_data.links.new(scatter.outputs[0], node.id_data.get_output_node("CYCLES").inputs["Volume"])


def unlink(node):
    node.id_data.links.clear()


def output_for_eevee(node):
    node.id_data.get_output_node("CYCLES").target = "EEVEE"


def remove_output(node):
    node.id_data.nodes.remove(node.id_data.get_output_node("CYCLES"))


def bend_phase(node):
    link(node, "Math", density_grid(node), into="Anisotropy")


@pytest.mark.parametrize(
    "change, named",
    [
        (link_layer_weight, "Layer Weight"),
        (clear_attribute, "Density Attribute"),
        (fog_without_end, "endless fog"),
        (unlink, "Volume socket"),
        (output_for_eevee, "no Material Output with the target All or Cycles"),
        (remove_output, "no Material Output with the target All or Cycles"),
    ],
)
def test_what_cannot_be_rendered_is_refused_by_name(addon, scene, box, change, named):
    _, node, _ = build(scene, box)
    change(node)
    assert_refused(addon, named)


def assert_refused(addon, named):
    with pytest.raises(SceneError, match="Cloud") as refusal:
        addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    assert "Cloud fog" in str(refusal.value) and named in str(refusal.value)


@pytest.mark.parametrize("change, channels", [(ramp_in_colour, 1), (colour_by_a_grid_beside_its_own, 1)])
def test_colour_that_varies_from_voxel_to_voxel_is_an_albedo_that_does(addon, scene, tmp_path, change, channels):
    blender_scenes.cloud_scene(scene, tmp_path)
    node = bpy.data.materials["Cloud fog"].node_tree.nodes["Principled Volume"]
    change(node)
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    ((volume, medium),) = described.volumes
    assert medium.varies and len(medium.albedo) == channels
    inside = volume.density > 0.0
    assert np.ptp(medium.albedo[0][inside]) > 0.1 and not medium.albedo[0][~inside].any()


def test_extinction_whose_colour_varies_is_one_volume_per_channel(addon, scene, tmp_path):
    """Single scattering and alpha as in Cycles."""
    blender_scenes.cloud_scene(scene, tmp_path)
    tint_scattering(bpy.data.materials["Cloud fog"].node_tree.nodes["Principled Volume"])
    scene.render.resolution_x = scene.render.resolution_y = 24
    seen = blender_scenes.render_cycles(scene, tmp_path, samples=256)
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    np.testing.assert_array_equal([medium.sigma_t > 0.0 for _, medium in described.volumes], np.eye(3, dtype=bool))
    layer = render(described.volumes, described.suns, described.camera)
    assert not described.warnings and not layer.report.warnings
    mean = seen[..., :3].mean(axis=(0, 1))
    np.testing.assert_allclose(layer.single.mean(axis=(0, 1)), mean, rtol=0.03)
    assert np.ptp(mean) > 0.2 * mean.max()
    assert layer.alpha.mean() == pytest.approx(seen[..., 3].mean(), rel=0.02)
    assert (layer.multiple.mean(axis=(0, 1)) > 0.0).all()


def test_a_phase_function_that_varies_is_its_mean_and_named(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    node = bpy.data.materials["Cloud fog"].node_tree.nodes["Principled Volume"]
    bend_phase(node)
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    ((volume, medium),) = described.volumes
    (said,) = described.warnings
    assert "Principled Volume" in said and "phase function" in said and "varies in space" in said
    # It is the density plus a half, at most 1.
    share = np.clip(volume.density / 4.0, 0.0, 1.0) if volume.density.max() > 2.0 else volume.density
    expected = (np.clip(share + 0.5, None, 0.999) * volume.density).sum() / volume.density.sum()
    assert medium.anisotropy == pytest.approx(expected, abs=0.02)


def test_an_unknown_shader_and_scatter_without_grid_are_refused(addon, scene, box):
    _, node, _ = build(scene, box, "ShaderNodeVolumeScatter")
    assert_refused(addon, "reads no grid")
    tree = node.id_data
    surface = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(surface.outputs[0], tree.get_output_node("CYCLES").inputs["Volume"])
    assert_refused(addon, '"Diffuse BSDF"')
