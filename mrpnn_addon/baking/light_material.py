# SPDX-License-Identifier: GPL-3.0-or-later
"""The material that shows baked light: `inference.LitVolume.towards` as shader nodes."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import bpy
import numpy as np

from ...inference.baking.directional_factor import (
    ANCHORS,
    MAX_LOGARITHM,
    SAME_DIRECTION,
    SHARPNESS,
    BakedView,
    DirectionalFactor,
    Lobe,
)
from ..nodes.material import LIGHT_MARK
from ..nodes.sockets import Node, Socket
from ..vdb.light_file import COLOURS, DENSITY, LIGHT, anchor_grids, smooth_grids

# Property of a material: `_shape` of its nodes.
SHAPE = "mrpnn_shape"
#: Nodes whose values change from frame to frame.
SCALE, VIEW, UP, SUN = "Brightness", "Baked From", "Baked Upwards", "Sun {}"


# Rays that see the light. Cycles follows rays that volumes scatter one step even at 0 volume bounces, and would add the
# light twice; the visibility of objects to such rays does not apply inside volumes.
RAYS = ("Is Camera Ray", "Is Diffuse Ray", "Is Glossy Ray", "Is Transmission Ray")
# Light, as it is written, below which nobody sees it.
DARK = 1e-7

# EEVEE reads 16 grids at most before Blender 5.2, and of materials that read more it shows nothing. With the grids of
# colours there are 18.
EEVEE_READS_ALL = bpy.app.version >= (5, 2, 0)

# What drives an input: the output of a node, a number, or three.
Value = Socket | float | tuple[float, ...]


def light_material(name: str, scale: float, directional: DirectionalFactor | None) -> "bpy.types.Material":
    """A new material for a Volume object that loads a file of `vdb.light_file.write_light`.

    Branches are Mix Shaders, because Cycles evaluates only the nodes that it needs of these.
    """
    material = bpy.data.materials.new(name)
    if not material.node_tree:
        material.use_nodes = True
    # So that a change of it counts as none of the scene.
    material[LIGHT_MARK] = material.node_tree[LIGHT_MARK] = name
    material[SHAPE] = _shape(directional)
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
        logarithm = _logarithm(build, ray, baked, cosine, light, directional)
        other = build.vector("SCALE", light, scale=build.limited_exponential(logarithm))
        same = 0.0 if cosine is None else build.math("GREATER_THAN", cosine, SAME_DIRECTION)
        grey, shader = shader, build.mix(same, build.emission(other, strength), shader)
        if directional.colours is not None:
            turned = ray if baked is None else build.vector("SUBTRACT", ray, baked)
            coloured = build.mix(same, build.emission(_coloured(build, light, logarithm, turned), strength), grey)
            if not EEVEE_READS_ALL:
                _output(build, coloured, "CYCLES")
                _output(build, shader, "EEVEE")
                return material
            shader = coloured
    _output(build, shader, "ALL")
    return material


def _output(build: "_Nodes", shader: Socket, engine: str) -> None:
    """What an engine, or all of them, shows to the rays that see the light."""
    rays, seen = build.node("ShaderNodeLightPath"), None
    for ray_kind in RAYS:
        found = rays.outputs[ray_kind]
        seen = found if seen is None else build.math("MAXIMUM", seen, found)
    output = build.node("ShaderNodeOutputMaterial")
    output.target = engine
    build.link(build.mix(seen, None, shader), output.inputs["Volume"])


def set_frame(material: "bpy.types.Material", scale: float, directional: DirectionalFactor | None, frame: int) -> None:
    """Key what a material of `light_material` knows of one frame: brightness, camera and suns."""
    for socket, value in _values(material, scale, directional):
        socket.default_value = value
        socket.keyframe_insert("default_value", frame=frame)


def reuse(material: "bpy.types.Material | None", scale: float, directional: DirectionalFactor | None) -> bool:
    """Have a material of `light_material` show other light; False where that needs other nodes.

    It is a hundredth of the work, and Blender compiles nothing.
    """
    if material is None or material.get(SHAPE) != _shape(directional) or material.node_tree.animation_data:
        return False
    for socket, value in _values(material, scale, directional):
        socket.default_value = value
    return True


def _values(
    material: "bpy.types.Material", scale: float, directional: DirectionalFactor | None
) -> Iterator[tuple[Any, float]]:
    """Sockets that hold how bright the light is, where it was baked from and where suns are, and their values."""
    yield material.node_tree.nodes[SCALE].outputs[0], scale
    if directional is None:
        return
    view, nodes = directional.view, material.node_tree.nodes
    place = view.position if view.position is not None else view.direction
    vectors = {VIEW: place, UP: view.up}
    vectors |= {SUN.format(number + 1): towards for number, towards in enumerate(directional.lobe.directions)}
    for name, vector in vectors.items():
        node: Any = nodes.get(name)
        if node is not None and vector is not None:
            yield from zip(node.inputs, map(float, vector))


def _shape(directional: DirectionalFactor | None) -> str:
    """What decides which nodes a material has, and all numbers in them but those of `_values`."""
    if directional is None:
        return ""
    view, lobe = directional.view, directional.lobe
    kind = view.position is not None, view.direction is not None
    numbers = lobe.weights.tolist(), lobe.anisotropy, directional.sharpness
    return repr((kind, numbers, directional.anchors.values.shape[3], directional.colours is not None))


def _logarithm(
    build: "_Nodes",
    ray: Value,
    baked: Value,
    cosine: Value,
    light: Value,
    directional: DirectionalFactor,
) -> Socket:
    """The socket of the logarithm of the light along a ray over that along the baked one, mean over the colours.

    baked: the baked view's ray, or None. cosine: between both, or None. light: along the baked ray.
    """
    mean = build.vector("DOT_PRODUCT", light, (1.0 / 3.0,) * 3)
    fine = build.math("LOGARITHM", build.math("MAXIMUM", mean, DARK), math.e)
    share: Any = math.exp(-directional.sharpness)
    if cosine is not None:
        share = build.exponential(cosine, directional.sharpness)
    # Of the light's own logarithm, to which the smooth terms give the rest.
    logarithm = build.math("MULTIPLY", fine, build.math("SUBTRACT", share, 1.0))
    for names, terms, unit in (
        (smooth_grids(), _smooth(build, ray, directional.lobe), 1.0),
        (anchor_grids(directional), _anchors(build, ray, baked, share, directional.view), math.exp(-SHARPNESS)),
    ):
        total: Value = (0.0, 0.0, 0.0)
        for name, three in zip(names, terms):
            total = build.vector("MULTIPLY_ADD", build.attribute(name), three, total)
        logarithm = build.math("ADD", logarithm, build.vector("DOT_PRODUCT", total, (unit,) * 3))
    return logarithm


def _coloured(build: "_Nodes", light: Value, logarithm: Value, turned: Value) -> Socket:
    """The socket of the light along a ray, each colour of which changes in its own way.

    logarithm: see `_logarithm`. turned: how much the ray differs from the baked one.
    """
    slopes = [build.vector("DOT_PRODUCT", build.attribute(name), turned) for name in COLOURS]
    factors = [build.limited_exponential(build.math("ADD", logarithm, slope)) for slope in slopes]
    return build.vector("MULTIPLY", light, build.combine(*factors))


def _smooth(build: "_Nodes", ray: Value, lobe: Lobe) -> list:
    """The sockets of `directional_terms`, three to a vector."""
    x, y, z = build.separate(ray)
    xx, yy, zz = build.separate(build.vector("MULTIPLY", ray, ray))
    xy, yz, xz = build.math("MULTIPLY", x, y), build.math("MULTIPLY", y, z), build.math("MULTIPLY", x, z)
    squares, axial = build.math("SUBTRACT", xx, yy), build.math("MULTIPLY_ADD", zz, 3.0, -1.0)
    # x^2 - 3 y^2, 3 x^2 - y^2, 5 z^2 - 1 and 5 z^2 - 3.
    first, second = build.math("MULTIPLY_ADD", yy, -3.0, xx), build.math("MULTIPLY_ADD", xx, 2.0, squares)
    steep, last = (build.math("MULTIPLY_ADD", zz, 5.0, constant) for constant in (-1.0, -3.0))
    factors = (x, first), (y, second), (z, squares), (xy, z), (x, steep), (y, steep), (z, last)
    cubic = [build.math("MULTIPLY", *pair) for pair in factors]
    return build.triples([1.0, x, y, z, xy, yz, xz, squares, axial, *cubic, _lobe(build, ray, lobe)])


def _anchors(build: "_Nodes", ray: Value, baked: Value, share: Value, view: BakedView) -> list:
    """The sockets of what the coefficients of anchors multiply, times exp(SHARPNESS), three to a vector."""
    terms = [build.math("MULTIPLY", share, -math.exp(SHARPNESS))]
    if baked is not None:
        up = build.combine(*map(float, view.up), name=UP)
        across = build.vector("NORMALIZE", build.vector("CROSS_PRODUCT", baked, up))
        axes = across, build.vector("CROSS_PRODUCT", across, baked), baked
        local = build.combine(*(build.vector("DOT_PRODUCT", ray, axis) for axis in axes))
        sharpened = [tuple(SHARPNESS * float(value) for value in anchor) for anchor in ANCHORS]
        terms += [build.math("EXPONENT", build.vector("DOT_PRODUCT", local, anchor)) for anchor in sharpened]
    return build.triples(terms)


def _lobe(build: "_Nodes", ray: Value, lobe: Lobe) -> Value:
    """The socket of `Lobe.logarithm`."""
    g, total = lobe.anisotropy, None
    if g == 0.0:
        return 0.0
    for number, (direction, weight) in enumerate(zip(lobe.directions, lobe.weights)):
        towards = build.combine(*map(float, direction), name=SUN.format(number + 1))
        cosine = build.vector("DOT_PRODUCT", ray, towards)
        # 4 pi times Henyey-Greenstein.
        square = build.math("MAXIMUM", build.math("MULTIPLY_ADD", cosine, -2.0 * g, 1.0 + g * g), 1e-6)
        value = build.math("MULTIPLY", build.math("POWER", square, -1.5), float(weight) * (1.0 - g * g))
        total = value if total is None else build.math("ADD", total, value)
    return build.math("LOGARITHM", total, math.e)


def _baked_ray(build: "_Nodes", geometry: Node, view: BakedView) -> Socket | None:
    """The socket of the baked view's ray at the shaded point; None without a view."""
    if view.direction is not None:
        return build.combine(*map(float, view.direction), name=VIEW)
    if view.position is None:
        return None
    place = build.combine(*map(float, view.position), name=VIEW)
    return build.vector("NORMALIZE", build.vector("SUBTRACT", geometry.outputs["Position"], place))


class _Nodes:
    """Adds nodes to a tree; a value is a socket or a number."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree

    def node(self, kind: str, name: str = "") -> Node:
        made = self.tree.nodes.new(kind)
        if name:
            made.name = made.label = name
        # A grid that grows to the right, for whoever opens the Shader Editor.
        made.location = (180 * (len(self.tree.nodes) // 8), -160 * (len(self.tree.nodes) % 8))
        return made

    def link(self, source: Value, target: Socket) -> None:
        if isinstance(source, (int, float, np.floating)):
            target.default_value = float(source)
        elif isinstance(source, tuple):
            target.default_value = source
        else:
            self.tree.links.new(source, target)

    def value(self, name: str, value: float) -> Socket:
        made = self.node("ShaderNodeValue", name)
        made.outputs[0].default_value = value
        return made.outputs[0]

    def emission(self, colour: Value, strength: Value) -> Socket:
        made = self.node("ShaderNodeEmission")
        self.link(colour, made.inputs["Color"])
        self.link(strength, made.inputs["Strength"])
        return made.outputs[0]

    def mix(self, factor: Value, first: Value, second: Value) -> Socket:
        """A Mix Shader: the first at factor 0, None for nothing."""
        made = self.node("ShaderNodeMixShader")
        for value, socket in zip((factor, first, second), made.inputs):
            if value is not None:
                self.link(value, socket)
        return made.outputs[0]

    def attribute(self, name: str, output: str = "Vector") -> Socket:
        made = self.node("ShaderNodeAttribute")
        made.attribute_name = name
        return made.outputs[output]

    def math(self, operation: str, *values: Value) -> Socket:
        made = self.node("ShaderNodeMath")
        made.operation = operation
        for value, socket in zip(values, made.inputs):
            self.link(value, socket)
        return made.outputs[0]

    def vector(self, operation: str, *values: Value, scale: Value = 1.0) -> Socket:
        made = self.node("ShaderNodeVectorMath")
        made.operation = operation
        for value, socket in zip(values, made.inputs):
            self.link(value, socket)
        if operation == "SCALE":
            self.link(scale, made.inputs["Scale"])
        return made.outputs["Value" if operation == "DOT_PRODUCT" else "Vector"]

    def exponential(self, cosine: Value, sharpness: float) -> Socket:
        """exp(sharpness (cosine - 1))."""
        return self.math("EXPONENT", self.math("MULTIPLY_ADD", cosine, sharpness, -sharpness))

    def limited_exponential(self, logarithm: Value) -> Socket:
        limited = self.math("MAXIMUM", self.math("MINIMUM", logarithm, MAX_LOGARITHM), -MAX_LOGARITHM)
        return self.math("EXPONENT", limited)

    def separate(self, vector: Value) -> Any:
        made = self.node("ShaderNodeSeparateXYZ")
        self.link(vector, made.inputs[0])
        return made.outputs

    def triples(self, values: Sequence[Value]) -> list:
        """Vectors of three values each, the last filled up with zeros."""
        values = [*values, *[0.0] * (-len(values) % 3)]
        return [self.combine(*values[start : start + 3]) for start in range(0, len(values), 3)]

    def combine(self, *values: Value, name: str = "") -> Socket:
        made = self.node("ShaderNodeCombineXYZ", name)
        for value, socket in zip(values, made.inputs):
            self.link(value, socket)
        return made.outputs[0]
