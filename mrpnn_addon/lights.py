"""Sun lamps as `Sun`; what else lights the scene, as warnings."""

import math
from typing import List, Tuple

import bpy
import numpy as np

from ..inference.scene import SceneError, Sun
from .sockets import Unsupported, active_output, constant, linked_node
from .visibility import Shown

# The sun's own disc spans about half a degree.
PARALLEL_ANGLE = math.radians(1.0)


def read_sun(shown: Shown) -> Tuple[Sun, List[str]]:
    """A visible sun lamp and warnings.

    The sun shines along the object's -Z, so the direction towards it is +Z. Its irradiance is
    strength x colour in W/m^2, times 2^exposure, the colour of its temperature and its nodes where
    this version of Blender has them.

    Raises SceneError for light nodes that cannot be evaluated.
    """
    lamp = shown.object.data
    irradiance = lamp.energy * np.array(lamp.color, dtype=np.float64)
    irradiance *= 2.0 ** getattr(lamp, 'exposure', 0.0)
    if getattr(lamp, 'use_temperature', False):
        irradiance *= np.array(lamp.temperature_color)
    if not getattr(lamp, 'normalize', True) and lamp.angle > 0.0:
        # Then strength is radiance, spread over the projected solid angle of the disc.
        irradiance *= math.pi * math.sin(lamp.angle / 2.0) ** 2
    irradiance *= _node_factor(lamp, shown.name)

    warnings = []
    if lamp.angle > PARALLEL_ANGLE:
        warnings.append(
            f"sun \"{shown.name}\" has an angle of {math.degrees(lamp.angle):.1f} degrees; "
            "its light is rendered as parallel, with sharp shadows"
        )
    return Sun(shown.matrix[:3, 2], irradiance, name=f"sun \"{shown.name}\""), warnings


def _node_factor(lamp, name: str) -> np.ndarray:
    """RGB that the lamp's nodes multiply its colour by."""
    output = active_output(lamp)
    if output is None:
        return np.ones(3)
    try:
        node = linked_node(output.inputs['Surface'])
        if node is None:
            return np.zeros(3)
        if node.bl_idname != 'ShaderNodeEmission':
            raise Unsupported(f"node \"{node.name}\" is not supported; use one Emission node")
        return constant(node.inputs['Strength'], node) * np.array(constant(node.inputs['Color'], node)[:3])
    except Unsupported as problem:
        raise SceneError(f"sun \"{name}\": {problem}") from None


def world_warnings(world) -> List[str]:
    """Says so where the World gives light or fog, which is not rendered."""
    if world is None or _is_black(world):
        return []
    return [f"World \"{world.name}\" is not black; its light is not rendered"]


def _is_black(world) -> bool:
    output = active_output(world)
    if output is None:
        # Without nodes, Blender before 5.0 shows the World's own colour.
        return bpy.app.version >= (5, 0, 0) or max(world.color) == 0.0
    try:
        if linked_node(output.inputs['Volume']) is not None:
            return False
        node = linked_node(output.inputs['Surface'])
        if node is None:
            return True
        if node.bl_idname != 'ShaderNodeBackground':
            return False
        return constant(node.inputs['Strength'], node) * max(constant(node.inputs['Color'], node)[:3]) == 0.0
    except Unsupported:
        return False
