# SPDX-License-Identifier: GPL-3.0-or-later
"""RPNN's descriptor: mean density on ten lattices around x that extend towards the sun.

A lattice has 5 x 5 x 9 points that span [-1, -1, -1] to [1, 1, 3], z along the direction to the sun. Level k is twice
the size of level k - 1 and reads mip k of the density pyramid, but at most mip 8, which is the whole cube.
Neighbouring points of level k lie one cell of mip k apart, so that their footprints touch. The method leaves the roll
about z open; here it puts omega into the half-plane x > 0, y = 0, so that the result does not depend on the orientation
of the scene.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inference.plan.resolution import LEVEL0_CELLS

LEVELS = 10
SHAPE = (5, 5, 9)
POINTS = 225
# Fine cells per cell of mips 0 to 8: a lookup of the nearest fine cell replaces a trilinear lookup.
FINE = (1, 2, 2, 2, 4, 8, 16, 16, 32)


@dataclass(frozen=True)
class SunLattice:
    """points: float32 (225, 3), the lattice of level 0, in cube edges. Raises ValueError for other shapes."""

    points: np.ndarray

    def __post_init__(self) -> None:
        if self.points.shape != (POINTS, 3):
            raise ValueError(f"a lattice of {self.points.shape} is not RPNN's")
        object.__setattr__(self, "points", np.ascontiguousarray(self.points, np.float32))

    @property
    def digest(self) -> str:
        """SHA-256 of the points' float32 bytes."""
        return hashlib.sha256(self.points.tobytes()).hexdigest()


def make_sun_lattice() -> SunLattice:
    """The lattice whose neighbouring points lie one cell of mip 0 apart."""
    across, along = np.arange(-2, 3), np.arange(-2, 7)
    grid = np.stack(np.meshgrid(across, across, along, indexing="ij"), axis=-1)
    return SunLattice((grid.reshape(-1, 3) / LEVEL0_CELLS).astype(np.float32))


def sun_frames(sun: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) from the lattice's frame to the cube's.

    sun: unit vectors towards the sun, (3,) or (N, 3). omega: (N, 3) unit camera-ray directions. Column 2 is the sun,
    column 0 the perpendicular part of omega; where the two are parallel the roll is arbitrary but fixed.
    """
    omega = np.asarray(omega, np.float64)
    sun = np.broadcast_to(np.asarray(sun, np.float64), omega.shape)

    def across(v: np.ndarray) -> np.ndarray:
        return v - np.sum(v * sun, axis=1, keepdims=True) * sun

    x = across(omega)
    spare = across(np.eye(3)[np.abs(sun).argmin(axis=1)])
    x = np.where(np.linalg.norm(x, axis=1, keepdims=True) < 1e-6, spare, x)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(sun, x), sun], axis=2)


def refine(level: np.ndarray, fine: int) -> np.ndarray:
    """Linear interpolation of a cubic grid (n, n, n), 0 outside, at the centres of fine cells.

    fine: fine cells per cell. One cell of zeros is added around: float32, (n + 2) * fine cells along an edge.
    """
    grid = np.pad(level, 1)
    n = grid.shape[0]
    if fine == 1:
        return grid
    centre = np.clip((np.arange(n * fine) + 0.5) / fine - 0.5, 0.0, n - 1.0)
    below = np.minimum(centre.astype(int), n - 2)
    weights = np.zeros((n * fine, n), np.float32)
    rows = np.arange(n * fine)
    weights[rows, below] = 1.0 - (centre - below)
    weights[rows, below + 1] = centre - below
    grid = (weights @ grid.reshape(n, -1)).reshape(-1, n, n)
    return np.matmul(np.matmul(weights, grid), weights.T)


def refined_levels(pyramid: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Mips 0 to 8 of the density, refined; their outermost layers are 0."""
    return [refine(level, fine) for level, fine in zip(pyramid, FINE)]


def read_lattices(
    lattice: SunLattice,
    levels: Sequence[np.ndarray],
    positions: np.ndarray,
    omega: np.ndarray,
    sun: np.ndarray,
    jitter: np.ndarray | None = None,
) -> np.ndarray:
    """Values of refined levels at the lattices around points: float32 (N, 10, 225).

    levels: from `refined_levels`, or a function of them. positions, omega: (N, 3) in the cube's frame. sun: as for
    `sun_frames`. jitter: (N, 3) in [-1/2, 1/2), offset of the lookups in fine cells of each level.
    """
    count = len(positions)
    corner = np.asarray(positions, np.float32) + np.float32(0.5)
    offset = np.float32(0.0) if jitter is None else np.asarray(jitter, np.float32)
    # Axes first: (3, N, 225), so that each axis is contiguous in memory.
    points = np.matmul(sun_frames(sun, omega).astype(np.float32), lattice.points.T).transpose(1, 0, 2)
    values = np.empty((count, LEVELS, POINTS), np.float32)
    for k in range(LEVELS):
        mip = min(k, len(levels) - 1)
        scale, edge = np.float32((LEVEL0_CELLS >> mip) * FINE[mip]), levels[mip].shape[0]
        first = (corner * scale + np.float32(FINE[mip]) + offset).T
        index = np.zeros((count, POINTS), np.int32)
        for axis in range(3):
            cell = points[axis] * (scale * np.float32(2**k)) + first[axis][:, None]
            # Everything beyond the lattice is 0, as at its border.
            index = index * edge + np.clip(cell, 0.0, edge - 1.0, out=cell).astype(np.int32)
        values[:, k] = levels[mip].reshape(-1).take(index)
    return values
