# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture nodes: what their sockets say, for the textures of `mrpnn_addon.textures`.

Functions as in `functions`.
"""

from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..textures import image, patterns
from ..textures.gabor import gabor
from ..textures.noise import Fractal, noise_texture
from ..textures.voronoi import Voronoi
from .environment_image import environment_image, read_pixels, require_readable
from .math_operations import divide
from .sockets import Groups, Node, Socket, unsupported

if TYPE_CHECKING:
    from .evaluation import NodeEvaluator

# Whether Voronoi cells are hashed by PCG rather than lookup3.
PCG = bpy.app.version >= (5, 0, 0)


def texture_vector(values: "NodeEvaluator", node: Node, groups: Groups) -> np.ndarray:
    """(n, 3) coordinates of a texture; Generated where none are linked."""
    if values.is_linked(node, "Vector", groups):
        return values.colour(node, "Vector", groups)
    return values.points.coordinates("generated", node)


def _points(values: "NodeEvaluator", node: Node, groups: Groups, dimensions: str, scaled: bool = True) -> np.ndarray:
    """Coordinates (n, d) of a texture in "1D" to "4D", scaled by its socket."""
    parts = []
    if dimensions != "1D":
        parts.append(texture_vector(values, node, groups)[:, : min(int(dimensions[0]), 3)])
    if dimensions in ("1D", "4D"):
        parts.append(values.number(node, "W", groups))
    most = max(len(part) for part in parts)
    points = np.concatenate([np.broadcast_to(part, (most, part.shape[1])) for part in parts], axis=1)
    return points * values.number(node, "Scale", groups) if scaled else points


def _numbers(values: "NodeEvaluator", node: Node, groups: Groups, *names: str) -> dict[str, np.ndarray]:
    return {name.lower().replace(" ", "_"): values.number(node, name, groups) for name in names}


def _noise(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    settings = _numbers(values, node, groups, "Detail", "Roughness", "Lacunarity", "Offset", "Gain")
    fractal = Fractal(node.noise_type, **settings, normalize=node.normalize)
    points = _points(values, node, groups, node.noise_dimensions)
    return noise_texture(points, fractal, values.number(node, "Distortion", groups), output.type == "RGBA")


def _voronoi(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    settings = _numbers(
        values, node, groups, "Detail", "Roughness", "Lacunarity", "Smoothness", "Exponent", "Randomness"
    )
    voronoi = Voronoi(node.feature, node.distance, **settings, normalize=node.normalize, pcg=PCG)
    points = _points(values, node, groups, node.voronoi_dimensions)
    if node.feature == "DISTANCE_TO_EDGE":
        return voronoi.edge(points)
    if node.feature == "N_SPHERE_RADIUS":
        return voronoi.radius(points)
    distance, colour, position = voronoi.cells(points)
    if output.identifier == "Distance":
        return distance
    if output.identifier == "Color":
        return colour
    position = divide(position, values.number(node, "Scale", groups))
    if output.identifier == "W":
        return position[:, -1:]
    position = position[:, : 0 if node.voronoi_dimensions == "1D" else 3]
    return np.pad(position, ((0, 0), (0, 3 - position.shape[1])))


def _gradient(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    return patterns.gradient(texture_vector(values, node, groups), node.gradient_type)


def _wave(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    rings = node.wave_type == "RINGS"
    wave = patterns.Wave(
        rings,
        node.rings_direction if rings else node.bands_direction,
        node.wave_profile,
        *_numbers(
            values, node, groups, "Distortion", "Detail", "Detail Scale", "Detail Roughness", "Phase Offset"
        ).values(),
    )
    return wave.at(_points(values, node, groups, "3D"))


def _magic(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    points, distortion = _points(values, node, groups, "3D"), values.number(node, "Distortion", groups)
    colour = patterns.magic(points, node.turbulence_depth, distortion)
    return colour if output.identifier == "Color" else colour.mean(axis=1, keepdims=True)


def _checker(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    first = patterns.checker(_points(values, node, groups, "3D"))
    if output.identifier == "Fac":
        return first
    return np.where(first > 0.0, values.colour(node, "Color1", groups), values.colour(node, "Color2", groups))


def _brick(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    sockets = _numbers(values, node, groups, "Mortar Size", "Mortar Smooth", "Bias", "Brick Width", "Row Height")
    brick = patterns.Brick(node.offset, node.offset_frequency, node.squash, node.squash_frequency, *sockets.values())
    tint, mortar = brick.at(_points(values, node, groups, "3D"))
    if output.identifier == "Fac":
        return mortar
    first, second, between = (values.colour(node, name, groups) for name in ("Color1", "Color2", "Mortar"))
    colour = first + tint * (second - first)
    return colour + mortar * (between - colour)


def _white_noise(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    points = _points(values, node, groups, node.noise_dimensions, scaled=False)
    return patterns.white_noise(points, output.identifier == "Color")


def _gabor(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    if node.gabor_type == "2D":
        orientation = values.number(node, "Orientation 2D", groups)
    else:
        orientation = values.colour(node, "Orientation 3D", groups)
    frequency, anisotropy = (values.number(node, name, groups) for name in ("Frequency", "Anisotropy"))
    found = gabor(_points(values, node, groups, node.gabor_type), frequency, anisotropy, orientation)
    return found[("Value", "Phase", "Intensity").index(output.identifier)]


def _image(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    try:
        # Copies of nodes hold what was read.
        pixels = node.image if isinstance(node.image, image.ImagePixels) else read_pixels(node.image)
    except ValueError as problem:
        raise unsupported(node, str(problem)) from None
    if node.projection == "BOX":
        raise unsupported(node, "the projection Box, which needs a surface,")
    if output.identifier == "Color" and (pixels.pixels[..., 3] < 1.0).any():
        raise unsupported(node, "the color of an image with transparent pixels")
    uv = image.project(texture_vector(values, node, groups), node.projection)
    found = image.sample(pixels, uv, node.interpolation, node.extension)
    return found[:, :3] if output.identifier == "Color" else found[:, 3:]


def _environment(values: "NodeEvaluator", node: Node, output: Socket, groups: Groups) -> np.ndarray:
    images = getattr(values.points, "images", None)
    if images is None:
        raise unsupported(node, "an environment image outside of a World")
    if node.projection != "EQUIRECTANGULAR" or output.identifier != "Color":
        raise unsupported(node, f"{output.name} in projection {node.projection}")
    if values.is_linked(node, "Vector", groups):
        vector = values.colour(node, "Vector", groups)
    else:
        vector = values.points.coordinates("world", node)
    try:
        if images:
            return environment_image(node.image)(vector)
        require_readable(node.image)
        return np.ones_like(vector)
    except ValueError as problem:
        raise unsupported(node, str(problem)) from None


TEXTURES = {
    "ShaderNodeTexNoise": _noise,
    "ShaderNodeTexVoronoi": _voronoi,
    "ShaderNodeTexGradient": _gradient,
    "ShaderNodeTexWave": _wave,
    "ShaderNodeTexMagic": _magic,
    "ShaderNodeTexChecker": _checker,
    "ShaderNodeTexBrick": _brick,
    "ShaderNodeTexWhiteNoise": _white_noise,
    "ShaderNodeTexGabor": _gabor,
    "ShaderNodeTexImage": _image,
    "ShaderNodeTexEnvironment": _environment,
}
