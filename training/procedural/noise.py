# SPDX-License-Identifier: GPL-3.0-or-later
"""Band-limited noise and its uses: fractal sums, curl-noise advection, grid lookup.

Points are float32 (M, 3). Noise comes from one periodic tile of Gaussian noise with a wavelength around `CELLS` tile
cells, looked up trilinearly: one lookup per octave. The vector tile is the curl of three such fields, free of
divergence, so that advection does not pile density up (Bridson et al. 2007, "Curl-noise for procedural fluid flow").
"""

from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np
import scipy.fft

TILE = 128
CELLS = 8.0
OCTAVE_ROTATION = np.linalg.qr(np.array([[0.3, 0.8, -0.5], [-0.7, 0.5, 0.4], [0.6, 0.1, 0.8]]))[0].astype(np.float32)


class _Octaves(NamedTuple):
    """Octaves of a tile: offsets float32 (octaves, 3), frequency of the first, amplitude ratio of successive ones."""

    offset: np.ndarray
    frequency: float
    gain: float


def _band_limited(rng, count):
    """`count` spectra (count, TILE, TILE, TILE // 2 + 1) and their wave vectors."""
    k = scipy.fft.fftfreq(TILE) * TILE
    wave = np.stack(np.meshgrid(k, k, k[: TILE // 2 + 1], indexing="ij")).astype(np.float32)
    length = np.sqrt((wave**2).sum(axis=0)) + 1e-6
    octaves = np.log2(length * CELLS / TILE)
    band = np.exp(-0.5 * (octaves / 0.35) ** 2) / length**1.5
    white = rng.standard_normal((count, TILE, TILE, TILE)).astype(np.float32)
    return scipy.fft.rfftn(white, axes=(1, 2, 3)) * band, wave


@lru_cache(maxsize=1)
def scalar_tile():
    """float32 (TILE, TILE, TILE), mean 0, standard deviation 1."""
    spectrum, _ = _band_limited(np.random.default_rng(101), 1)
    tile = scipy.fft.irfftn(spectrum[0], s=(TILE,) * 3)
    return np.ascontiguousarray((tile - tile.mean()) / tile.std(), dtype=np.float32)


@lru_cache(maxsize=1)
def curl_tile():
    """float32 (TILE, TILE, TILE, 3), divergence-free, root mean square speed 1."""
    a, wave = _band_limited(np.random.default_rng(202), 3)
    kx, ky, kz = 1j * wave
    curl = (ky * a[2] - kz * a[1], kz * a[0] - kx * a[2], kx * a[1] - ky * a[0])
    field = np.stack([scipy.fft.irfftn(c, s=(TILE,) * 3) for c in curl], axis=-1)
    return np.ascontiguousarray(field / np.sqrt((field**2).sum(-1).mean()), dtype=np.float32)


@numba.njit(cache=True, fastmath=True, inline="always")
def _corner(x):
    """Periodic tile index of the lower neighbour, the upper one, and the fraction."""
    low = np.floor(x)
    i = np.int64(low) & (TILE - 1)
    return i, (i + 1) & (TILE - 1), np.float32(x - low)


@numba.njit(cache=True, fastmath=True)
def _fractal(points, tile, octaves, rotation, billow):
    offset, frequency, gain = octaves
    out = np.empty(points.shape[0], np.float32)
    for m in range(points.shape[0]):
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        total = np.float32(0.0)
        amplitude = np.float32(1.0)
        scale = np.float32(frequency * CELLS)
        for o in range(offset.shape[0]):
            i0, i1, u = _corner(x * scale + offset[o, 0])
            j0, j1, v = _corner(y * scale + offset[o, 1])
            k0, k1, w = _corner(z * scale + offset[o, 2])
            a = tile[i0, j0, k0] + w * (tile[i0, j0, k1] - tile[i0, j0, k0])
            b = tile[i0, j1, k0] + w * (tile[i0, j1, k1] - tile[i0, j1, k0])
            c = tile[i1, j0, k0] + w * (tile[i1, j0, k1] - tile[i1, j0, k0])
            d = tile[i1, j1, k0] + w * (tile[i1, j1, k1] - tile[i1, j1, k0])
            a += v * (b - a)
            c += v * (d - c)
            n = a + u * (c - a)
            if billow:
                # |n| has creases where n changes sign: a billowing surface when subtracted.
                n = (abs(n) - np.float32(0.8)) * np.float32(1.66)
            total += amplitude * n
            amplitude *= gain
            scale *= np.float32(2.03)
            # Rotate every octave so that the lattices do not align.
            x, y, z = (
                rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
                rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
                rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
            )
        out[m] = total
    return out


@numba.njit(cache=True, fastmath=True)
def _advect(points, tile, octaves, distance, steps):
    offset, frequency, gain = octaves
    out = np.empty_like(points)
    for m in range(points.shape[0]):
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        step = distance[m] / np.float32(steps)
        if step != 0.0:
            for _ in range(steps):
                scale = np.float32(frequency * CELLS)
                amplitude = step
                dx = dy = dz = np.float32(0.0)
                for o in range(offset.shape[0]):
                    i0, i1, u = _corner(x * scale + offset[o, 0])
                    j0, j1, v = _corner(y * scale + offset[o, 1])
                    k0, k1, w = _corner(z * scale + offset[o, 2])
                    for i, wi in ((i0, np.float32(1.0) - u), (i1, u)):
                        for j, wj in ((j0, np.float32(1.0) - v), (j1, v)):
                            c = wi * wj * amplitude
                            c0 = c * (np.float32(1.0) - w)
                            c1 = c * w
                            dx += c0 * tile[i, j, k0, 0] + c1 * tile[i, j, k1, 0]
                            dy += c0 * tile[i, j, k0, 1] + c1 * tile[i, j, k1, 1]
                            dz += c0 * tile[i, j, k0, 2] + c1 * tile[i, j, k1, 2]
                    scale *= np.float32(2.03)
                    amplitude *= gain
                x += dx
                y += dy
                z += dz
        out[m, 0], out[m, 1], out[m, 2] = x, y, z
    return out


@numba.njit(cache=True, fastmath=True)
def sample_grid(points, grid, low, size):
    """Trilinear lookup of `grid` (nx, ny, nz) whose cells of edge `size` start at `low` (3,).

    Returns float32 (M,), 0 beyond the grid.
    """
    nx, ny, nz = grid.shape
    out = np.zeros(points.shape[0], np.float32)
    for m in range(points.shape[0]):
        x = (points[m, 0] - low[0]) / size - 0.5
        y = (points[m, 1] - low[1]) / size - 0.5
        z = (points[m, 2] - low[2]) / size - 0.5
        if x < 0 or y < 0 or z < 0 or x >= nx - 1 or y >= ny - 1 or z >= nz - 1:
            continue
        i, j, k = int(x), int(y), int(z)
        u, v, w = np.float32(x - i), np.float32(y - j), np.float32(z - k)
        a = grid[i, j, k] + w * (grid[i, j, k + 1] - grid[i, j, k])
        b = grid[i, j + 1, k] + w * (grid[i, j + 1, k + 1] - grid[i, j + 1, k])
        c = grid[i + 1, j, k] + w * (grid[i + 1, j, k + 1] - grid[i + 1, j, k])
        d = grid[i + 1, j + 1, k] + w * (grid[i + 1, j + 1, k + 1] - grid[i + 1, j + 1, k])
        a += v * (b - a)
        c += v * (d - c)
        out[m] = a + u * (c - a)
    return out


class Fractal:
    """A fractal sum of noise octaves at random offsets in the tile.

    frequency: waves per unit length of the first octave; gain: amplitude ratio of successive octaves; billow: take
    absolute values of octaves, for creased lumps. Calling it with points (M, 3) returns float32 (M,), of mean about 0
    and standard deviation about 1.
    """

    def __init__(self, rng, frequency, octaves=5, gain=0.5, billow=False):
        offset = (rng.random((octaves, 3)) * TILE).astype(np.float32)
        self._octaves, self._billow = _Octaves(offset, np.float32(frequency), np.float32(gain)), billow
        self._norm = np.float32(1.0 / np.sqrt(sum(gain ** (2 * o) for o in range(octaves))))

    def __call__(self, points):
        points = np.ascontiguousarray(points, dtype=np.float32)
        noise = _fractal(points, scalar_tile(), self._octaves, OCTAVE_ROTATION, self._billow)
        noise *= self._norm
        return noise


class Swirl:
    """Advects points along a frozen curl-noise flow.

    Called with points (M, 3) and a distance, scalar or (M,), the root mean square of the first octave's displacement;
    returns the moved points float32 (M, 3).
    """

    def __init__(self, rng, frequency, octaves=2, gain=0.6, steps=8):
        offset = (rng.random((octaves, 3)) * TILE).astype(np.float32)
        self._octaves, self._steps = _Octaves(offset, np.float32(frequency), np.float32(gain)), steps

    def __call__(self, points, distance):
        points = np.ascontiguousarray(points, dtype=np.float32)
        distance = np.broadcast_to(np.asarray(distance, np.float32), (len(points),))
        return _advect(points, curl_tile(), self._octaves, distance, self._steps)
