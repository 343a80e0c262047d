# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds of the voxels that are not 0."""

import numpy as np

from ..scene.errors import SceneError
from ..scene.sparse_grid import SparseGrid


def filled_bounds(values: np.ndarray | SparseGrid) -> tuple[np.ndarray, np.ndarray] | None:
    """First and one past the last voxel that is not 0 on each axis: two int (3,), or None if all are 0.

    values: array (nx, ny, nz) or SparseGrid.
    """
    if isinstance(values, SparseGrid):
        return values.bounds()
    low, high = [], []
    for axis in range(3):
        filled = np.flatnonzero(values.any(axis=tuple(a for a in range(3) if a != axis)))
        if filled.size == 0:
            return None
        low.append(filled[0])
        high.append(filled[-1] + 1)
    return np.array(low), np.array(high)


def active_bounds(density: np.ndarray | SparseGrid) -> tuple[np.ndarray, np.ndarray]:
    """As `filled_bounds`; raises SceneError if all voxels are 0."""
    bounds = filled_bounds(density)
    if bounds is None:
        raise SceneError("the density grid is zero everywhere")
    return bounds
