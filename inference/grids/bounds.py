"""Bounds of the voxels that hold anything."""

import numpy as np

from ..scene.errors import SceneError
from ..scene.sparse_grid import SparseGrid


def filled_bounds(values):
    """First and one past the last voxel that is not 0 on each axis: two int (3,), or None where there is none.

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


def active_bounds(density):
    """As `filled_bounds`; raises SceneError where all is 0."""
    bounds = filled_bounds(density)
    if bounds is None:
        raise SceneError("the density grid is zero everywhere")
    return bounds
