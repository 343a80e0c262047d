# SPDX-License-Identifier: GPL-3.0-or-later
"""Where light paths leave a volume: traced once, they serve every environment.

A path starts at a vertex that a camera ray sees, in a direction drawn from the phase function, and scatters until it
leaves the cube. The radiance that an environment L scatters towards the camera is then, for an albedo of w and without
the vertex's own, the mean over paths of w^n L(d): n scatterings after the vertex, d the direction in which the path
leaves. No path is absorbed and none ends early, so that every albedo can be had later.
"""

from typing import NamedTuple

import numba
import numpy as np

from .density_grid import interpolate
from .henyey_greenstein import scatter
from .path_tracer import Sampling, enter_cube
from .random_numbers import seed_state
from .scene import PinholeCamera, Vertices
from .tracking import GridMedium, Ray, delta_track

#: Scatterings after which a path is given up; `Exits.scatterings` of such a path.
MOST = 65535
#: Steps per cell of `optical_depths`.
STEPS_PER_CELL = 2

_HALF = np.float32(0.5)


class Exits(NamedTuple):
    """Where K paths from each of P vertices leave.

    directions: uint16 (P, K), of `decode_directions`. scatterings: uint16 (P, K), MOST for paths that were given up.
    """

    directions: np.ndarray
    scatterings: np.ndarray


@numba.njit(cache=True, fastmath=True)
def _encode(x, y, z):
    """Octahedral code of a unit vector, 8 bits per coordinate (Cigolle et al. 2014)."""
    total = abs(x) + abs(y) + abs(z)
    u, v = x / total, y / total
    if z < 0.0:
        u, v = (
            (np.float32(1.0) - abs(v)) * (np.float32(1.0) if u >= 0.0 else np.float32(-1.0)),
            (np.float32(1.0) - abs(u)) * (np.float32(1.0) if v >= 0.0 else np.float32(-1.0)),
        )
    column = min(max(int((u * _HALF + _HALF) * np.float32(256.0)), 0), 255)
    row = min(max(int((v * _HALF + _HALF) * np.float32(256.0)), 0), 255)
    return np.uint16(row * 256 + column)


def decode_directions(codes: np.ndarray) -> np.ndarray:
    """Unit vectors float32 (..., 3) of the codes of `Exits`, within a degree of those encoded."""
    row, column = np.divmod(codes.astype(np.int32), 256)
    u, v = ((column + 0.5) / 128.0 - 1.0).astype(np.float32), ((row + 0.5) / 128.0 - 1.0).astype(np.float32)
    z = 1.0 - np.abs(u) - np.abs(v)
    fold = np.maximum(-z, 0.0)
    x, y = u - np.copysign(fold, u), v - np.copysign(fold, v)
    found = np.stack([x, y, z], axis=-1)
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


@numba.njit(cache=True, fastmath=True, parallel=True)
def _exits_kernel(grid, positions, directions, sigma, anisotropy, paths, seed):
    padded, majorant = grid
    count = len(sigma)
    codes = np.empty((count, paths), np.uint16)
    scatterings = np.empty((count, paths), np.uint16)
    for p in numba.prange(count):
        medium = GridMedium(padded, majorant, sigma[p], anisotropy[p])
        state = seed_state(seed, p)
        for k in range(paths):
            dx, dy, dz, state = scatter(directions[p, 0], directions[p, 1], directions[p, 2], medium.g, state)
            ray = Ray(positions[p, 0], positions[p, 1], positions[p, 2], dx, dy, dz)
            n = 0
            while n < MOST:
                collided, ray, state = delta_track(ray, medium, state)
                if not collided:
                    break
                n += 1
                dx, dy, dz, state = scatter(ray.dx, ray.dy, ray.dz, medium.g, state)
                ray = Ray(ray.x, ray.y, ray.z, dx, dy, dz)
            codes[p, k] = _encode(ray.dx, ray.dy, ray.dz)
            scatterings[p, k] = n
    return codes, scatterings


def trace_exits(grid, vertices: Vertices, sampling: Sampling) -> Exits:
    """Paths from each vertex until they leave; grid: of `density_grid.prepare`. Albedos are not used.

    Deterministic: `sampling.seed` and a vertex's number decide its paths.
    """
    cells = np.float32(grid.cells)
    codes, scatterings = _exits_kernel(
        grid,
        (vertices.positions + _HALF) * cells,
        vertices.directions,
        vertices.sigma / cells,
        vertices.anisotropy,
        int(sampling.paths),
        int(sampling.seed),
    )
    return Exits(codes, scatterings)


@numba.njit(cache=True, fastmath=True, parallel=True)
def _depths_kernel(padded, positions, directions):
    cells = padded.shape[0] - 2
    out = np.zeros(len(positions), np.float32)
    for p in numba.prange(len(positions)):
        far = np.float32(1e9)
        for axis in range(3):
            d = directions[p, axis]
            if abs(d) > 1e-9:
                face = (np.float32(cells) if d > 0.0 else np.float32(0.0)) - positions[p, axis]
                far = min(far, max(face / d, np.float32(0.0)))
        steps = int(far * STEPS_PER_CELL) + 1
        h = far / np.float32(steps)
        total = np.float32(0.0)
        for k in range(steps):
            t = (np.float32(k) + _HALF) * h
            total += interpolate(
                positions[p, 0] + t * directions[p, 0],
                positions[p, 1] + t * directions[p, 1],
                positions[p, 2] + t * directions[p, 2],
                padded,
            )
        out[p] = total * h / np.float32(cells)
    return out


def optical_depths(grid, positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Optical depth float32 (P,) from positions (P, 3) in the cube out along unit directions (P, 3).

    For extinction 1 per cube edge where the density is 1.
    """
    cells = np.float32(grid.cells)
    at = ((np.asarray(positions, np.float32) + _HALF) * cells).astype(np.float32)
    return _depths_kernel(grid.padded, at, np.ascontiguousarray(directions, np.float32))


@numba.njit(cache=True, fastmath=True, parallel=True)
def _camera_exits_kernel(grid, origin, rays, sigma, anisotropy, paths, seed):
    padded, majorant = grid
    cells = padded.shape[0] - 2
    count = rays.shape[0]
    codes = np.zeros((count, paths), np.uint16)
    scatterings = np.zeros((count, paths), np.uint16)
    places = np.zeros((count, paths, 3), np.float32)
    hit = np.zeros((count, paths), np.bool_)
    medium = GridMedium(padded, majorant, sigma, anisotropy)
    for p in numba.prange(count):
        meets, first = enter_cube(Ray(origin[0], origin[1], origin[2], rays[p, 0], rays[p, 1], rays[p, 2]), cells)
        if not meets:
            continue
        state = seed_state(seed, p)
        for k in range(paths):
            collided, ray, state = delta_track(first, medium, state)
            if not collided:
                continue
            hit[p, k] = True
            n = 0
            while n < MOST:
                dx, dy, dz, state = scatter(ray.dx, ray.dy, ray.dz, medium.g, state)
                ray = Ray(ray.x, ray.y, ray.z, dx, dy, dz)
                collided, ray, state = delta_track(ray, medium, state)
                if not collided:
                    break
                n += 1
            codes[p, k] = _encode(ray.dx, ray.dy, ray.dz)
            scatterings[p, k] = n
            places[p, k, 0], places[p, k, 1], places[p, k, 2] = ray.x, ray.y, ray.z
    return codes, scatterings, places, hit


class CameraExits(NamedTuple):
    """Where K paths from each pixel of a camera leave.

    exits: (pixels, K). places: float32 (pixels, K, 3), on each path's last way, in the cube. hit: bool (pixels, K),
    whether it scattered; the others hold nothing.
    """

    exits: Exits
    places: np.ndarray
    hit: np.ndarray


def trace_camera_exits(grid, camera: PinholeCamera, sigma: float, anisotropy: float, sampling: Sampling) -> CameraExits:
    """Paths from where a camera's rays scatter first. sigma: extinction per cube edge."""
    cells = np.float32(grid.cells)
    codes, scatterings, places, hit = _camera_exits_kernel(
        grid,
        (np.asarray(camera.position, np.float64) + 0.5) * float(cells),
        camera.rays().reshape(-1, 3),
        np.float32(sigma / cells),
        np.float32(anisotropy),
        int(sampling.paths),
        int(sampling.seed),
    )
    return CameraExits(Exits(codes, scatterings), places / cells - _HALF, hit)
