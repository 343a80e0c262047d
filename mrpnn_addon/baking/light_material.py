# SPDX-License-Identifier: GPL-3.0-or-later
"""The material that shows baked light: `inference.LitVolume.towards` as shader nodes."""

import math
from typing import Any

import bpy
import numpy as np

from ...inference.baking.lit_volume import MAX_LOGARITHM, SHARPNESS, BakedView, DirectionalFactor, Lobe
from ..vdb.light_file import DENSITY, DIRECTIONS, LIGHT

#: Nodes whose values change from frame to frame.
SCALE, VIEW, SUN = "Brightness", "Baked From", "Sun {}"


# Rays that see the light. Cycles follows rays that volumes scatter one step even at 0 volume bounces, and would add the
# light twice; the visibility of objects to such rays does not apply inside volumes.
RAYS = ("Is Camera Ray", "Is Diffuse Ray", "Is Glossy Ray", "Is Transmission Ray")
# Light, as it is written, below which nobody sees it.
DARK = 1e-7
# Cosine of the angle to the baked view within which its light is shown as it is.
SAME_DIRECTION = 1.0 - 1e-6


def light_material(name: str, scale: float, directional: DirectionalFactor | None):
    """A new material for a Volume object that loads a file of `vdb.light_file.write_light`.

    Branches are Mix Shaders, because Cycles evaluates only the nodes that it needs of these.
    """
    material = bpy.data.materials.new(name)
    if not material.node_tree:
        material.use_nodes = True
    build = _Nodes(material.node_tree)
    build.tree.nodes.clear()
    # Density and light are interpolated apart, as `LitVolume` says.
    strength = build.math("MULTIPLY", build.value(SCALE, scale), build.attribute(DENSITY, "Fac"))
    light = build.attribute(LIGHT)
    shader = build.emission(light, strength)
    if directional is not None:
        geometry = build.node("ShaderNodeNewGeometry")
        # Incoming points to the viewer, the ray away from it.
        ray = build.vector("SCALE", geometry.outputs["Incoming"], scale=-1.0)
        baked = _baked_ray(build, geometry, directional.view)
        cosine = None if baked is None else build.vector("DOT_PRODUCT", ray, baked)
        factor = _factor(build, ray, cosine, light, directional)
        other = build.emission(light, build.math("MULTIPLY", strength, factor))
        same = 0.0 if cosine is None else build.math("GREATER_THAN", cosine, SAME_DIRECTION)
        shader = build.mix(same, other, shader)
    rays, seen = build.node("ShaderNodeLightPath"), None
    for ray_kind in RAYS:
        found = rays.outputs[ray_kind]
        seen = found if seen is None else build.math("MAXIMUM", seen, found)
    output = build.node("ShaderNodeOutputMaterial")
    build.link(build.mix(seen, None, shader), output.inputs["Volume"])
    return material


def set_frame(material, scale: float, directional: DirectionalFactor | None, frame: int) -> None:
    """Key what a material of `light_material` knows of one frame: camera and suns."""
    if directional is None:
        return
    nodes = material.node_tree.nodes
    place = directional.view.position if directional.view.position is not None else directional.view.direction
    vectors = {VIEW: place} | {SUN.format(n + 1): d for n, d in enumerate(directional.lobe.directions)}
    for name, vector in vectors.items():
        node = nodes.get(name)
        if node is None or vector is None:
            continue
        for socket, value in zip(node.inputs, vector):
            socket.default_value = float(value)
            socket.keyframe_insert("default_value", frame=frame)


def _factor(build: "_Nodes", ray, cosine, light, directional: DirectionalFactor):
    """The socket of a DirectionalFactor along a ray; cosine: between it and the baked view's ray, or None."""
    mean = build.vector("DOT_PRODUCT", light, build.combine(*[1.0 / 3.0] * 3))
    fine = build.math("LOGARITHM", build.math("MAXIMUM", mean, DARK), math.e)
    separate = build.node("ShaderNodeSeparateXYZ")
    build.link(ray, separate.inputs[0])
    x, y, z = separate.outputs
    linear, quadratic, lobe, view, *cubic = map(build.attribute, DIRECTIONS)
    products = build.combine(build.math("MULTIPLY", x, y), build.math("MULTIPLY", y, z), build.math("MULTIPLY", x, z))
    squares = build.combine(
        build.math("SUBTRACT", build.math("MULTIPLY", x, x), build.math("MULTIPLY", y, y)),
        build.math("MULTIPLY_ADD", build.math("MULTIPLY", z, z), 3.0, -1.0),
        _lobe(build, ray, directional.lobe),
    )
    constants = build.node("ShaderNodeSeparateXYZ")
    build.link(view, constants.inputs[0])
    constant, correction, coarse = constants.outputs
    logarithm = build.math("SUBTRACT", constant, fine)
    vectors = ((linear, ray), (quadratic, products), (lobe, squares), *zip(cubic, _cubic(build, x, y, z)))
    for coefficients, terms in vectors:
        logarithm = build.math("ADD", logarithm, build.vector("DOT_PRODUCT", coefficients, terms))
    share: Any = math.exp(-directional.sharpness)
    if cosine is not None:
        fading = build.math("EXPONENT", build.math("MULTIPLY_ADD", cosine, SHARPNESS, -SHARPNESS))
        logarithm = build.math("MULTIPLY_ADD", correction, fading, logarithm)
        sharpness = directional.sharpness
        share = build.math("EXPONENT", build.math("MULTIPLY_ADD", cosine, sharpness, -sharpness))
    logarithm = build.math("MULTIPLY_ADD", build.math("SUBTRACT", fine, coarse), share, logarithm)
    logarithm = build.math("MAXIMUM", build.math("MINIMUM", logarithm, MAX_LOGARITHM), -MAX_LOGARITHM)
    return build.math("EXPONENT", logarithm)


def _cubic(build: "_Nodes", x, y, z) -> list:
    """The sockets of `cubic_terms`, three to a vector."""
    xx, yy, zz = (build.math("MULTIPLY", value, value) for value in (x, y, z))
    # x^2 - 3 y^2, 3 x^2 - y^2, x^2 - y^2 and 5 z^2 - 1.
    first = build.math("MULTIPLY_ADD", yy, -3.0, xx)
    second = build.math("SUBTRACT", build.math("MULTIPLY", xx, 3.0), yy)
    squares, axial = build.math("SUBTRACT", xx, yy), build.math("MULTIPLY_ADD", zz, 5.0, -1.0)
    terms = ((x, first), (y, second), (z, squares)), ((build.math("MULTIPLY", x, y), z), (x, axial), (y, axial))
    found = [build.combine(*(build.math("MULTIPLY", *factors) for factors in three)) for three in terms]
    # A grid of numbers gives a vector of three equal ones.
    return [*found, build.combine(build.math("MULTIPLY", z, build.math("SUBTRACT", axial, 2.0)), 0.0, 0.0)]


def _lobe(build: "_Nodes", ray, lobe: Lobe):
    """The socket of `Lobe.logarithm`."""
    g, total = lobe.anisotropy, None
    for number, (direction, weight) in enumerate(zip(lobe.directions, lobe.weights)):
        towards = build.combine(*map(float, direction), name=SUN.format(number + 1))
        cosine = build.vector("DOT_PRODUCT", ray, towards)
        # 4 pi times Henyey-Greenstein.
        square = build.math("MAXIMUM", build.math("MULTIPLY_ADD", cosine, -2.0 * g, 1.0 + g * g), 1e-6)
        value = build.math("MULTIPLY", build.math("POWER", square, -1.5), float(weight) * (1.0 - g * g))
        total = value if total is None else build.math("ADD", total, value)
    return build.math("LOGARITHM", total, math.e)


def _baked_ray(build: "_Nodes", geometry, view: BakedView):
    """The socket of the baked view's ray at the shaded point; None without a view."""
    if view.direction is not None:
        return build.combine(*map(float, view.direction), name=VIEW)
    if view.position is None:
        return None
    place = build.combine(*map(float, view.position), name=VIEW)
    return build.vector("NORMALIZE", build.vector("SUBTRACT", geometry.outputs["Position"], place))


class _Nodes:
    """Adds nodes to a tree; a value is a socket or a number."""

    def __init__(self, tree):
        self.tree = tree

    def node(self, kind: str, name: str = ""):
        made = self.tree.nodes.new(kind)
        if name:
            made.name = made.label = name
        # A grid that grows to the right, for whoever opens the Shader Editor.
        made.location = (180 * (len(self.tree.nodes) // 8), -160 * (len(self.tree.nodes) % 8))
        return made

    def link(self, source, target) -> None:
        if isinstance(source, (int, float, np.floating)):
            target.default_value = float(source)
        else:
            self.tree.links.new(source, target)

    def value(self, name: str, value: float):
        made = self.node("ShaderNodeValue", name)
        made.outputs[0].default_value = value
        return made.outputs[0]

    def emission(self, colour, strength):
        made = self.node("ShaderNodeEmission")
        self.link(colour, made.inputs["Color"])
        self.link(strength, made.inputs["Strength"])
        return made.outputs[0]

    def mix(self, factor, first, second):
        """A Mix Shader: the first at factor 0, None for nothing."""
        made = self.node("ShaderNodeMixShader")
        for value, socket in zip((factor, first, second), made.inputs):
            if value is not None:
                self.link(value, socket)
        return made.outputs[0]

    def attribute(self, name: str, output: str = "Vector"):
        made = self.node("ShaderNodeAttribute")
        made.attribute_name = name
        return made.outputs[output]

    def math(self, operation: str, *values):
        made = self.node("ShaderNodeMath")
        made.operation = operation
        for value, socket in zip(values, made.inputs):
            self.link(value, socket)
        return made.outputs[0]

    def vector(self, operation: str, *values, scale: float = 1.0):
        made = self.node("ShaderNodeVectorMath")
        made.operation = operation
        for value, socket in zip(values, made.inputs):
            self.link(value, socket)
        if operation == "SCALE":
            made.inputs["Scale"].default_value = scale
        return made.outputs["Value" if operation == "DOT_PRODUCT" else "Vector"]

    def combine(self, *values, name: str = ""):
        made = self.node("ShaderNodeCombineXYZ", name)
        for value, socket in zip(values, made.inputs):
            self.link(value, socket)
        return made.outputs[0]
