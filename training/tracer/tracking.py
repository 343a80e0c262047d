# SPDX-License-Identifier: GPL-3.0-or-later
"""Delta tracking and ratio tracking through a majorant grid (Woodcock et al. 1965, Novak et al. 2014).

Everything is float32 and runs inside numba. Positions are in cells (`density_grid`), extinction is `sigma` times
density, per cell. A majorant per block of cells keeps null collisions rare; rays step from block to block as in
Amanatides and Woo 1987.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from .density_grid import BLOCK, stochastic_density
from .random_numbers import draw, three_uniforms, two_uniforms

_F0, _F1, _F2, _HALF = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)
_TINY, _HUGE = np.float32(1e-9), np.float32(1e9)
#: Transmittance below which ratio tracking plays Russian roulette.
_ROULETTE = np.float32(0.1)


class Ray(NamedTuple):
    """Origin in cells and unit direction, float32."""

    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float


class GridMedium(NamedTuple):
    """The arrays of a DensityGrid, extinction per cell where density is 1, and mean cosine g, both float32."""

    padded: np.ndarray
    majorant: np.ndarray
    sigma: float
    g: float


class _BlockStep(NamedTuple):
    """A ray's block, distances to the next face and between faces per axis, and the distance to the exit."""

    i: int
    j: int
    k: int
    next_x: float
    next_y: float
    next_z: float
    step_x: float
    step_y: float
    step_z: float
    exit: float


@numba.njit(cache=True, fastmath=True)
def _inverse(d):
    """1 / d, finite for every d."""
    if abs(d) < _TINY:
        return _HUGE if d >= _F0 else -_HUGE
    return _F1 / d


@numba.njit(cache=True, fastmath=True)
def _first_block(ray, cells, blocks):
    """The block that holds a ray's origin, which lies inside the cube, in grids of `cells` and `blocks` per edge."""
    ix, iy, iz = _inverse(ray.dx), _inverse(ray.dy), _inverse(ray.dz)
    edge = np.float32(BLOCK)
    i = min(max(int(ray.x / edge), 0), blocks - 1)
    j = min(max(int(ray.y / edge), 0), blocks - 1)
    k = min(max(int(ray.z / edge), 0), blocks - 1)
    next_x = (np.float32(i + (1 if ray.dx >= _F0 else 0)) * edge - ray.x) * ix
    next_y = (np.float32(j + (1 if ray.dy >= _F0 else 0)) * edge - ray.y) * iy
    next_z = (np.float32(k + (1 if ray.dz >= _F0 else 0)) * edge - ray.z) * iz
    n = np.float32(cells)
    ex = ((n if ray.dx >= _F0 else _F0) - ray.x) * ix
    ey = ((n if ray.dy >= _F0 else _F0) - ray.y) * iy
    ez = ((n if ray.dz >= _F0 else _F0) - ray.z) * iz
    leave = max(min(ex, min(ey, ez)), _F0)
    return _BlockStep(i, j, k, next_x, next_y, next_z, edge * abs(ix), edge * abs(iy), edge * abs(iz), leave)


@numba.njit(cache=True, fastmath=True, inline="always")
def _next_block(block, face, ray, blocks):
    """Step through the face at distance `face`: (whether still inside the grid, the block behind it)."""
    i, j, k, next_x, next_y, next_z, step_x, step_y, step_z, leave = block
    if face == next_x:
        next_x += step_x
        i += 1 if ray.dx >= _F0 else -1
    elif face == next_y:
        next_y += step_y
        j += 1 if ray.dy >= _F0 else -1
    else:
        next_z += step_z
        k += 1 if ray.dz >= _F0 else -1
    inside = i >= 0 and i < blocks and j >= 0 and j < blocks and k >= 0 and k < blocks
    return inside, _BlockStep(i, j, k, next_x, next_y, next_z, step_x, step_y, step_z, leave)


class Glow(NamedTuple):
    """Emission along flights of `delta_track`.

    padded: float32 (N + 2, N + 2, N + 2, E), emitted radiance per cell of path length, padded like the density.
    gathered: float32 (E,), to which a flight adds what it meets.
    """

    padded: np.ndarray
    gathered: np.ndarray


@numba.njit(cache=True, fastmath=True)
def _gather(glow, scale, x, y, z, state):
    """Add `scale` times the emission at a position to what is gathered; returns the state."""
    state, bits = draw(state)
    a, b, c = three_uniforms(bits)
    i, j, k = int(x + _HALF + a), int(y + _HALF + b), int(z + _HALF + c)
    for e in range(glow.gathered.shape[0]):
        glow.gathered[e] += scale * glow.padded[i, j, k, e]
    return state


@numba.njit(cache=True, fastmath=True)
def delta_track(ray, medium, state, glow=None):
    """Delta tracking to the next real collision, from inside the cube: (collided, ray moved there, state).

    glow: a Glow, or None. In expectation it gathers the emission that reaches the ray's origin from all of the ray.
    Where the medium emits, the majorant must be above 0.
    """
    padded, majorant, sigma, _ = medium
    blocks = majorant.shape[0]
    block = _first_block(ray, padded.shape[0] - 2, blocks)
    inverse_sigma = _F1 / sigma
    state, bits = draw(state)
    u, v = two_uniforms(bits)
    need = -math.log(u) * inverse_sigma
    t = _F0
    while True:
        bound = majorant[block.i, block.j, block.k]
        face = min(min(block.next_x, block.next_y), min(block.next_z, block.exit))
        supply = (face - t) * bound
        if need < supply:
            t += need / bound
            x, y, z = ray.x + ray.dx * t, ray.y + ray.dy * t, ray.z + ray.dz * t
            if glow is not None:
                # Real and null collisions together are as frequent as the majorant says.
                state = _gather(glow, inverse_sigma / bound, x, y, z, state)
            density, state = stochastic_density(x, y, z, padded, state)
            if density > v * bound:
                return True, Ray(x, y, z, ray.dx, ray.dy, ray.dz), state
            state, bits = draw(state)
            u, v = two_uniforms(bits)
            need = -math.log(u) * inverse_sigma
        else:
            need -= supply
            t = face
            if face >= block.exit:
                return False, ray, state
            inside, block = _next_block(block, face, ray, blocks)
            if not inside:
                return False, ray, state


@numba.njit(cache=True, fastmath=True)
def ratio_track(ray, medium, state, reach=_HUGE):
    """Unbiased transmittance from inside the cube along a ray, by ratio tracking: (transmittance, state).

    reach: distance in cells at which the ray ends, where it has not left the cube.
    """
    padded, majorant, sigma, _ = medium
    blocks = majorant.shape[0]
    block = _first_block(ray, padded.shape[0] - 2, blocks)
    end = min(block.exit, reach)
    inverse_sigma = _F1 / sigma
    state, bits = draw(state)
    u, v = two_uniforms(bits)
    need = -math.log(u) * inverse_sigma
    t = _F0
    transmittance = _F1
    while True:
        bound = majorant[block.i, block.j, block.k]
        face = min(min(block.next_x, block.next_y), min(block.next_z, end))
        supply = (face - t) * bound
        if need < supply:
            t += need / bound
            density, state = stochastic_density(
                ray.x + ray.dx * t, ray.y + ray.dy * t, ray.z + ray.dz * t, padded, state
            )
            transmittance *= _F1 - density / bound
            if transmittance < _ROULETTE:
                # The draw of the free flight leaves its second number unused.
                if v > _HALF:
                    return _F0, state
                transmittance *= _F2
            state, bits = draw(state)
            u, v = two_uniforms(bits)
            need = -math.log(u) * inverse_sigma
        else:
            need -= supply
            t = face
            if face >= end:
                return transmittance, state
            inside, block = _next_block(block, face, ray, blocks)
            if not inside:
                return transmittance, state
