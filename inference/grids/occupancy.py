# SPDX-License-Identifier: GPL-3.0-or-later
"""Which cells of a grid are empty, so that camera rays may skip them, and the largest density in the others."""

import functools

import numpy as np

#: Distance in voxels along any axis, within which nothing is missed, including the reach of interpolation.
REACH = 2
#: Cells along an edge that are enough to tell which pixels a grid is seen in, and at least.
MOST_CELLS, LEAST_CELLS = 96, 8


class Occupancy:
    """Coarse cells of a grid, such that every point near a value other than 0 lies in a filled cell.

    filled: bool (cx, cy, cz), cells that hold a value other than 0. peaks: float32 (cx, cy, cz), largest density in
    each. cell: voxels along an edge of a cell, more than REACH. first: (3,), position of voxel 0 in the cells.
    """

    def __init__(self, filled: np.ndarray, peaks: np.ndarray, cell: int, first: np.ndarray):
        self.cell, self.first, self._filled = cell, first, filled
        self._peaks = peaks
        self._supports: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        # Neighbours of filled cells count as filled, and what they hold as near.
        self.filled, self.peaks = _grown(filled), _grown(peaks)

    @functools.cached_property
    def clearance(self) -> np.ndarray:
        """uint8 (cx, cy, cz): 0 for filled cells, otherwise a distance in cells below which all others are empty.

        The distance is the largest along an axis, never more than the true distance, and at most 21.
        """
        grown, clearance = self.filled, np.where(self.filled, np.uint8(0), np.uint8(1))
        distance = 1
        for by in (1, 1, 1, 1, 1, 1, 2, 4, 8):
            grown, distance = _grown(grown, by), distance + by
            clearance[~grown] = distance
        return clearance

    @functools.cached_property
    def bounds(self) -> np.ndarray:
        """float32 (cx, cy, cz), upper bounds of the interpolated density in the cells themselves."""
        bounds = self._peaks
        for axis in range(3):
            # Interpolation reaches to the first voxel of the next cell.
            bounds = np.moveaxis(bounds, axis, 0)
            bounds = np.moveaxis(np.maximum(bounds, np.concatenate([bounds[1:], np.zeros_like(bounds[:1])])), 0, axis)
        return np.ascontiguousarray(bounds, np.float32)

    def support(self, most: int = MOST_CELLS) -> tuple[np.ndarray, np.ndarray]:
        """Cells outside of which all interpolated values are 0, bool (x, y, z), and the continuous indices
        (x + 1, y + 1, z + 1, 3) of their corners. At most `most` along each axis.
        """
        if most not in self._supports:
            self._supports[most] = self._support(most)
        return self._supports[most]

    def _support(self, most: int) -> tuple[np.ndarray, np.ndarray]:
        # Interpolation reaches a voxel further: cells begin one voxel earlier, and the next cell holds it, too.
        filled = np.pad(self._filled, (0, 1))
        for axis in range(3):
            along = np.moveaxis(filled, axis, 0)
            along[1:] |= along[:-1].copy()
        times = -(-max(filled.shape) // most)
        for axis in range(3):
            filled = np.logical_or.reduceat(filled, np.arange(0, filled.shape[axis], times), axis=axis)
        faces = [(np.arange(n + 1) * times * self.cell - first - 1.0) for n, first in zip(filled.shape, self.first)]
        return filled, np.stack(np.meshgrid(*faces, indexing="ij"), axis=-1)

    @functools.cached_property
    def share(self) -> float:
        """Fraction of the cells that are filled or have a filled neighbour."""
        return float(self.filled.mean())


def _grown(cells: np.ndarray, by: int = 1) -> np.ndarray:
    """Maximum over each cell and its neighbours up to `by` cells away along each axis."""
    for axis in range(3):
        around = np.moveaxis(cells, axis, 0)
        grown = around.copy()
        np.maximum(grown[by:], around[:-by], out=grown[by:])
        np.maximum(grown[:-by], around[by:], out=grown[:-by])
        cells = np.moveaxis(grown, 0, axis)
    return np.ascontiguousarray(cells)
