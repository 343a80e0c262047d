# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps for the path tracer: points, spheres, disks with soft falloff, and the cones of spots.

Directions towards a lamp are uniform over the solid angle under which a point sees it, which bounds the samples of a
lamp that has a radius. Near a small lamp its light still grows as the inverse square of the distance. Within a ball
around each lamp, flights are therefore sampled uniformly in the angle that the lamp sees (equiangular sampling, Kulla
and Fajardo 2012). Collisions are connected to the lamp outside the ball only.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from inference import PointLight, SpotLight
from inference.scene.spot_cone import SpotCone

from .density_grid import interpolate
from .henyey_greenstein import phase_hg, turn
from .random_numbers import draw, two_uniforms
from .tracking import Ray, ratio_track

#: Radius of the ball, in mean free paths at the lamp, and its limit in cube edges.
NEAR, NEAR_LIMIT = 1.0, 0.15
#: Least density that the mean free path is taken for.
_LEAST_DENSITY = 0.02

_F0, _F1, _F2, _F3, _F4 = (np.float32(value) for value in range(5))
_CLOSE = np.float32(1e-4)


class Lamps(NamedTuple):
    """Lamps in the frame of a grid's cells, float32.

    intensity: (L,), W/sr times cells^2. centre: (L, 3). radius, near: (L,), of the lamp and of the ball around it.
    soft: bool (L,), soft falloff. axis: (L, 3), along which a spot's light travels. cosine, width: (L,), cosine at
    which its cone begins and the difference over which it grows to 1; -2 and 1 without a cone.
    """

    intensity: np.ndarray
    centre: np.ndarray
    radius: np.ndarray
    near: np.ndarray
    soft: np.ndarray
    axis: np.ndarray
    cosine: np.ndarray
    width: np.ndarray


def place_lamps(lamps, grid, sigma: float) -> Lamps:
    """PointLight and SpotLight of `inference`, in cube units, for a medium of extinction `sigma` per cube edge.

    Their power is that of the first channel.
    """
    cells = grid.cells
    count = len(lamps)
    intensity, radius, near, width = np.zeros((4, count), np.float32)
    centre, axis = np.zeros((2, count, 3), np.float32)
    soft, cosine = np.zeros(count, np.bool_), np.full(count, -2.0, np.float32)
    width[:] = 1.0
    for number, lamp in enumerate(lamps):
        intensity[number] = lamp.power[0] / (4.0 * np.pi) * cells**2
        centre[number] = (lamp.position + 0.5) * cells
        radius[number], soft[number] = lamp.radius * cells, lamp.soft_falloff
        density = _LEAST_DENSITY
        if np.all(np.abs(lamp.position) < 0.5):
            density = max(density, float(interpolate(*centre[number], grid.padded)))
        near[number] = cells * min(NEAR / max(sigma * density, 1e-6), NEAR_LIMIT)
        if isinstance(lamp, SpotLight):
            cone = SpotCone(lamp.direction, float(np.cos(0.5 * lamp.angle)), lamp.blend)
            axis[number], cosine[number], width[number] = cone.axis, cone.cosine, cone.width
        elif not isinstance(lamp, PointLight):
            raise ValueError(f"lamps are points and spots, not {type(lamp).__name__}")
    return Lamps(intensity, centre, radius, near, soft, axis, cosine, width)


@numba.njit(cache=True, fastmath=True)
def _towards(x, y, z, lamps, number, state):
    """A direction from which a lamp's light arrives: (ray, distance of the lamp on it, fluence, state).

    Its mean over samples is the lamp's irradiance on surfaces that face it, without the medium.
    """
    cx, cy, cz = lamps.centre[number, 0] - x, lamps.centre[number, 1] - y, lamps.centre[number, 2] - z
    distance = max(math.sqrt(cx * cx + cy * cy + cz * cz), _CLOSE)
    cx, cy, cz = cx / distance, cy / distance, cz / distance
    radius, intensity = lamps.radius[number], lamps.intensity[number]
    reach, fluence, cone = distance, intensity / (distance * distance), True
    if radius > _F0:
        state, bits = draw(state)
        u, _ = two_uniforms(bits)
        if lamps.soft[number]:
            slant = math.sqrt(distance * distance + radius * radius)
            fluence = _F2 * intensity / (slant * (slant + distance))
            cosine = _F1 - u * radius * radius / (slant * (slant + distance))
            reach = distance / max(cosine, _CLOSE)
        elif distance > radius:
            ratio = radius / distance
            least = math.sqrt(max(_F1 - ratio * ratio, _F0))
            fluence *= _F2 / (_F1 + least)
            cosine = _F1 - u * ratio * ratio / (_F1 + least)
            across = radius * radius - distance * distance * (_F1 - cosine * cosine)
            reach = distance * cosine - math.sqrt(max(across, _F0))
        else:
            fluence, cone = _F4 * intensity / (radius * radius), False
            cosine = _F1 - _F2 * u
            across = radius * radius - distance * distance * (_F1 - cosine * cosine)
            reach = distance * cosine + math.sqrt(max(across, _F0))
        cx, cy, cz, state = turn(cx, cy, cz, cosine, state)
    if cone:
        level = -(cx * lamps.axis[number, 0] + cy * lamps.axis[number, 1] + cz * lamps.axis[number, 2])
        inside = min(max((level - lamps.cosine[number]) / lamps.width[number], _F0), _F1)
        fluence *= inside * inside * (_F3 - _F2 * inside)
    return Ray(x, y, z, cx, cy, cz), reach, fluence, state


@numba.njit(cache=True, fastmath=True)
def _received(x, y, z, ray, medium, lamps, number, state):
    """Lamp light that a vertex at (x, y, z) scatters along -ray, without the albedo, 1/sr; and the state."""
    towards, reach, fluence, state = _towards(x, y, z, lamps, number, state)
    if fluence <= _F0:
        return _F0, state
    transmittance, state = ratio_track(towards, medium, state, reach)
    cosine = ray.dx * towards.dx + ray.dy * towards.dy + ray.dz * towards.dz
    return fluence * transmittance * phase_hg(cosine, medium.g), state


@numba.njit(cache=True, fastmath=True)
def collision_light(ray, medium, lamps, number, state):
    """Lamp light that a collision at the ray's origin scatters along -ray, 0 within the ball; and the state."""
    x, y, z = lamps.centre[number, 0] - ray.x, lamps.centre[number, 1] - ray.y, lamps.centre[number, 2] - ray.z
    if x * x + y * y + z * z < lamps.near[number] * lamps.near[number]:
        return _F0, state
    return _received(ray.x, ray.y, ray.z, ray, medium, lamps, number, state)


@numba.njit(cache=True, fastmath=True)
def _exit_distance(ray, cells):
    far = np.float32(1e9)
    for p, d in ((ray.x, ray.dx), (ray.y, ray.dy), (ray.z, ray.dz)):
        if abs(d) > np.float32(1e-9):
            far = min(far, max(((cells if d > _F0 else _F0) - p) / d, _F0))
    return far


@numba.njit(cache=True, fastmath=True)
def flight_light(ray, medium, lamps, number, state):
    """Lamp light that scatters once along the ray, within the ball: (light without albedo, where x, y, z, state)."""
    cx, cy, cz = lamps.centre[number, 0] - ray.x, lamps.centre[number, 1] - ray.y, lamps.centre[number, 2] - ray.z
    along = cx * ray.dx + cy * ray.dy + cz * ray.dz
    square = cx * cx + cy * cy + cz * cz - along * along
    within = lamps.near[number] * lamps.near[number] - square
    half = math.sqrt(max(within, _F0))
    if within <= _F0 or along + half <= _F0:
        return _F0, ray.x, ray.y, ray.z, state
    cells = np.float32(medium.padded.shape[0] - 2)
    first, last = max(along - half, _F0), min(along + half, _exit_distance(ray, cells))
    if last <= first:
        return _F0, ray.x, ray.y, ray.z, state
    # Within its radius, a lamp is as bright everywhere.
    apart = max(math.sqrt(max(square, _F0)), lamps.radius[number], _CLOSE)
    low, high = math.atan((first - along) / apart), math.atan((last - along) / apart)
    state, bits = draw(state)
    u, _ = two_uniforms(bits)
    beyond = apart * math.tan(low + u * (high - low))
    t = min(max(along + beyond, first), last)
    x = min(max(ray.x + t * ray.dx, _F0), cells)
    y = min(max(ray.y + t * ray.dy, _F0), cells)
    z = min(max(ray.z + t * ray.dz, _F0), cells)
    density = interpolate(x, y, z, medium.padded)
    if density <= _F0:
        return _F0, x, y, z, state
    weight = (high - low) * (apart * apart + beyond * beyond) / apart * medium.sigma * density
    passed, state = ratio_track(ray, medium, state, t)
    if passed <= _F0:
        return _F0, x, y, z, state
    light, state = _received(x, y, z, ray, medium, lamps, number, state)
    return weight * passed * light, x, y, z, state
