"""Where a grid holds anything: what camera rays may skip."""

import numpy as np

# Voxels an edge of a cell; also how near density must lie for a point to count as filled, interpolation included.
CELL = 3
#: Voxels from a point, along any axis, within which nothing is missed.
REACH = CELL - 1


class Occupancy:
    """Of a padded density: a point whose surroundings hold density lies in a filled cell."""

    def __init__(self, padded: np.ndarray):
        filled = padded > 0.0
        for axis in range(3):
            filled = np.logical_or.reduceat(filled, np.arange(0, filled.shape[axis], CELL), axis=axis)
        # A cell counts as its neighbours do.
        for axis in range(3):
            around = np.moveaxis(filled, axis, 0)
            grown = around.copy()
            grown[1:] |= around[:-1]
            grown[:-1] |= around[1:]
            filled = np.moveaxis(grown, 0, axis)
        self.filled = np.ascontiguousarray(filled)

    def near(self, index: np.ndarray) -> np.ndarray:
        """bool (N,): False only where no density lies within REACH of continuous indices float32 (3, N)."""
        base = 0
        for at, size in zip(index, self.filled.shape):
            # Voxel 0 lies at 1 of the padded grid. Points beyond it take the rim's answer.
            cell = np.clip((at + np.float32(1.0)) * np.float32(1.0 / CELL), np.float32(0.0), np.float32(size - 1))
            base = base * np.intp(size) + cell.astype(np.int32)
        return self.filled.reshape(-1).take(base)
