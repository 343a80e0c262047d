# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance of several lights at once, at vertices of camera paths, where the albedo may vary.

The same random walk, of `path_tracer`, is connected to suns and lamps at every vertex, meets what the medium emits on
its flights, and sees the environments where it leaves. Radiance is per light and per channel of albedo.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from .density_grid import BLOCK, DensityGrid, interpolate
from .henyey_greenstein import phase_hg, scatter
from .lamps import Lamps, collision_light, flight_light, place_lamps
from .random_numbers import draw, seed_state, two_uniforms
from .scene import Sampling, per_point, unit_vectors
from .tracking import Glow, GridMedium, Ray, delta_track, ratio_track

#: Least expected number of collisions, real and null, per cube edge of a flight where the medium emits.
EMISSION_SAMPLES = 4.0
#: Collisions of a path that are connected to every sun and lamp; later ones are connected to one at random.
ALL_LIGHTS = 12
#: Vertices that a thread traces before it looks for a signal.
CHUNK = 8

_F0, _F1, _F2, _HALF = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)
_ROULETTE, _NEGLIGIBLE = np.float32(0.05), np.float32(1e-12)


@dataclass(frozen=True)
class Lights:
    """What lights a volume, each by itself. S suns, L lamps, W environments, E emissions.

    suns: (S, 3), directions towards suns of irradiance 1. lamps: PointLight and SpotLight of `inference`, cube units.
    environments: (W, H, 2H), radiance as `inference.Environment` reads it. emission: (N, N, N, E), on the density's
    cells, emitted radiance per cube edge of path length.
    """

    suns: np.ndarray
    lamps: tuple
    environments: np.ndarray
    emission: np.ndarray

    @property
    def count(self) -> int:
        """Of all lights, in the order above."""
        return len(self.suns) + len(self.lamps) + len(self.environments) + self.emission.shape[-1]


@dataclass(frozen=True)
class AlbedoField:
    """Albedos of C channels: `low` (C,) where `mask` is 0, `high` (C,) where it is 1, linear in between.

    mask: float32 (N, N, N) on the density's cells, or None where low is everywhere. Its product with the density is
    interpolated, as renderers do.
    """

    low: np.ndarray
    high: np.ndarray
    mask: np.ndarray | None = None


@dataclass(frozen=True)
class LitMedium:
    """sigma: extinction per cube edge where the density is 1; anisotropy: mean cosine; albedo: AlbedoField."""

    sigma: float
    anisotropy: float
    albedo: AlbedoField


class _Albedo(NamedTuple):
    """low (C,), slope (C,) = high - low; mask times density, padded; whether it varies."""

    low: np.ndarray
    slope: np.ndarray
    masked: np.ndarray
    varies: bool


class _Illumination(NamedTuple):
    suns: np.ndarray
    lamps: Lamps
    environments: np.ndarray
    emission: np.ndarray


class _Media(NamedTuple):
    """The medium for shadows, and the same with a majorant raised where it emits, for flights."""

    shadow: GridMedium
    flight: GridMedium
    albedo: _Albedo


class _Path(NamedTuple):
    """Throughput and albedo (C,), radiance (K, C) scattered in flight, once-scattered radiance (W + E,), Glow."""

    throughput: np.ndarray
    albedo: np.ndarray
    radiance: np.ndarray
    once: np.ndarray
    glow: Glow


@numba.njit(cache=True, fastmath=True)
def _read_albedo(x, y, z, padded, field, albedo):
    """Fill albedo (C,) with that at a position."""
    mask = _F0
    if field.varies:
        density = interpolate(x, y, z, padded)
        if density > _F0:
            mask = min(max(interpolate(x, y, z, field.masked) / density, _F0), _F1)
    for c in range(albedo.shape[0]):
        albedo[c] = field.low[c] + mask * field.slope[c]


@numba.njit(cache=True, fastmath=True)
def _pixel(ray, rows):
    """Row and column of an environment's image from which light arrives along -ray."""
    elevation = math.asin(min(max(ray.dz, -_F1), _F1)) / np.float32(np.pi)
    turns = math.atan2(ray.dy, ray.dx) / np.float32(2.0 * np.pi)
    row = min(max(int((_HALF - elevation) * np.float32(rows)), 0), rows - 1)
    column = int((turns + _F1) * np.float32(2 * rows)) % (2 * rows)
    return row, column


@numba.njit(cache=True, fastmath=True)
def _flight_lamps(ray, media, lights, path, state):
    """Add the light of lamps whose ball the ray crosses; returns the state."""
    for number in range(lights.lamps.radius.shape[0]):
        light, x, y, z, state = flight_light(ray, media.shadow, lights.lamps, number, state)
        if light > _F0:
            _read_albedo(x, y, z, media.shadow.padded, media.albedo, path.albedo)
            for c in range(path.albedo.shape[0]):
                path.radiance[lights.suns.shape[0] + number, c] += path.throughput[c] * path.albedo[c] * light
    return state


@numba.njit(cache=True, fastmath=True)
def _connect(ray, media, lights, path, order, state):
    """Add the light of suns and lamps at a collision, number `order` of its path; returns the state."""
    suns, medium = lights.suns.shape[0], media.shadow
    count = suns + lights.lamps.radius.shape[0]
    first, last, weight = 0, count, _F1
    if order >= ALL_LIGHTS and count > 0:
        state, bits = draw(state)
        u, _ = two_uniforms(bits)
        first, weight = min(int(u * np.float32(count)), count - 1), np.float32(count)
        last = first + 1
    for number in range(first, last):
        if number < suns:
            x, y, z = lights.suns[number, 0], lights.suns[number, 1], lights.suns[number, 2]
            light, state = ratio_track(Ray(ray.x, ray.y, ray.z, x, y, z), medium, state)
            light *= phase_hg(ray.dx * x + ray.dy * y + ray.dz * z, medium.g)
        else:
            light, state = collision_light(ray, medium, lights.lamps, number - suns, state)
        if light > _F0:
            for c in range(path.throughput.shape[0]):
                path.radiance[number, c] += weight * path.throughput[c] * light
    return state


@numba.njit(cache=True, fastmath=True)
def _walk(ray, media, lights, path, most, state):
    """Follow a path that has just left its vertex and add the light that it meets; returns the state."""
    throughput, albedo, radiance, once, glow = path
    emitted = radiance.shape[0] - glow.gathered.shape[0]
    distant = emitted - lights.environments.shape[0]
    for order in range(most):
        state = _flight_lamps(ray, media, lights, path, state)
        glow.gathered[:] = _F0
        collided, ray, state = delta_track(ray, media.flight, state, glow)
        for e in range(glow.gathered.shape[0]):
            if order == 0:
                once[emitted - distant + e] += glow.gathered[e]
            else:
                for c in range(throughput.shape[0]):
                    radiance[emitted + e, c] += throughput[c] * glow.gathered[e]
        if not collided:
            row, column = _pixel(ray, lights.environments.shape[1])
            for w in range(lights.environments.shape[0]):
                light = lights.environments[w, row, column]
                if order == 0:
                    once[w] += light
                else:
                    for c in range(throughput.shape[0]):
                        radiance[distant + w, c] += throughput[c] * light
            break
        _read_albedo(ray.x, ray.y, ray.z, media.shadow.padded, media.albedo, albedo)
        largest = _F0
        for c in range(throughput.shape[0]):
            throughput[c] *= albedo[c]
            if throughput[c] < _NEGLIGIBLE:
                throughput[c] = _F0
            largest = max(largest, throughput[c])
        if largest < _ROULETTE:
            state, bits = draw(state)
            u, _ = two_uniforms(bits)
            if u > _HALF or largest == _F0:
                break
            for c in range(throughput.shape[0]):
                throughput[c] *= _F2
        state = _connect(ray, media, lights, path, order, state)
        dx, dy, dz, state = scatter(ray.dx, ray.dy, ray.dz, media.shadow.g, state)
        ray = Ray(ray.x, ray.y, ray.z, dx, dy, dz)
    return state


@numba.njit(cache=True, fastmath=True)
def _trace_vertex(ray, media, lights, sampling, state):
    """Mean radiance (K, C), and what is scattered once (W + E,), of paths from a vertex at the ray's origin."""
    channels, emissions = media.albedo.low.shape[0], lights.emission.shape[3]
    environments = lights.environments.shape[0]
    count = lights.suns.shape[0] + lights.lamps.radius.shape[0] + environments + emissions
    path = _Path(
        np.empty(channels, np.float32),
        np.empty(channels, np.float32),
        np.empty((count, channels), np.float32),
        np.empty(environments + emissions, np.float32),
        Glow(lights.emission, np.zeros(emissions, np.float32)),
    )
    mean, once = np.zeros((count, channels)), np.zeros(environments + emissions)
    for _ in range(sampling.paths):
        path.radiance[:] = _F0
        path.once[:] = _F0
        path.throughput[:] = _F1
        dx, dy, dz, state = scatter(ray.dx, ray.dy, ray.dz, media.shadow.g, state)
        start = Ray(ray.x, ray.y, ray.z, dx, dy, dz)
        state = _walk(start, media, lights, path, sampling.max_collisions, state)
        mean += path.radiance
        once += path.once
    return mean / sampling.paths, once / sampling.paths


@numba.njit(cache=True, fastmath=True, nogil=True)
def _kernel(media, lights, rays, sampling, found):
    """Fill found, radiance (P, K, C) and once (P, W + E), of vertices that lie between two numbers."""
    (positions, directions), (first, last), (radiance, once) = rays[:2], rays[2], found
    for p in range(first, last):
        x, w = positions[p], directions[p]
        ray = Ray(x[0], x[1], x[2], w[0], w[1], w[2])
        mean, early = _trace_vertex(ray, media, lights, sampling, seed_state(sampling.seed, p))
        radiance[p], once[p] = mean, early


def _emitting_blocks(emission: np.ndarray, blocks: int) -> np.ndarray:
    """Whether interpolation reads emission above 0, bool (B, B, B). emission: padded (N + 2, N + 2, N + 2, E)."""
    emits = (emission > 0.0).any(axis=3)
    for axis in range(3):
        emits = np.moveaxis(emits, axis, 0)
        slabs = [emits[b * BLOCK : b * BLOCK + BLOCK + 2].any(axis=0) for b in range(blocks)]
        emits = np.moveaxis(np.stack(slabs), 0, axis)
    return emits


class Paths(NamedTuple):
    """Vertices from which paths start, and what they meet; numba kernels take it as it is. Of `PathScene.paths`.

    media, lights: in the frame of the grid's cells. positions: float32 (P, 3), in cells; directions: float32 (P, 3).
    """

    media: _Media
    lights: _Illumination
    positions: np.ndarray
    directions: np.ndarray

    @property
    def count(self) -> int:
        """Of all lights, as `Lights.count`."""
        return len(self.lights.suns) + len(self.lights.lamps.radius) + self.unscattered

    @property
    def unscattered(self) -> int:
        """Of environments and emissions."""
        return len(self.lights.environments) + self.lights.emission.shape[3]


@dataclass(frozen=True)
class PathScene:
    """A density and what lights it, prepared once for several media; of `PathScene.of`.

    emission: float32 (N + 2, N + 2, N + 2, E), per cell; emits: bool (B, B, B), of `_emitting_blocks`.
    """

    grid: DensityGrid
    lights: Lights
    suns: np.ndarray
    environments: np.ndarray
    emission: np.ndarray
    emits: np.ndarray

    @classmethod
    def of(cls, grid: DensityGrid, lights: Lights) -> "PathScene":
        """Raises ValueError where the emission does not fit the grid."""
        cells, emission = grid.cells, np.asarray(lights.emission, np.float32)
        if emission.shape[:3] != (cells,) * 3:
            raise ValueError(f"emission must have the density's shape, not {emission.shape[:3]}")
        emission = np.ascontiguousarray(np.pad(emission, ((1, 1), (1, 1), (1, 1), (0, 0))) / np.float32(cells))
        suns = unit_vectors(lights.suns, "suns") if len(lights.suns) else np.zeros((0, 3), np.float32)
        environments = np.ascontiguousarray(lights.environments, np.float32)
        return cls(grid, lights, suns, environments, emission, _emitting_blocks(emission, len(grid.majorant)))

    def paths(self, medium: LitMedium, vertices) -> Paths:
        """From vertices, a pair of positions (P, 3), cube units, and ray directions (P, 3).

        Raises ValueError on shapes that do not fit.
        """
        grid, albedo, sigma = self.grid, medium.albedo, medium.sigma
        cells = grid.cells
        positions, directions = np.asarray(vertices[0], np.float32), unit_vectors(vertices[1], "directions")
        if positions.shape != directions.shape or (positions.size and np.abs(positions).max() > 0.5):
            raise ValueError("vertices must be positions in the cube and as many directions")
        low = np.atleast_1d(np.asarray(albedo.low, np.float32))
        varies = albedo.mask is not None
        masked = np.zeros((1, 1, 1), np.float32)
        if varies:
            if albedo.mask.shape != (cells,) * 3:
                raise ValueError(f"the albedo's mask must have the density's shape, not {albedo.mask.shape}")
            masked = np.pad(albedo.mask.astype(np.float32), 1) * grid.padded
        raised = np.where(self.emits, np.maximum(grid.majorant, np.float32(EMISSION_SAMPLES / sigma)), grid.majorant)
        coefficients = np.float32(sigma / cells), np.float32(medium.anisotropy)
        media = _Media(
            GridMedium(*grid, *coefficients),
            GridMedium(grid.padded, np.ascontiguousarray(raised, np.float32), *coefficients),
            _Albedo(low, per_point(albedo.high, low.shape, "high") - low, masked, varies),
        )
        lamps = place_lamps(self.lights.lamps, grid, sigma)
        at = np.ascontiguousarray((positions + _HALF) * np.float32(cells))
        return Paths(media, _Illumination(self.suns, lamps, self.environments, self.emission), at, directions)


def trace_lights(grid: DensityGrid, lights: Lights, medium: LitMedium, vertices, sampling: Sampling, threads: int = 1):
    """Radiance towards the camera at vertices, a pair of positions (P, 3), cube units, and ray directions (P, 3).

    Returns radiance float32 (P, K, C), of each of K = `lights.count` lights and each channel of albedo, scattered at
    least once before it reaches the vertex and then there; and what is scattered at the vertex alone, float32
    (P, W + E), of environments and emission. Both lack the vertex's own albedo. Deterministic: `sampling.seed` and a
    vertex's number decide its paths.

    Raises ValueError on shapes that do not fit.
    """
    return trace_paths(PathScene.of(grid, lights).paths(medium, vertices), sampling, threads)


def trace_paths(paths: Paths, sampling: Sampling, threads: int = 1):
    """As `trace_lights`."""
    count = len(paths.positions)
    radiance = np.empty((count, paths.count, len(paths.media.albedo.low)), np.float32)
    once = np.empty((count, paths.unscattered), np.float32)

    def trace(first: int) -> None:
        rays = paths.positions, paths.directions, (first, min(first + CHUNK, count))
        _kernel(paths.media, paths.lights, rays, Sampling(*map(int, sampling)), (radiance, once))

    # The kernel lets go of Python's lock: threads work, and a signal is seen after a chunk.
    with ThreadPoolExecutor(threads) as pool:
        chunks = [pool.submit(trace, first) for first in range(0, count, CHUNK)]
        try:
            for chunk in chunks:
                chunk.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return radiance, once
