# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of grids in the cells of others."""

import numpy as np

from inference.grids.dense_grid import DenseGrid
from inference.grids.occupancy import Occupancy
from inference.grids.resampling import Placement
from inference.grids.working_cube import Cube, _cell_weights
from inference.numerics.small_matmul import affine_inverse
from inference.scene.description import Volume
from inference.scene.sparse_grid import SparseGrid


def near_filled(occupancy: Occupancy, index: np.ndarray) -> np.ndarray:
    """bool (N,): False only where all values within REACH of continuous indices float32 (3, N) are 0."""
    return occupancy.filled.reshape(-1).take(_cell(occupancy, index))


def peaks_near(occupancy: Occupancy, index: np.ndarray) -> np.ndarray:
    """Upper bound float32 (N,) of the density within REACH of continuous indices float32 (3, N)."""
    return occupancy.peaks.reshape(-1).take(_cell(occupancy, index))


def _cell(occupancy: Occupancy, index: np.ndarray) -> np.ndarray:
    """Numbers (N,) of cells."""
    base: np.ndarray | int = 0
    for at, first, size in zip(index, occupancy.first, occupancy.filled.shape):
        # Points outside are clamped onto the border.
        cell = (at + np.float32(first)) * np.float32(1.0 / occupancy.cell)
        cell = np.clip(cell, np.float32(0.0), np.float32(size - 1))
        base = base * np.intp(size) + cell.astype(np.int32)
    return np.asarray(base)


def halved(fine: np.ndarray) -> np.ndarray:
    """Means float32 (x, y, z) of 2 x 2 x 2 cells, in the kernel's order of sums."""
    pairs = fine[0::2] + fine[1::2]
    pairs = pairs[:, 0::2] + pairs[:, 1::2]
    return (pairs[:, :, 0::2] + pairs[:, :, 1::2]) * np.float32(0.125)


def mean_cells(density: np.ndarray, volume: Volume, cube: Cube, cells: int) -> np.ndarray:
    """Means of the interpolant of a density (x, y, z) over the cells of a cube along the axes of its voxels."""
    index_from_world = affine_inverse(volume.world_from_index)
    scale = np.diag(index_from_world[:3, :3] @ cube.rotation * cube.edge)
    origin = index_from_world[:3, :3] @ cube.centre + index_from_world[:3, 3]
    weights = [
        _cell_weights(np.linspace(-0.5, 0.5, cells + 1) * s + o, n) for s, o, n in zip(scale, origin, density.shape)
    ]
    return np.einsum("ix,jy,kz,xyz->ijk", *weights, density, optimize=True)


def resampled_values(
    grid: DenseGrid | SparseGrid, power: int, occupancy: Occupancy, placement: Placement, shape: tuple[int, ...]
) -> np.ndarray:
    """What `resample` fills in, float32 of a shape."""
    centres = np.indices(shape).reshape(3, -1).T @ placement.linear.T + placement.offset
    values = np.zeros(len(centres), np.float32)
    for place in placement.points:
        index = (centres + place).T.astype(np.float32)
        near = np.flatnonzero(near_filled(occupancy, index))
        found = grid.sample(index[:, near])
        values[near] += found * np.abs(found) ** (power - 1) / np.float32(len(placement.points))
    return values.reshape(shape)
