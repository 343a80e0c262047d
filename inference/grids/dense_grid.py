# SPDX-License-Identifier: GPL-3.0-or-later
"""A grid that stores all its voxels."""

import functools

import numpy as np

from ..numerics.interpolation import pad_with_zeros, sample_padded


def refined(values: np.ndarray, times: int) -> np.ndarray:
    """The same trilinear interpolant on `times` finer voxels, which are optically thinner: float32.

    values: (nx, ny, nz). The n voxels of an axis become (n + 1) * times - 1, between positions -1 and n, where the
    interpolant reaches 0.
    """
    values = np.pad(values, 1).astype(np.float32)
    for axis in range(3):
        position = np.arange(1, (values.shape[axis] - 1) * times) / times
        cell = position.astype(int)
        fraction = (position - cell).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
        values = values.take(cell, axis) * (1 - fraction) + values.take(cell + 1, axis) * fraction
    return values


class DenseGrid:
    """A dense grid with the interface of SparseGrid.

    values: float32 (nx, ny, nz).
    """

    cell = 3
    # Voxel 0 is at index 1 of the padded grid.
    cells_first = np.ones(3, int)

    def __init__(self, values: np.ndarray):
        self.shape = values.shape
        self.padded = pad_with_zeros(values)
        self.peak = float(values.max())

    @property
    def values(self) -> np.ndarray:
        """As given."""
        return self.padded[1:-2, 1:-2, 1:-2]

    def sample(self, index: np.ndarray) -> np.ndarray:
        """Values float32 (N,) at continuous indices float32 (3, N), trilinear, 0 outside."""
        return sample_padded(self.padded, index)

    @functools.cached_property
    def filled_bits(self) -> np.ndarray:
        """uint8, bits of the padded voxels along the last axis, lowest first: 0 where all values are 0 from a voxel to
        the next along all axes."""
        filled = self.padded != 0.0
        for axis in range(3):
            along = np.moveaxis(filled, axis, 0)
            along[:-1] |= along[1:]
        return np.packbits(filled, axis=2, bitorder="little")

    def cells(self) -> np.ndarray:
        """bool, cells of `cell` voxels along an edge, that hold a value other than 0."""
        return _reduced(np.logical_or, self.padded != 0.0, self.cell)

    def cell_peaks(self) -> np.ndarray:
        """float32, the largest value in cells of `cell` voxels along an edge."""
        return _reduced(np.maximum, self.padded, self.cell)


def _reduced(function: np.ufunc, values: np.ndarray, cell: int) -> np.ndarray:
    """A function of the values in cells of cell x cell x cell; `reduceat` takes ten times as long for short runs."""
    for axis in range(3):
        along = np.moveaxis(values, axis, 0)
        reduced = along[::cell].copy()
        for n in range(1, cell):
            others = along[n::cell]
            function(reduced[: len(others)], others, out=reduced[: len(others)])
        values = np.moveaxis(reduced, 0, axis)
    return np.ascontiguousarray(values)
