"""The World's light as a few directions of parallel light."""

from typing import List, Tuple

import bpy
import numpy as np
from mathutils import Vector

from ...inference.scene import Sun
from ..nodes.evaluation import NodeValues, Nowhere
from ..nodes.sockets import Unsupported, active_output, input_of, source_of
from ..objects.lights import disc_directions
from ..objects.visibility import evaluated_world
from .picture import WorldSource, is_known, world_picture, world_source
from .process import PictureFailed
from .quadrature import Sphere, quadrature

# A World hardly counts where it gives less than this share of the suns' light: half the directions do.
HARDLY = 0.1
LUMA = np.array([0.2126, 0.7152, 0.0722])


def wanted_world(depsgraph) -> List[WorldSource]:
    """What Cycles has to show of the World before `read_world` can tell its light: one or none."""
    scene, world = depsgraph.scene, evaluated_world(depsgraph)
    if world is None or scene.mrpnn.world_directions < 1 or not _lights_volumes(world):
        return []
    try:
        _radiance(world, active_output(world), Sphere(1, images=False))
    except Unsupported:
        return [] if is_known(world, scene) else [world_source(world, scene)]
    return []


def read_world(depsgraph, suns: List[Sun], check=lambda: None) -> Tuple[List[Sun], List[str]]:
    """Parallel lights that stand for the World's light in volumes, and warnings.

    suns: of the scene; beside bright ones the World needs fewer directions. check: called often while Cycles shows it.

    A World with nodes that cannot be evaluated is as Cycles shows it. Where that fails, or the World has light that cannot
    be read, it is left out with a warning that names it.
    """
    scene, world = depsgraph.scene, evaluated_world(depsgraph)
    directions = scene.mrpnn.world_directions
    if world is None:
        return [], []
    name, warnings = f"World \"{world.name}\"", []
    output = active_output(world)
    if output is not None and source_of(output.inputs['Volume']).node is not None:
        warnings.append(f"{name}: its fog is not rendered")
    if not _lights_volumes(world):
        return [], warnings
    sphere, discs = Sphere(), []
    try:
        radiance = _radiance(world, output, sphere)
    except Unsupported as problem:
        if directions < 1:
            return [], warnings + [f"{name} is left out: the setting World Directions is 0"]
        try:
            radiance, discs = _picture(world, scene, sphere, name, check)
        except PictureFailed as failure:
            return [], warnings + [f"{name}: {problem}; {failure}; its light is not rendered"]
    if not radiance.max() > 0.0 and not discs:
        return [], warnings
    if directions < 1:
        return [], warnings + [f"{name} is left out: the setting World Directions is 0"]
    suns = suns + discs
    count = _count(float((radiance * sphere.solid_angle[:, None]).sum(axis=0) @ LUMA), suns, directions)
    lights = quadrature(sphere, radiance, count, name) if count else []
    beside = " beside its sun" if discs else ""
    return discs + lights, warnings + [f"{name} is rendered as parallel light from {len(lights)} directions{beside}"]


def _picture(world, scene, sphere, name, check):
    """Radiance (n, 3) at the sphere's directions and the Suns of discs, as Cycles shows them. Raises PictureFailed."""
    picture, discs = world_picture(world, scene, check), []
    for x, y, z, red, green, blue, angle in picture.suns:
        frame = np.array(Vector((x, y, z)).to_track_quat('Z', 'Y').to_matrix())
        discs += [Sun(direction, share * np.array([red, green, blue]), name=f"sun of {name}")
                  for direction, share in disc_directions(frame, angle)]
    return np.maximum(picture.radiance(sphere.directions), 0.0), discs


def expected_lights(world, suns: List[Sun], directions: int) -> int:
    """About how many lights `read_world` gives; looks at no image, so that a panel may ask."""
    if world is None or not _lights_volumes(world):
        return 0
    try:
        radiance = _radiance(world, active_output(world), Sphere(1, images=False))
    except Unsupported:
        return directions
    return _count(4.0 * np.pi * float(radiance.mean(axis=0) @ LUMA), suns, directions)


def _count(fluence: float, suns, directions: int) -> int:
    if not fluence > 0.0:
        return 0
    others = sum(float(sun.irradiance @ LUMA) for sun in suns)
    return (directions + 1) // 2 if fluence < HARDLY * others else directions


def _lights_volumes(world) -> bool:
    # Cycles' own properties, gone while Cycles is disabled.
    visibility = getattr(world, 'cycles_visibility', None)
    return visibility is None or visibility.scatter


def constant_background(world) -> np.ndarray:
    """(3,): the radiance of an evaluated World that cameras see as one colour.

    Raises Unsupported, naming the node, where it is not known to be one.
    """
    return _radiance(world, active_output(world), _Anywhere())[0]


class _Anywhere(Nowhere):
    """Every direction that a camera sees."""

    directions, seen_by_camera = np.zeros((1, 3)), True


def _radiance(world, output, points) -> np.ndarray:
    """(n, 3) at the directions of `points`."""
    if output is None:
        # Without nodes, Blender before 5.0 shows the World's own colour.
        plain = bpy.app.version < (5, 0, 0) and not world.use_nodes
        return np.broadcast_to(np.array(world.color) if plain else np.zeros(3), points.directions.shape)
    light = _surface(NodeValues(points), source_of(output.inputs['Surface']))
    return np.broadcast_to(np.maximum(light, 0.0), points.directions.shape)


def _surface(values: NodeValues, source) -> np.ndarray:
    node, groups = source.node, source.groups
    if node is None:
        return np.zeros((1, 3))
    if node.bl_idname in ('ShaderNodeBackground', 'ShaderNodeEmission'):
        return values.number(node, "Strength", groups) * values.colour(node, "Color", groups)
    if node.bl_idname == 'ShaderNodeAddShader':
        first, second = (_surface(values, source_of(socket, groups)) for socket in node.inputs)
        return first + second
    if node.bl_idname == 'ShaderNodeMixShader':
        factor = np.clip(values.number(node, "Fac", groups), 0.0, 1.0)
        # A shader that nothing is taken of need not be one that can be evaluated.
        shares = (("Shader", 1.0 - factor), ("Shader_001", factor))
        return sum((share * _surface(values, source_of(input_of(node, name), groups)) for name, share in shares
                    if share.any()), np.zeros((1, 3)))
    raise Unsupported(f"node \"{node.name}\" ({node.bl_label}) cannot be evaluated")
