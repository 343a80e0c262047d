# SPDX-License-Identifier: GPL-3.0-or-later
"""Unbiased volumetric path tracing in the working cube: delta tracking with next-event estimation.

Suns have irradiance 1. The phase function is Henyey-Greenstein's and carries 1/(4 pi). Results depend on the arguments
alone, not on the number of threads; another compilation of the same code may round the last bits differently.
"""

from typing import NamedTuple

import numba
import numpy as np

from inference import Medium

from .density_grid import prepare
from .henyey_greenstein import phase_hg, scatter
from .random_numbers import draw, seed_state, two_uniforms
from .scene import MAX_COLLISIONS, PinholeCamera, Sampling, Scene, Vertices, per_point, unit_vectors
from .tracking import GridMedium, Ray, delta_track, ratio_track

__all__ = [
    "MAX_COLLISIONS",
    "PinholeCamera",
    "Sampling",
    "Scene",
    "Vertices",
    "sample_scattering_points",
    "trace_pixels",
    "trace_points",
]

#: Rays tried for one scattering point before it is given up.
MAX_TRIES = 2000

_F0, _F1, _F2, _HALF = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)
#: Throughput below which a path plays Russian roulette, and below which it is 0.
_ROULETTE, _NEGLIGIBLE = np.float32(0.05), np.float32(1e-12)


class _Path(NamedTuple):
    """Of a path: albedos (A,), throughput (A,), the suns' light at a vertex (S,) and the radiance so far (S, A)."""

    albedos: np.ndarray
    throughput: np.ndarray
    light: np.ndarray
    radiance: np.ndarray


@numba.njit(cache=True, fastmath=True)
def _sun_light(ray, medium, suns, light, state):
    """Next-event estimation: fill light[s] with transmittance to sun s times the phase function; returns the state.

    The ray's origin is the vertex, its direction that of the light path before it.
    """
    for s in range(suns.shape[0]):
        towards = Ray(ray.x, ray.y, ray.z, suns[s, 0], suns[s, 1], suns[s, 2])
        transmittance, state = ratio_track(towards, medium, state)
        cosine = ray.dx * suns[s, 0] + ray.dy * suns[s, 1] + ray.dz * suns[s, 2]
        light[s] = transmittance * phase_hg(cosine, medium.g)
    return state


@numba.njit(cache=True, fastmath=True)
def _random_walk(ray, medium, suns, path, max_collisions, state):
    """Follow a path that has just left a vertex; add the sunlight at every later one to its radiance."""
    albedos, throughput, light, radiance = path
    for _ in range(max_collisions):
        collided, ray, state = delta_track(ray, medium, state)
        if not collided:
            break
        largest = _F0
        for a in range(albedos.shape[0]):
            throughput[a] *= albedos[a]
            if throughput[a] < _NEGLIGIBLE:
                throughput[a] = _F0
            largest = max(largest, throughput[a])
        if largest < _ROULETTE:
            state, bits = draw(state)
            u, _ = two_uniforms(bits)
            if u > _HALF or largest == _F0:
                break
            for a in range(albedos.shape[0]):
                throughput[a] *= _F2
        state = _sun_light(ray, medium, suns, light, state)
        for s in range(light.shape[0]):
            if light[s] > _F0:
                for a in range(albedos.shape[0]):
                    radiance[s, a] += throughput[a] * light[s]
        dx, dy, dz, state = scatter(ray.dx, ray.dy, ray.dz, medium.g, state)
        ray = Ray(ray.x, ray.y, ray.z, dx, dy, dz)
    return state


class _CellVertices(NamedTuple):
    """`Vertices` with positions in cells and extinction per cell."""

    positions: np.ndarray
    directions: np.ndarray
    sigma: np.ndarray
    g: np.ndarray
    albedos: np.ndarray


# The paths of one vertex or pixel run in a function of their own: numba 0.61 corrupts arrays that are allocated
# inside a parallel loop and held by a tuple.


@numba.njit(cache=True, fastmath=True)
def _trace_vertex(ray, medium, suns, albedos, sampling, state):
    """Mean radiance (S, A) of paths from a vertex at the ray's origin, seen along its direction."""
    mean = np.zeros((suns.shape[0], albedos.shape[0]), np.float32)
    path = _Path(albedos, np.empty_like(albedos), np.empty(mean.shape[0], np.float32), np.empty_like(mean))
    for _ in range(sampling.paths):
        path.radiance[:] = _F0
        path.throughput[:] = _F1
        dx, dy, dz, state = scatter(ray.dx, ray.dy, ray.dz, medium.g, state)
        start = Ray(ray.x, ray.y, ray.z, dx, dy, dz)
        state = _random_walk(start, medium, suns, path, sampling.max_collisions, state)
        mean += path.radiance
    mean /= np.float32(sampling.paths)
    return mean


@numba.njit(cache=True, fastmath=True, parallel=True)
def _points_kernel(grid, suns, vertices, sampling):
    """Mean radiance float32 (P, S, A) of the paths that start at each vertex."""
    padded, majorant = grid
    positions, directions, sigma, g, albedos = vertices
    out = np.zeros((len(sigma), suns.shape[0], albedos.shape[1]), np.float32)
    for p in numba.prange(len(sigma)):
        if sigma[p] > _F0:
            x, w = positions[p], directions[p]
            ray, medium = Ray(x[0], x[1], x[2], w[0], w[1], w[2]), GridMedium(padded, majorant, sigma[p], g[p])
            out[p] = _trace_vertex(ray, medium, suns, albedos[p], sampling, seed_state(sampling.seed, p))
    return out


@numba.njit(cache=True, fastmath=True)
def enter_cube(ray, cells):
    """A ray from outside, moved to where it enters [0, cells]^3, float32: (whether it meets the cube, ray)."""
    near, far = 0.0, 1e30
    meets = True
    for p, d in ((ray.x, ray.dx), (ray.y, ray.dy), (ray.z, ray.dz)):
        if abs(d) < 1e-12:
            if p < 0.0 or p > cells:
                meets = False
        else:
            a, b = -p / d, (cells - p) / d
            near, far = max(near, min(a, b)), min(far, max(a, b))
    top = np.float32(cells)
    x = min(max(np.float32(ray.x + near * ray.dx), _F0), top)
    y = min(max(np.float32(ray.y + near * ray.dy), _F0), top)
    z = min(max(np.float32(ray.z + near * ray.dz), _F0), top)
    return meets and near < far, Ray(x, y, z, ray.dx, ray.dy, ray.dz)


@numba.njit(cache=True, fastmath=True, parallel=True)
def _scattering_kernel(grid, sigma, directions, tries, seed):
    """First collisions float32 (P, 3) of random rays, in cells, and whether one of `tries` collided, bool (P,)."""
    padded, majorant = grid
    cells = padded.shape[0] - 2
    count = sigma.shape[0]
    places = np.zeros((count, 3), np.float32)
    valid = np.zeros(count, np.bool_)
    for p in numba.prange(count):
        state = seed_state(seed, p)
        dx, dy, dz = directions[p, 0], directions[p, 1], directions[p, 2]
        medium = GridMedium(padded, majorant, sigma[p], _F0)
        # Orthonormal basis around the direction (Duff et al. 2017).
        sign = _F1 if dz >= _F0 else -_F1
        q = -_F1 / (sign + dz)
        r = dx * dy * q
        radius = np.float32(0.8661) * np.float32(cells)
        for _ in range(tries):
            if sigma[p] <= _F0:
                break
            # Uniform over a square that holds the cube's projection.
            state, bits = draw(state)
            a, b = two_uniforms(bits)
            a, b = (_F2 * a - _F1) * radius, (_F2 * b - _F1) * radius
            centre = _HALF * np.float32(cells)
            x = centre + a * (_F1 + sign * dx * dx * q) + b * r - _F2 * radius * dx
            y = centre + a * sign * r + b * (sign + dy * dy * q) - _F2 * radius * dy
            z = centre - a * sign * dx - b * dy - _F2 * radius * dz
            meets, ray = enter_cube(Ray(x, y, z, dx, dy, dz), cells)
            if meets:
                collided, ray, state = delta_track(ray, medium, state)
                if collided:
                    places[p, 0], places[p, 1], places[p, 2] = ray.x, ray.y, ray.z
                    valid[p] = True
                    break
    return places, valid


class _View(NamedTuple):
    """Camera position float64 (3,) in cells; ray directions float32 (pixels, 3)."""

    origin: np.ndarray
    rays: np.ndarray


class _Coefficients(NamedTuple):
    """Extinction per cell, mean cosine, albedo float32 (3,)."""

    sigma: float
    g: float
    albedo: np.ndarray


@numba.njit(cache=True, fastmath=True)
def _trace_pixel(first, medium, suns, albedo, sampling, state):
    """Mean RGB and alpha, float32 (4,), of paths along a camera ray from where it enters the cube."""
    mean = np.zeros(4, np.float32)
    path = _Path(albedo, np.empty(3, np.float32), np.empty(1, np.float32), np.empty((1, 3), np.float32))
    for _ in range(sampling.paths):
        collided, ray, state = delta_track(first, medium, state)
        if collided:
            # Single scattering at the first vertex, then the walk.
            state = _sun_light(ray, medium, suns, path.light, state)
            path.throughput[:] = albedo
            path.radiance[0] = albedo * path.light[0]
            dx, dy, dz, state = scatter(ray.dx, ray.dy, ray.dz, medium.g, state)
            start = Ray(ray.x, ray.y, ray.z, dx, dy, dz)
            state = _random_walk(start, medium, suns, path, sampling.max_collisions, state)
            mean[:3] += path.radiance[0]
            mean[3] += _F1
    mean /= np.float32(sampling.paths)
    return mean


@numba.njit(cache=True, fastmath=True, parallel=True)
def _pixels_kernel(grid, coefficients, suns, view, sampling):
    """RGBA float32 (pixels, 4) along the rays of a view."""
    padded, majorant = grid
    cells = padded.shape[0] - 2
    sigma, g, albedo = coefficients
    origin, rays = view
    image = np.zeros((rays.shape[0], 4), np.float32)
    for p in numba.prange(rays.shape[0]):
        meets, ray = enter_cube(Ray(origin[0], origin[1], origin[2], rays[p, 0], rays[p, 1], rays[p, 2]), cells)
        if meets and sigma > _F0:
            medium, state = GridMedium(padded, majorant, sigma, g), seed_state(sampling.seed, p)
            image[p] = _trace_pixel(ray, medium, suns, albedo, sampling, state)
    return image


def trace_points(scene: Scene, vertices: Vertices, sampling: Sampling) -> np.ndarray:
    """Multiple-scattered radiance at path vertices: float32 (P, S, A), per vertex, sun and albedo.

    The mean, over `sampling.paths` paths, of the light that is scattered at least once before it reaches the vertex and
    then towards the camera; without the vertex's own albedo. 1/sr, since the suns have irradiance 1.
    """
    cells = np.float32(scene.grid.cells)
    return _points_kernel(
        scene.grid,
        scene.suns,
        _CellVertices(
            (vertices.positions + np.float32(0.5)) * cells,
            vertices.directions,
            vertices.sigma / cells,
            vertices.anisotropy,
            vertices.albedos,
        ),
        Sampling(*map(int, sampling)),
    )


def sample_scattering_points(density, sigma, directions, seed: int, tries: int = MAX_TRIES):
    """Where camera rays of given directions scatter first.

    Each ray crosses the cube at a random place, uniform over the plane perpendicular to its direction; a ray that
    does not scatter is replaced, `tries` times at most. density: as in `Scene`; sigma: extinction per cube edge, (P,)
    or scalar;
    directions: (P, 3).

    Returns positions float32 (P, 3), cube units, and valid bool (P,): False where no ray scattered. Raises ValueError
    on shapes that do not fit.
    """
    grid = prepare(density)
    directions = unit_vectors(directions, "directions")
    cells = np.float32(grid.cells)
    sigma = per_point(sigma, (len(directions),), "sigma") / cells
    places, valid = _scattering_kernel(grid, sigma, directions, int(tries), int(seed))
    return np.clip(places / cells - np.float32(0.5), -0.5, 0.5), valid


def trace_pixels(scene: Scene, camera: PinholeCamera, medium: Medium, sampling: Sampling) -> np.ndarray:
    """A reference image with every order of scattering and no background: float32 (H, W, 4).

    medium: grey extinction per cube edge and Henyey-Greenstein's phase function. RGB is the radiance, 1/sr, of
    `sampling.paths` paths per pixel; alpha is the share of them that scatter. Raises ValueError for several suns, for
    extinction that differs by channel and for another phase function.
    """
    if len(scene.suns) != 1:
        raise ValueError(f"trace_pixels takes one sun, not {len(scene.suns)}")
    if np.ptp(medium.sigma_t) != 0.0 or medium.phase is not None:
        raise ValueError("trace_pixels takes one extinction for all channels and Henyey-Greenstein's phase function")
    grid, rays = scene.grid, camera.rays()
    image = _pixels_kernel(
        grid,
        _Coefficients(
            np.float32(medium.sigma_t[0] / grid.cells),
            np.float32(medium.anisotropy),
            np.ascontiguousarray(medium.albedo, dtype=np.float32),
        ),
        scene.suns,
        _View((np.asarray(camera.position, np.float64) + 0.5) * grid.cells, rays.reshape(-1, 3)),
        Sampling(*map(int, sampling)),
    )
    return image.reshape(*rays.shape[:2], 4)
