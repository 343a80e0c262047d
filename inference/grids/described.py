# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids as the structures that compiled kernels read."""

import numpy as np

from ..kernels import structures
from ..scene.sparse_grid import EDGE, SparseGrid
from .dense_grid import DenseGrid
from .occupancy import Occupancy


def describe_grid(grid: DenseGrid | SparseGrid) -> structures.Shared:
    """A grid of trilinear samples."""
    shape = np.array(grid.shape)
    if isinstance(grid, DenseGrid):
        assert np.array_equal(grid.padded.shape, shape + 3)
        padded = np.ascontiguousarray(grid.padded, np.float32)
        return structures.Grid(values=padded, size=np.array(padded.shape), shape=shape)
    # Voxels from -1 to the shape + 1 are read.
    assert np.all(grid.first >= 1) and np.all(grid.first + shape + 1 < EDGE * np.array(grid.table.shape))
    return describe_blocks(grid)


def describe_blocks(grid: SparseGrid) -> structures.Shared:
    """The blocks of a sparse grid."""
    table, values = np.ascontiguousarray(grid.table, np.int32), np.ascontiguousarray(grid.values, np.float32)
    return structures.Grid(
        values=values,
        table=table,
        size=np.array(table.shape),
        shape=np.array(grid.shape),
        first=grid.first,
        rows=len(values),
    )


def describe_occupancy(occupancy: Occupancy) -> structures.Shared:
    """Which cells of a grid may hold a value other than 0."""
    return structures.Occupancy(
        clearance=occupancy.clearance,
        peaks=np.ascontiguousarray(occupancy.peaks, np.float32),
        size=np.array(occupancy.clearance.shape),
        first=np.float64(occupancy.first),
        scale=1.0 / occupancy.cell,
    )
