# SPDX-License-Identifier: GPL-3.0-or-later
"""The mean reflectance and emission of surface materials: what of them lights volumes."""

from dataclasses import dataclass, field
from typing import NoReturn

import bpy
import numpy as np

from .environment_image import linear_pixels
from .evaluation import NodeEvaluator, as_colour
from .sockets import Groups, Node, Source, Unsupported, active_output, input_of, source_of

# Points at which textures are evaluated, at random in the unit cube; and texels of images, which are evenly spaced.
POINTS, SEED = 1024, 5
# What Cycles gives surfaces without a material.
GREY = 0.8
# Input sockets that hold the colour of shaders that reflect.
COLOURS = {
    "ShaderNodeBsdfPrincipled": "Base Color",
    "ShaderNodeBsdfDiffuse": "Color",
    "ShaderNodeBsdfAnisotropic": "Color",
    "ShaderNodeBsdfGlossy": "Color",
    "ShaderNodeBsdfMetallic": "Base Color",
    "ShaderNodeBsdfSheen": "Color",
    "ShaderNodeBsdfVelvet": "Color",
    "ShaderNodeBsdfToon": "Color",
    "ShaderNodeSubsurfaceScattering": "Color",
}
DIFFUSE = {"ShaderNodeBsdfDiffuse", "ShaderNodeEmission"}
# Mean colours of images, by what they are known by.
_images: dict[tuple, np.ndarray] = {}


@dataclass
class SurfaceColour:
    """reflectance, emission: float64 (3,), as in `inference.Surface`. notes: what of the material is not respected."""

    reflectance: np.ndarray = field(default_factory=lambda: np.zeros(3))
    emission: np.ndarray = field(default_factory=lambda: np.zeros(3))
    notes: set[str] = field(default_factory=set)


def surface_colour(material: "bpy.types.Material | None") -> SurfaceColour:
    """Mean reflectance and emission of a material, or of none. Call on Blender's main thread or in a render."""
    if material is None:
        return SurfaceColour(np.full(3, GREY))
    output = active_output(material)
    if output is None:
        # Without nodes, the colour of the viewport.
        return SurfaceColour(np.clip(np.array(material.diffuse_color[:3], np.float64), 0.0, 1.0))
    found = SurfaceColour()
    try:
        found = _shader(source_of(output.inputs["Surface"]), found.notes)
    except Unsupported:
        found = SurfaceColour(np.full(3, GREY))
        found.notes.add("nodes that cannot be evaluated")
    found.reflectance = np.clip(np.nan_to_num(found.reflectance), 0.0, 1.0)
    found.emission = np.clip(np.nan_to_num(found.emission), 0.0, 1e30)
    return found


class _OnSurface(NodeEvaluator):
    """Evaluates sockets at random points; notes which of them vary."""

    def __init__(self, notes: set[str]) -> None:
        super().__init__(_RandomPoints())
        self.notes = notes

    def mean(self, node: Node, identifier: str, groups: Groups = ()) -> np.ndarray:
        """Mean colour (3,) of an input socket, or its own colour where what drives it cannot be evaluated."""
        try:
            values = self.colour(node, identifier, groups)
        except Unsupported:
            self.notes.add("nodes that cannot be evaluated")
            return as_colour(np.array(input_of(node, identifier).default_value, np.float64)[None, :3])[0]
        if len(values) > 1:
            self.notes.add("textures")
        return values.mean(axis=0)

    def _output(self, source: Source) -> np.ndarray:
        if source.node.bl_idname != "ShaderNodeTexImage":
            return super()._output(source)
        self.notes.add("textures")
        colour = _image_mean(source.node.image)
        return np.ones((1, 1)) if source.output.name == "Alpha" else colour[None]


class _RandomPoints:
    """Points of nodes that read coordinates; attributes are not known."""

    def __init__(self) -> None:
        self._places = np.random.default_rng(SEED).random((POINTS, 3))

    def coordinates(self, kind: str, node: Node) -> np.ndarray:
        return self._places

    def attribute(self, name: str, node: Node) -> NoReturn:
        raise Unsupported(f'node "{node.name}" ({node.bl_label}) reads an attribute')


def _shader(source: Source, notes: set[str]) -> SurfaceColour:
    node, groups = source.node, source.groups
    evaluator, found = _OnSurface(notes), SurfaceColour(notes=notes)
    if node is None:
        return found
    kind = node.bl_idname
    if kind in ("ShaderNodeMixShader", "ShaderNodeAddShader"):
        first, second = (_shader(source_of(socket, groups), notes) for socket in node.inputs if socket.type == "SHADER")
        a = b = 1.0
        if kind == "ShaderNodeMixShader":
            b = float(np.clip(evaluator.mean(node, node.inputs[0].identifier, groups)[0], 0.0, 1.0))
            a = 1.0 - b
        found.reflectance = a * first.reflectance + b * second.reflectance
        found.emission = a * first.emission + b * second.emission
        return found
    if kind not in DIFFUSE:
        notes.add("gloss")
    if kind in COLOURS:
        found.reflectance = evaluator.mean(node, COLOURS[kind], groups)
    if any(socket.identifier == "Normal" and socket.is_linked for socket in node.inputs):
        notes.add("normal maps")
    if kind == "ShaderNodeEmission":
        found.emission = evaluator.mean(node, "Color", groups) * evaluator.mean(node, "Strength", groups)
    elif kind == "ShaderNodeBsdfPrincipled":
        strength = evaluator.mean(node, "Emission Strength", groups)
        if strength.any():
            found.emission = strength * evaluator.mean(node, "Emission Color", groups)
        # A plain plastic: its gloss matters little.
        if not evaluator.mean(node, "Metallic", groups).any():
            notes.discard("gloss")
    return found


def _image_mean(image: "bpy.types.Image") -> np.ndarray:
    """Mean colour (3,) of an image. Raises Unsupported where it cannot be read."""
    if image is None:
        raise Unsupported("the image is missing")
    key = (image.name_full, image.filepath, *image.size)
    if key not in _images or image.is_dirty:
        try:
            _images[key] = linear_pixels(image).mean(axis=(0, 1), dtype=np.float64)
        except ValueError as problem:
            raise Unsupported(str(problem)) from None
    return _images[key]
