"""Where a grid holds anything: what camera rays may skip."""

import numpy as np

#: Voxels from a point, along any axis, within which nothing is missed, interpolation included.
REACH = 2


class Occupancy:
    """A point whose surroundings hold something lies in a filled cell.

    filled: bool (cx, cy, cz), cells that hold something; cell: voxels an edge of them, more than REACH; first: (3,),
    where the cells have voxel 0.
    """

    def __init__(self, filled: np.ndarray, cell: int, first):
        self.cell, self.first = cell, first
        # A cell counts as its neighbours do.
        for axis in range(3):
            around = np.moveaxis(filled, axis, 0)
            grown = around.copy()
            grown[1:] |= around[:-1]
            grown[:-1] |= around[1:]
            filled = np.moveaxis(grown, 0, axis)
        self.filled = np.ascontiguousarray(filled)

    def share(self) -> float:
        """Of the cells, those that are filled or beside one that is."""
        return float(self.filled.mean())

    def near(self, index: np.ndarray) -> np.ndarray:
        """bool (N,): False only where nothing lies within REACH of continuous indices float32 (3, N)."""
        base = 0
        for at, first, size in zip(index, self.first, self.filled.shape):
            # Points beyond the cells take the rim's answer.
            cell = np.clip((at + np.float32(first)) * np.float32(1.0 / self.cell), np.float32(0.0), np.float32(size - 1))
            base = base * np.intp(size) + cell.astype(np.int32)
        return self.filled.reshape(-1).take(base)
