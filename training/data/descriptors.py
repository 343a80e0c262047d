# SPDX-License-Identifier: GPL-3.0-or-later
"""Descriptors of many points with an extinction each, for training data.

The same features as `inference.paper.descriptors`, computed the other way round: instead of one lookup in a prepared
lattice, each point is moved to the centre of its fine cell, where density and optical depth are interpolated. No
lattice is built, so every point can have its own extinction.
"""

from typing import NamedTuple

import numba
import numpy as np

from inference.features.mip_lattices import DENSITY_SCALE, FINE, margins
from inference.features.stencil import LOW_POINTS, POINTS, Stencil, frames
from inference.paper.sun_lattices import BETA
from inference.plan.resolution import LEVEL0_CELLS


def stencil_points(stencil: Stencil, positions: np.ndarray, omega: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """The stencil around each position: float32 (N, 192, 3) in the cube's frame.

    positions: (N, 3). omega: (N, 3) camera-ray directions. sun: (3,) unit vector.
    """
    points = np.empty((len(positions), POINTS, 3), np.float32)
    rotation = frames(omega, sun).astype(np.float32)
    np.matmul(stencil.low, rotation.transpose(0, 2, 1), out=points[:, :LOW_POINTS])
    points[:, LOW_POINTS:] = stencil.high[:, None] * sun.astype(np.float32)
    points += positions[:, None].astype(np.float32)
    return points


class Levels(NamedTuple):
    """What descriptors read, on padded grids of the cube's frame.

    density: mips 0..7, from `padded_levels`; sun_depths: optical depth towards the sun for extinction 1 per cube edge
    through mips 1..7, from `inference.paper.sun_lattices.unit_optical_depths`.
    """

    density: list[np.ndarray]
    sun_depths: list[np.ndarray]


class _FlatGrids(NamedTuple):
    """Cubic grids one after the other: values float32, and offset and edge of each."""

    values: np.ndarray
    offsets: np.ndarray
    edges: np.ndarray


class _FineCells(NamedTuple):
    """Mip of each stencil point; margin in cells, and fine cells per cell, of each mip."""

    mips: np.ndarray
    margins: np.ndarray
    fine: np.ndarray


def _flatten(grids) -> _FlatGrids:
    edges = np.array([g.shape[0] for g in grids])
    offsets = np.concatenate([[0], np.cumsum(edges**3)[:-1]])
    return _FlatGrids(np.concatenate([g.ravel() for g in grids]), offsets, edges)


@numba.njit(fastmath=True, cache=True)
def _interpolate(flat, offset, edge, x, y, z):
    """Trilinear at continuous cell indices of the grid at `offset`, clamped at its border."""
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
def _describe(points, sigma_hat, cells, density, sun_depths):
    """Features float32 (2, N, stencil) at the stencil points (N, stencil, 3) of media of extinction sigma_hat (N,)."""
    count, stencil = points.shape[0], points.shape[1]
    # Unpacked once: reading an array from a tuple counts a reference, which would cost half as much again in the loop.
    mips, margins, fines = cells
    values, offsets, edges = density
    depths, depth_offsets, depth_edges = sun_depths
    features = np.empty((2, count, stencil), np.float32)
    for r in numba.prange(count):
        for q in range(stencil):
            m = mips[q]
            n, margin, fine = LEVEL0_CELLS >> m, margins[m], fines[m]
            across = (n + 2 * margin) * fine
            # Centre of the fine cell that holds the point, in cube coordinates.
            x = np.empty(3)
            for axis in range(3):
                cell = np.floor((points[r, q, axis] + 0.5) * (n * fine) + margin * fine)
                cell = min(max(cell, 0.0), across - 1.0)
                x[axis] = (cell + 0.5) / (n * fine) - margin / n
            a = n
            b = margin - 0.5
            mu = _interpolate(values, offsets[m], edges[m], x[0] * a + b, x[1] * a + b, x[2] * a + b)
            # Mips 0 and 1 share the first transmittance field.
            source = max(m, 1)
            a = LEVEL0_CELLS >> source
            b = margins[source] - 0.5
            offset, edge = depth_offsets[source - 1], depth_edges[source - 1]
            tau = _interpolate(depths, offset, edge, x[0] * a + b, x[1] * a + b, x[2] * a + b)
            features[0, r, q] = np.log1p(sigma_hat[r] * mu / DENSITY_SCALE)
            features[1, r, q] = np.exp(-sigma_hat[r] * BETA**source * tau)
    return features


def describe_points(stencil: Stencil, levels: Levels, positions, omega, sun, sigma_hat) -> np.ndarray:
    """Features mu and S of A.2: float32 (2, N, 192).

    positions: (N, 3) and omega: (N, 3), camera-ray directions, in the cube's frame; sun: (3,) unit vector;
    sigma_hat: (N,) extinction per cube edge of each point's medium.
    """
    return _describe(
        stencil_points(stencil, positions, omega, np.asarray(sun, np.float64)),
        np.asarray(sigma_hat, np.float64),
        _FineCells(stencil.mips, np.array(margins(stencil)), np.array(FINE)),
        _flatten(levels.density),
        _flatten(levels.sun_depths),
    )
