# SPDX-License-Identifier: GPL-3.0-or-later
"""The World's light as an environment."""

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from ...inference.scene import Environment, Sun, soft_sun
from ..nodes.evaluation import NodeEvaluator, Nowhere
from ..nodes.light_shader import BACKGROUND, EMISSION, emitted
from ..nodes.sockets import Unsupported, active_output, source_of
from ..objects.ignored_settings import WORLD, ignored_settings
from ..objects.visibility import evaluated_world
from .picture import WorldSource, is_known, reads_depth, view_coordinates, world_picture, world_source
from .process import PictureFailed
from .sphere import Sphere

#: Of a World with a volume, after its name.
WORLD_FOG = "its fog is not rendered; use a large cube around the scene with the same volume shader"


def is_wanted(depsgraph: "bpy.types.Depsgraph") -> bool:
    """Whether Cycles has to render the World before `read_world` knows its light."""
    scene, world = depsgraph.scene, evaluated_world(depsgraph)
    if world is None or not _visible_to_volumes(world):
        return False
    try:
        _radiance(world, active_output(world), Sphere(1, images=False))
    except Unsupported:
        return not is_known(world, scene)
    return False


def wanted_world(depsgraph: "bpy.types.Depsgraph") -> list[WorldSource]:
    """Sources that Cycles has to render before `read_world` knows the World's light: one or none."""
    return [world_source(evaluated_world(depsgraph), depsgraph.scene)] if is_wanted(depsgraph) else []


def read_world(
    depsgraph: "bpy.types.Depsgraph", check: Callable[[], None] = lambda: None
) -> tuple[list[Sun], list[Environment], list[str]]:
    """The World's light in volumes: suns of its discs, an Environment of the rest, if it shines, and warnings.

    check: called often while Cycles renders.

    Cycles renders a World whose nodes cannot be evaluated. Where that fails, or its light cannot be read, it is left
    out with a warning that names it.
    """
    scene, world = depsgraph.scene, evaluated_world(depsgraph)
    if world is None:
        return [], [], []
    name = f'World "{world.name}"'
    warnings = ignored_settings(world, WORLD, name)
    output = active_output(world)
    warnings += fog_warnings(world)
    if not _visible_to_volumes(world):
        return [], [], warnings
    sphere = Sphere()
    discs: list[Sun] = []
    try:
        radiance = _light(world, output, sphere)
        warnings += _light_warnings(radiance, name)
        radiance = np.where(np.isfinite(radiance) & (radiance > 0.0), radiance, 0.0)
    except Unsupported as problem:
        try:
            radiance, discs = _picture(world, scene, sphere, name, check)
        except PictureFailed as failure:
            return [], [], warnings + [f"{name}: {problem}; {failure}; its light is not rendered"]
        if coordinates := view_coordinates(world):
            warnings.append(
                f"{name} reads Texture Coordinate > {' and '.join(coordinates)}, which depends on the view; "
                "volumes get its light for a different view"
            )
        if reads_depth(world):
            warnings.append(f"{name} reads Light Path > Ray Depth; volumes get its light for a Ray Depth of 1")
    found = [Environment(sphere.image(radiance), name=name)] if radiance.max() > 0.0 else []
    return discs, found, warnings


def fog_warnings(world: "bpy.types.World | None") -> list[str]:
    """Warning of a World with a volume."""
    output = None if world is None else active_output(world)
    if world is None or output is None or source_of(output.inputs["Volume"]).node is None:
        return []
    return [f'World "{world.name}": {WORLD_FOG}']


def surface_light_warnings(depsgraph: "bpy.types.Depsgraph") -> list[str]:
    """Warnings of a scene with surfaces, where these see the World and volumes do not, or the other way round."""
    world = evaluated_world(depsgraph)
    # Properties of Cycles, absent while Cycles is disabled.
    visibility = getattr(world, "cycles_visibility", None)
    if visibility is None or visibility.diffuse == visibility.scatter:
        return []
    if visibility.diffuse:
        ignored = "volume scatter rays; surfaces do not reflect its light into volumes either"
    else:
        ignored = "diffuse rays, which has no effect: surfaces reflect its light into volumes"
    return [f'World "{world.name}" is hidden from {ignored}']


def _picture(
    world: "bpy.types.World", scene: "bpy.types.Scene", sphere: Sphere, name: str, check: Callable[[], None]
) -> tuple[np.ndarray, list[Sun]]:
    """Radiance (n, 3) at the sphere's directions and the Suns of discs, rendered by Cycles. Raises PictureFailed."""
    picture, discs = world_picture(world, scene, check), []
    for x, y, z, red, green, blue, angle in picture.suns:
        discs += soft_sun((x, y, z), (red, green, blue), angle, name=f"sun of {name}")
    return np.maximum(picture.radiance(sphere.directions), 0.0), discs


def lights_volumes(world: "bpy.types.World") -> bool:
    """Whether a World's light reaches volumes, without reading images: fast enough for a panel."""
    if world is None or not _visible_to_volumes(world):
        return False
    try:
        return bool(_radiance(world, active_output(world), Sphere(4, images=False)).any())
    except Unsupported:
        return True


def _visible_to_volumes(world: "bpy.types.World") -> bool:
    # Properties of Cycles, absent while Cycles is disabled.
    visibility = getattr(world, "cycles_visibility", None)
    return visibility is None or visibility.scatter


def constant_background(world: "bpy.types.World") -> np.ndarray:
    """(3,) radiance of an evaluated World that cameras see as one colour.

    Raises Unsupported, naming the node, where it is not known to be uniform.
    """
    return _radiance(world, active_output(world), _Anywhere())[0]


class _Anywhere(Nowhere):
    """Every direction that a camera sees."""

    directions, visible_to_camera = np.zeros((1, 3)), True


def _radiance(world: "bpy.types.World", output: Any, points: Any) -> np.ndarray:
    """(n, 3) radiance at the directions of `points`, where it is positive; NaN is 0, as in Cycles."""
    light = _light(world, output, points)
    return np.where(light > 0.0, light, 0.0)


def _light(world: "bpy.types.World", output: Any, points: Any) -> np.ndarray:
    """(n, 3) what the nodes emit at the directions of `points`."""
    if output is None:
        # Without nodes, Blender before 5.0 renders the World's colour.
        plain = bpy.app.version < (5, 0, 0) and not world.use_nodes
        return np.broadcast_to(np.array(world.color) if plain else np.zeros(3), points.directions.shape)
    light = emitted(NodeEvaluator(points), source_of(output.inputs["Surface"]), (BACKGROUND, EMISSION))
    return np.broadcast_to(light, points.directions.shape)


def _light_warnings(light: np.ndarray, name: str) -> list[str]:
    """Warnings of what a World emits and shows no light."""
    if not np.isfinite(light).all():
        return [f"{name}: its light is not finite; check its drivers and nodes"]
    if light.min() < 0.0:
        return [f"{name}: its light is negative in places and counts as 0 there; set its strength above 0"]
    return []
