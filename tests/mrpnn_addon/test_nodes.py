# SPDX-License-Identifier: GPL-3.0-or-later
"""Node trees evaluated in numpy, against Cycles' render of an emissive plane."""

import importlib
import itertools

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import SceneError
from tests.support import glowing_plane
from tests.support.glowing_plane import Plane, add, assert_equal_to_cycles, axes, combined, evaluated, rendered


@pytest.fixture
def plane(addon, scene):
    return glowing_plane.make(scene)


def test_every_math_operation(addon, scene, plane, tmp_path):
    tree, emission, coordinates = plane
    x, y, _ = axes(tree, coordinates)
    # No multiple of x, where steps would lie on pixels' centres.
    turned = add(tree, "Math", operation="MULTIPLY_ADD")
    tree.links.new(y, turned.inputs[0])
    turned.inputs[1].default_value, turned.inputs[2].default_value = 0.8317, 0.0231
    y = turned.outputs[0]
    names = (item.identifier for item in turned.bl_rna.properties["operation"].enum_items)
    while batch := list(itertools.islice(names, 3)):
        outputs = []
        for name in batch:
            node = add(tree, "Math", operation=name)
            tree.links.new(x, node.inputs[0])
            tree.links.new(y, node.inputs[1])
            node.inputs[2].default_value = 0.4
            outputs.append(node.outputs[0])
        combined(tree, emission, outputs)
        try:
            assert_equal_to_cycles(scene, tmp_path, emission)
        except AssertionError as difference:
            raise AssertionError(f"{batch}: {difference}") from None


def test_vector_math(addon, scene, plane, tmp_path):
    tree, emission, coordinates = plane
    for item in bpy.types.ShaderNodeVectorMath.bl_rna.properties["operation"].enum_items:
        name = item.identifier
        node = add(tree, "VectorMath", operation=name)
        tree.links.new(coordinates, node.inputs[0])
        values = (0.7, -0.4, 0.9), (0.1, 0.2, 0.3), 1.7
        for identifier, value in zip(("Vector_001", "Vector_002", "Scale"), values):
            next(socket for socket in node.inputs if socket.identifier == identifier).default_value = value
        output = node.outputs[1] if name in ("DOT_PRODUCT", "DISTANCE", "LENGTH") else node.outputs[0]
        lift = add(tree, "VectorMath")
        lift.inputs[1].default_value = (20.0,) * 3
        tree.links.new(output, lift.inputs[0])
        tree.links.new(lift.outputs[0], emission.inputs["Color"])
        try:
            assert_equal_to_cycles(scene, tmp_path, emission)
        except AssertionError as difference:
            raise AssertionError(f"{name}: {difference}") from None


@pytest.mark.parametrize("kind", ["LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP"])
def test_map_range(addon, scene, plane, tmp_path, kind):
    tree, emission, coordinates = plane
    x, y, _ = axes(tree, coordinates)
    outputs = []
    for low, high, clamp in ((-0.5, 0.9, True), (0.8, -0.7, True), (-0.5, 0.9, False)):
        node = add(tree, "MapRange", interpolation_type=kind, clamp=clamp)
        for socket, value in zip(node.inputs[1:5], (low, high, 3.0, -1.0)):
            socket.default_value = value
        tree.links.new(x, node.inputs["Value"])
        outputs.append(node.outputs[0])
    combined(tree, emission, outputs)
    assert_equal_to_cycles(scene, tmp_path, emission)


@pytest.mark.parametrize("interpolation", ["LINEAR", "CONSTANT", "B_SPLINE", "EASE"])
def test_color_ramp(addon, scene, plane, tmp_path, interpolation):
    tree, emission, coordinates = plane
    ramp = add(tree, "ValToRGB")
    ramp.color_ramp.interpolation = interpolation
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[0].color = 0.2, (1.0, 0.1, 0.0, 1.0)
    ramp.color_ramp.elements.new(0.6).color = (0.0, 2.0, 0.3, 1.0)
    tree.links.new(axes(tree, coordinates)[0], ramp.inputs[0])
    tree.links.new(ramp.outputs[0], emission.inputs["Color"])
    assert_equal_to_cycles(scene, tmp_path, emission)


def test_float_curve_clamp_gamma_and_mix(addon, scene, plane, tmp_path):
    tree, emission, coordinates = plane
    x, y, _ = axes(tree, coordinates)
    curve = add(tree, "FloatCurve")
    curve.mapping.curves[0].points.new(0.4, 0.8)
    curve.mapping.update()
    curve.inputs["Factor"].default_value = 0.7
    mix = add(tree, "Mix", clamp_factor=True)
    mix.inputs[2].default_value, mix.inputs[3].default_value = 2.0, -1.0
    clamp = add(tree, "Clamp", clamp_type="RANGE")
    clamp.inputs["Min"].default_value, clamp.inputs["Max"].default_value = 0.6, 0.1
    for node, socket in ((curve, "Value"), (mix, "Factor"), (clamp, "Value")):
        tree.links.new(x, node.inputs[socket])
    combined(tree, emission, [curve.outputs[0], mix.outputs[0], clamp.outputs[0]])
    assert_equal_to_cycles(scene, tmp_path, emission)


BLENDS = [item.identifier for item in bpy.types.ShaderNodeMix.bl_rna.properties["blend_type"].enum_items]


@pytest.mark.parametrize("blend", BLENDS)
def test_colour_blends_and_conversions(addon, scene, plane, tmp_path, blend):
    tree, emission, coordinates = plane
    absolute = add(tree, "VectorMath", operation="ABSOLUTE")
    tree.links.new(coordinates, absolute.inputs[0])
    coordinates = absolute.outputs[0]
    mix = add(tree, "Mix", data_type="RGBA", blend_type=blend)
    colours = [socket for socket in mix.inputs if socket.type == "RGBA"]
    colours[0].default_value = (0.8, 0.3, 0.5, 1.0)
    tree.links.new(coordinates, colours[1])
    mix.inputs[0].default_value = 0.6
    grey = add(tree, "Math", operation="ADD")
    grey.inputs[1].default_value = 5.0
    # A colour linked to a value socket becomes its luminance.
    tree.links.new(next(o for o in mix.outputs if o.type == "RGBA"), grey.inputs[0])
    tree.links.new(grey.outputs[0], emission.inputs["Color"])
    assert_equal_to_cycles(scene, tmp_path, emission)


@pytest.mark.parametrize("kind", ["POINT", "TEXTURE", "VECTOR", "NORMAL"])
def test_mapping(addon, scene, plane, tmp_path, kind):
    tree, emission, coordinates = plane
    node = add(tree, "Mapping", vector_type=kind)
    node.inputs["Rotation"].default_value, node.inputs["Scale"].default_value = (0.3, -0.5, 1.1), (0.7, 1.8, -1.2)
    if kind in ("POINT", "TEXTURE"):
        node.inputs["Location"].default_value = (0.3, 0.2, 0.7)
    tree.links.new(coordinates, node.inputs["Vector"])
    combined(tree, emission, axes(tree, node.outputs[0]))
    assert_equal_to_cycles(scene, tmp_path, emission)


@pytest.mark.parametrize(
    "kind", ["LINEAR", "QUADRATIC", "EASING", "DIAGONAL", "SPHERICAL", "QUADRATIC_SPHERE", "RADIAL"]
)
def test_gradient_texture(addon, scene, plane, tmp_path, kind):
    tree, emission, coordinates = plane
    node = add(tree, "TexGradient", gradient_type=kind)
    tree.links.new(coordinates, node.inputs["Vector"])
    tree.links.new(node.outputs["Fac"], emission.inputs["Color"])
    assert_equal_to_cycles(scene, tmp_path, emission)


@pytest.mark.parametrize(
    "settings",
    [
        dict(Scale=2.0, Detail=0.0),
        dict(Scale=-3.0, Detail=2.5, Roughness=0.7),
        dict(Scale=1.5, Detail=4.0, Lacunarity=2.7),
        dict(Scale=2.0, Detail=1.0, Distortion=0.8),
        dict(Scale=2.0, Detail=3.0, normalize=False),
    ],
    ids=str,
)
def test_noise_texture(addon, scene, plane, tmp_path, settings):
    tree, emission, coordinates = plane
    node = add(tree, "TexNoise", normalize=settings.pop("normalize", True))
    for name, value in settings.items():
        node.inputs[name].default_value = value
    tree.links.new(coordinates, node.inputs["Vector"])
    combined(tree, emission, [node.outputs[0]])
    assert_equal_to_cycles(scene, tmp_path, emission)


@pytest.mark.parametrize("mode", ["HSV", "HSL"])
def test_colour_models(addon, scene, plane, tmp_path, mode):
    tree, emission, coordinates = plane
    bent = add(tree, "VectorMath", operation="FRACTION")
    tree.links.new(coordinates, bent.inputs[0])
    bent_too = add(tree, "VectorMath", operation="ADD")
    bent_too.inputs[1].default_value = 0.1, 0.0, 0.35
    tree.links.new(bent.outputs[0], bent_too.inputs[0])
    apart, together = add(tree, "SeparateColor", mode=mode), add(tree, "CombineColor", mode=mode)
    tree.links.new(bent_too.outputs[0], apart.inputs[0])
    for output, socket in zip((apart.outputs[1], apart.outputs[0], apart.outputs[2]), together.inputs):
        tree.links.new(output, socket)
    hue = add(tree, "HueSaturation")
    for name, value in (("Hue", 0.7), ("Saturation", 1.3), ("Value", 0.8), ("Fac", 0.6)):
        hue.inputs[name].default_value = value
    tree.links.new(together.outputs[0], hue.inputs["Color"])
    tree.links.new(hue.outputs[0], emission.inputs["Color"])
    assert_equal_to_cycles(scene, tmp_path, emission)


@pytest.mark.parametrize("kind", ["RGBCurve", "VectorCurve"])
def test_curves_of_colours_and_vectors(addon, scene, plane, tmp_path, kind):
    tree, emission, coordinates = plane
    node = add(tree, kind)
    node.inputs["Fac"].default_value = 0.8
    for number, curve in enumerate(node.mapping.curves):
        curve.points.new(0.2 + 0.1 * number, 0.7 - 0.1 * number)
    node.mapping.update()
    tree.links.new(coordinates, node.inputs[1])
    combined(tree, emission, axes(tree, node.outputs[0]))
    assert_equal_to_cycles(scene, tmp_path, emission)


@pytest.mark.parametrize("kind", ["AXIS_ANGLE", "X_AXIS", "Y_AXIS", "Z_AXIS", "EULER_XYZ"])
def test_vector_rotate(addon, scene, plane, tmp_path, kind):
    """By an angle that varies in space."""
    tree, emission, coordinates = plane
    for invert in (False, True):
        node = add(tree, "VectorRotate", rotation_type=kind, invert=invert)
        inputs = {socket.identifier: socket for socket in node.inputs}
        inputs["Center"].default_value, inputs["Axis"].default_value = (0.3, -0.2, 0.5), (0.4, 1.0, -0.3)
        for name, output in (("Vector", coordinates), ("Angle", axes(tree, coordinates)[0]), ("Rotation", coordinates)):
            tree.links.new(output, inputs[name])
        combined(tree, emission, axes(tree, node.outputs[0]))
        assert_equal_to_cycles(scene, tmp_path, emission)


def test_normal(addon, scene, plane, tmp_path):
    tree, emission, coordinates = plane
    node = add(tree, "Normal")
    node.outputs["Normal"].default_value = 0.6, -0.3, 0.8
    tree.links.new(coordinates, node.inputs[0])
    combined(tree, emission, [*axes(tree, node.outputs["Normal"])[:2], node.outputs["Dot"]])
    assert_equal_to_cycles(scene, tmp_path, emission)


def test_groups_reroutes_and_muted_nodes(addon, scene, plane, tmp_path):
    tree, emission, coordinates = plane
    group = bpy.data.node_groups.new("Doubled", "ShaderNodeTree")
    group.interface.new_socket("In", in_out="INPUT", socket_type="NodeSocketVector")
    group.interface.new_socket("Factor", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketVector")
    inner = group.nodes.new("ShaderNodeVectorMath")
    inner.operation = "SCALE"
    entry, leave = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    group.links.new(entry.outputs[0], inner.inputs[0])
    group.links.new(entry.outputs[1], inner.inputs["Scale"])
    group.links.new(inner.outputs[0], leave.inputs[0])

    muted = add(tree, "VectorMath", operation="ADD", mute=True)
    reroute = tree.nodes.new("NodeReroute")
    tree.links.new(coordinates, muted.inputs[0])
    tree.links.new(muted.outputs[0], reroute.inputs[0])
    last = reroute.outputs[0]
    for factor in (2.0, 0.25):
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = group
        tree.links.new(last, node.inputs[0])
        node.inputs[1].default_value = factor
        last = node.outputs[0]
    combined(tree, emission, axes(tree, last))
    assert_equal_to_cycles(scene, tmp_path, emission)
    np.testing.assert_allclose(
        evaluated(emission)[:, 0], 20.0 + 0.5 * Plane().coordinates("object", None)[:, 0], rtol=1e-6
    )


def test_muted_nodes_of_every_kind(addon, scene, plane, tmp_path):
    """They pass on what is linked to them, and 0 where nothing is."""
    tree, emission, coordinates = plane
    kinds = importlib.import_module("mrpnn.mrpnn_addon.nodes.functions").FUNCTIONS
    outputs = []
    for linked in (False, True):
        for kind in kinds:
            node = tree.nodes.new(kind)
            node.mute = True
            through = next((link for link in node.internal_links if link.to_socket.enabled), None)
            outputs.append(through.to_socket if through else node.outputs[0])
            if linked and through:
                tree.links.new(coordinates, through.from_socket)
    while batch := [outputs.pop() for _ in range(min(len(outputs), 3))]:
        combined(tree, emission, batch)
        names = [output.node.bl_idname for output in batch]
        np.testing.assert_allclose(evaluated(emission), rendered(scene, tmp_path), atol=1e-3, err_msg=str(names))


def test_sockets_that_a_value_passes_convert_it(addon, scene, plane, tmp_path):
    """Muted nodes and groups, whose sockets have types of their own; reroutes and links without a source."""
    tree, emission, coordinates = plane
    colour = add(tree, "RGB")
    colour.outputs[0].default_value = 1.2, 2.6, 3.9, 1.0
    last = []
    for kind, side in itertools.product(("Float", "Int", "Bool", "Vector", "Color"), ("INPUT", "OUTPUT")):
        group = bpy.data.node_groups.new(kind, "ShaderNodeTree")
        for own in ("INPUT", "OUTPUT"):
            group.interface.new_socket(own, in_out=own, socket_type=f"NodeSocket{kind if own == side else 'Color'}")
        entry, leave = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
        group.links.new(entry.outputs[0], leave.inputs[0])
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = group
        tree.links.new(colour.outputs[0], node.inputs[0])
        last.append(node.outputs[0])
    silent = tree.nodes.new("ShaderNodeGroup")
    silent.node_tree, silent.mute = group, True
    vector, number = add(tree, "VectorMath", mute=True), add(tree, "Math", mute=True)
    tree.links.new(colour.outputs[0], vector.inputs[0])
    tree.links.new(vector.outputs[0], number.inputs[0])
    bare, cut = tree.nodes.new("NodeReroute"), tree.nodes.new("NodeReroute")
    tree.links.new(colour.outputs[0], cut.inputs[0]).is_muted = True
    last += [silent.outputs[0], number.outputs[0], bare.outputs[0], cut.outputs[0]]
    for output in last:
        tree.links.new(output, emission.inputs["Color"])
        np.testing.assert_allclose(evaluated(emission), rendered(scene, tmp_path), rtol=1e-4, atol=1e-4)
    # A muted link leaves the socket's own value.
    emission.inputs["Color"].links[0].is_muted = True
    emission.inputs["Color"].default_value = 0.3, 0.4, 0.5, 1.0
    np.testing.assert_allclose(evaluated(emission), rendered(scene, tmp_path), rtol=1e-4)


def test_what_cannot_be_evaluated_is_named(addon, scene, plane):
    tree, emission, _ = plane
    sockets = importlib.import_module("mrpnn.mrpnn_addon.nodes.sockets")
    for kind, said in (("LayerWeight", "Layer Weight"), ("TexCoord", "Reflection"), ("TexSky", "Sky")):
        node = tree.nodes.new(f"ShaderNode{kind}")
        tree.links.new(node.outputs["Reflection" if kind == "TexCoord" else 0], emission.inputs["Color"])
        with pytest.raises(sockets.Unsupported, match=said):
            evaluated(emission)


def shader_nodes(tree):
    """One node of each type that Blender offers in shaders."""
    for name in dir(bpy.types):
        kind = getattr(bpy.types, name)
        if isinstance(kind, type) and issubclass(kind, bpy.types.NodeInternal):
            try:
                yield tree.nodes.new(name)
            except RuntimeError:
                # Base classes, and nodes of other editors.
                continue


def test_every_node_of_the_menu_is_evaluated_or_named(addon, scene, plane):
    """Each output drives the volume of a material, in turn."""
    tree, emission, _ = plane
    volume = tree.get_output_node("CYCLES").inputs["Volume"]
    nodes = {name: importlib.import_module(f"mrpnn.mrpnn_addon.nodes.{name}") for name in ("material", "functions")}
    known = {*nodes["material"].CLOSURES, *nodes["functions"].FUNCTIONS, "ShaderNodeAddShader", "ShaderNodeMixShader"}
    points = importlib.import_module("mrpnn.mrpnn_addon.volumes.voxel_points")
    evaluated_types, refused = set(), set()
    for node in shader_nodes(tree):
        for output in node.outputs:
            if output.type == "SHADER":
                tree.links.new(output, volume)
            elif hasattr(output, "default_value") or output.enabled:
                tree.links.new(emission.outputs[0], volume)
                tree.links.new(output, emission.inputs["Strength"])
            try:
                nodes["material"].VolumeMaterial(bpy.data.materials["Emission"], "Volume").at(
                    points.Probe(["density"], fills_its_bounds=False)
                )
                evaluated_types.add(node.bl_idname)
            except SceneError as problem:
                assert node.name in str(problem) and "Volume, material" in str(problem), (node.bl_idname, problem)
                refused.add(node.bl_idname)
    assert len(evaluated_types) > 40 and len(refused) > 30
    # Reroutes and empty groups pass nothing on.
    assert evaluated_types - known <= {"NodeReroute", "NodeGroupInput", "ShaderNodeGroup", "NodeFrame"}
