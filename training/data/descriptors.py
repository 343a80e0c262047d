"""Descriptors of many points with an optical density each, for training data.

The same features as inference.descriptors, computed the other way round: instead of one
lookup in a prepared lattice, each point is moved to the centre of its fine cell and
density and optical depth are interpolated there. No lattice is built, so every point
can have its own optical density.
"""

import numba
import numpy as np

from inference.features.descriptors import stencil_points
from inference.features.mip_lattices import BETA, DENSITY_SCALE, FINE, margins
from inference.features.stencil import Stencil
from inference.plan.resolution import LEVEL0_CELLS


def _flatten(grids):
    """Grids one after the other, with the offset and edge of each."""
    edges = np.array([g.shape[0] for g in grids])
    offsets = np.concatenate([[0], np.cumsum(edges**3)[:-1]])
    return np.concatenate([g.ravel() for g in grids]), offsets, edges


@numba.njit(fastmath=True, cache=True)
def _interpolate(flat, offset, edge, x, y, z):
    """Trilinear at continuous cell indices, clamped at the rim."""
    last = edge - 1.0
    x, y, z = min(max(x, 0.0), last), min(max(y, 0.0), last), min(max(z, 0.0), last)
    i, j, k = min(int(x), edge - 2), min(int(y), edge - 2), min(int(z), edge - 2)
    fx, fy, fz = x - i, y - j, z - k
    total = 0.0
    for a in range(2):
        wa = fx if a else 1.0 - fx
        for b in range(2):
            wb = wa * (fy if b else 1.0 - fy)
            base = offset + ((i + a) * edge + j + b) * edge + k
            total += wb * ((1.0 - fz) * flat[base] + fz * flat[base + 1])
    return total


@numba.njit(parallel=True, fastmath=True, cache=True)
def _describe(points, mips, sigma_hat, density, density_at, density_edge, depth, depth_at, depth_edge, margin, fine):
    count, stencil = points.shape[0], points.shape[1]
    features = np.empty((2, count, stencil), np.float32)
    for r in numba.prange(count):
        for q in range(stencil):
            m = mips[q]
            n = LEVEL0_CELLS >> m
            cells = (n + 2 * margin[m]) * fine[m]
            # Centre of the fine cell that holds the point, in cube coordinates.
            x = np.empty(3)
            for axis in range(3):
                cell = np.floor((points[r, q, axis] + 0.5) * (n * fine[m]) + margin[m] * fine[m])
                cell = min(max(cell, 0.0), cells - 1.0)
                x[axis] = (cell + 0.5) / (n * fine[m]) - margin[m] / n
            a = n
            b = margin[m] - 0.5
            mu = _interpolate(density, density_at[m], density_edge[m], x[0] * a + b, x[1] * a + b, x[2] * a + b)
            source = max(m, 1)
            a = LEVEL0_CELLS >> source
            b = margin[source] - 0.5
            tau = _interpolate(
                depth, depth_at[source - 1], depth_edge[source - 1], x[0] * a + b, x[1] * a + b, x[2] * a + b
            )
            features[0, r, q] = np.log1p(sigma_hat[r] * mu / DENSITY_SCALE)
            features[1, r, q] = np.exp(-sigma_hat[r] * BETA**source * tau)
    return features


def describe_points(stencil: Stencil, padded, unit_depths, positions, omega, sun, sigma_hat):
    """Features mu and S: float32 (2, N, 192).

    padded, unit_depths: from inference.features.mip_lattices; positions, omega: (N, 3) in the cube's frame;
    sun: (3,); sigma_hat: (N,) optical density of each point's medium.
    """
    points = stencil_points(stencil, positions, omega, np.asarray(sun, np.float64))
    return _describe(
        points,
        stencil.mips,
        np.asarray(sigma_hat, np.float64),
        *_flatten(padded),
        *_flatten(unit_depths),
        np.array(margins(stencil)),
        np.array(FINE),
    )
