# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps as `Sun`s, of which a soft sun is several, and as point, spot and area lights."""

import math
from typing import Any

import numpy as np

from ...inference.numerics.small_matmul import inverse
from ...inference.scene import AreaLight, PointLight, SceneError, SpotLight, Sun, soft_sun
from ..nodes.evaluation import NodeEvaluator, Nowhere
from ..nodes.light_shader import EMISSION, emitted
from ..nodes.sockets import Unsupported, active_output, has_nodes, source_of
from .ignored_settings import LIGHT, ignored_settings
from .placement import placement_problem
from .visibility import LEFT_OUT, VisibleObject


def read_suns(shown: VisibleObject) -> tuple[list[Sun], list[str]]:
    """The directional lights that represent a visible sun lamp, and warnings.

    The sun shines along the object's -Z, so the direction towards it is +Z. Its irradiance is strength x colour in
    W/m^2, times 2^exposure, the colour of its temperature and the value of its nodes where this version of Blender has
    them. That is the irradiance of a surface facing the sun; the fluence in a volume is larger for a sun with an angle,
    because no cosine applies.

    Raises SceneError, naming the lamp, for nodes that cannot be evaluated and for an undefined direction.
    """
    lamp, name = shown.data, f'sun "{shown.name}"'
    problem = placement_problem(shown.matrix)
    if problem:
        raise SceneError(f"{name}: {problem}")
    if not shown.matrix[:3, 2].any():
        raise SceneError(f"{name}: it has scale 0 and shines in no direction")
    irradiance = _strength(lamp)
    if not getattr(lamp, "normalize", True) and lamp.angle > 0.0:
        # Strength is then radiance, over the projected solid angle of the disc.
        irradiance *= math.pi * math.sin(lamp.angle / 2.0) ** 2
    # A surface's irradiance is uniform radiance times pi sin^2 of half the angle; a volume's fluence, times the solid
    # angle.
    irradiance *= 2.0 / (1.0 + math.cos(lamp.angle / 2.0))
    irradiance *= _node_factor(lamp, name)
    _require_light(irradiance, name)
    return soft_sun(shown.matrix[:3, 2], irradiance, lamp.angle, name), ignored_settings(shown.object, LIGHT, name)


Lamp = PointLight | SpotLight | AreaLight


def read_lamp(shown: VisibleObject) -> tuple[Lamp | None, list[str]]:
    """The light that a visible point, spot or area lamp is, and warnings; None for one that is left out.

    Power x colour in W, times 2^exposure, the colour of the lamp's temperature and the value of its nodes where this
    version of Blender has them. Without Normalize the power is that per unit of the lamp's surface.

    Raises SceneError, naming the lamp, for nodes that cannot be evaluated and for placements without a place.
    """
    lamp, name = shown.data, f'{shown.data.type.lower()} light "{shown.name}"'
    problem = placement_problem(shown.matrix)
    if problem:
        raise SceneError(f"{name}: {problem}")
    power, matrix = _strength(lamp) * _node_factor(lamp, name), np.array(shown.matrix, np.float64)
    _require_light(power, name)
    warnings = ignored_settings(shown.object, LIGHT, name)
    if lamp.type == "AREA":
        if getattr(getattr(lamp, "cycles", None), "is_portal", False):
            return None, [f"{name} is a portal, which gives no light of its own{LEFT_OUT}"]
        # Of squares and disks one size holds.
        size = (lamp.size, lamp.size if lamp.shape in {"SQUARE", "DISK"} else lamp.size_y)
        if not all(size) or not np.cross(matrix[:3, 0], matrix[:3, 1]).any():
            return None, [*warnings, f"{name} has no area{LEFT_OUT}"]
        if _is_sheared(matrix):
            warnings.append(
                f"{name} is sheared, which changes its brightness in Cycles but not here; apply the scale of its parent"
            )
        # Only its direction counts; a lamp may be flat.
        matrix[:3, 2] = _across(matrix)
        found = AreaLight(matrix, lamp.shape.lower(), size, np.ones(3), lamp.spread, name)
        found.power = power * (1.0 if getattr(lamp, "normalize", True) else found.area)
        return found, warnings
    radius = float(lamp.shadow_soft_size)
    if not getattr(lamp, "normalize", True) and radius > 0.0:
        power = power * (4.0 * math.pi * radius**2)
    # Before 4.2 every soft lamp was what soft falloff is.
    soft = bool(getattr(lamp, "use_soft_falloff", True)) and radius > 0.0
    position = matrix[:3, 3]
    if lamp.type == "POINT":
        return PointLight(position, power, radius, name, soft), warnings
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not abs(np.linalg.det(matrix[:3, :3])) > 1e-9 * np.prod(lengths):
        raise SceneError(f"{name}: it has scale 0 and shines in no direction")
    # A lamp's cone is round in the lamp's own frame.
    frame = inverse(matrix[:3, :3]) * lengths[2] * [[1.0], [1.0], [-1.0]]
    even = np.allclose(frame @ frame.T, np.eye(3), atol=1e-3)
    cone = lamp.spot_size, lamp.spot_blend, radius, name, soft
    return SpotLight(position, -matrix[:3, 2], power, *cone, frame=None if even else frame), warnings


def _is_sheared(matrix: np.ndarray) -> bool:
    """Whether a matrix' axes, those of length 0 aside, are not at right angles."""
    axes = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-30)
    return bool(np.abs(np.triu(axes.T @ axes, 1)).max() > 1e-3)


def _across(matrix: np.ndarray) -> np.ndarray:
    """The normal (3,) of an area lamp, on the side of its +Z axis."""
    normal = np.cross(matrix[:3, 0], matrix[:3, 1])
    normal /= np.linalg.norm(normal)
    return -normal if normal @ matrix[:3, 2] < 0.0 else normal


def _strength(lamp: Any) -> np.ndarray:
    """Strength or power times colour, float64 (3,)."""
    strength = lamp.energy * np.array(lamp.color, dtype=np.float64)
    strength *= 2.0 ** getattr(lamp, "exposure", 0.0)
    if getattr(lamp, "use_temperature", False):
        strength *= np.array(lamp.temperature_color)
    return strength


def _require_light(strength: np.ndarray, name: str) -> None:
    """Raises SceneError, naming the lamp, for a strength (3,) that is no light."""
    if not np.isfinite(strength).all():
        raise SceneError(f"{name}: its strength is not finite; check its drivers and nodes")
    if strength.min() < 0.0:
        raise SceneError(f"{name}: its light is negative, which is not rendered; set its strength and color above 0")


def _node_factor(lamp: Any, name: str) -> np.ndarray:
    """RGB factor of the lamp's nodes."""
    if not has_nodes(lamp):
        return np.ones(3)
    output = active_output(lamp)
    if output is None:
        return np.zeros(3)
    try:
        return emitted(NodeEvaluator(_OnLamp()), source_of(output.inputs["Surface"]), (EMISSION,))[0]
    except Unsupported as problem:
        raise SceneError(f"{name}: {problem}") from None


class _OnLamp(Nowhere):
    """Where a lamp's nodes are evaluated: as far away from it as anything."""

    is_lamp = True
