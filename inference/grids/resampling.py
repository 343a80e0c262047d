# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of one grid at the voxels of another."""

from dataclasses import dataclass

import numpy as np

from ..kernels.library import call
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.sparse_grid import SparseGrid
from .dense_grid import DenseGrid
from .described import describe_grid, describe_occupancy
from .occupancy import Occupancy

# Points that are evaluated at a time.
POINTS_PER_BATCH = 1 << 20
#: 2 x 2 x 2 points in a voxel, beside its centre.
INNER = np.stack(np.meshgrid(*[[-0.25, 0.25]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass(frozen=True)
class Placement:
    """Where the voxels of one grid lie in another.

    linear: (3, 3) and offset: (3,), continuous indices of the other grid from voxels. places: (P, 3), points around the
    centre of each voxel whose values are averaged, in those indices.
    """

    linear: np.ndarray
    offset: np.ndarray
    places: np.ndarray

    def beside(self, first: np.ndarray) -> "Placement":
        """The same for voxels that count from another first one, int (3,)."""
        return Placement(self.linear, self.offset + self.linear @ first, self.places)


def resample(
    grid: DenseGrid | SparseGrid,
    power: int,
    occupancy: Occupancy,
    placement: Placement,
    out: np.ndarray,
    cancel: CancelToken = NEVER,
) -> None:
    """Fill out, float32 (x, y, z), with a power of the grid's values that keeps their sign.

    occupancy: of the grid. Raises Cancelled.
    """
    each = max(POINTS_PER_BATCH // max(out[:1].size * len(placement.places), 1), 1)
    for start in range(0, len(out), each):
        cancel.check()
        part, placed = out[start : start + each], placement.beside(np.array([start, 0, 0]))
        call(
            "resample",
            grid=describe_grid(grid),
            occupancy=describe_occupancy(occupancy),
            power=power,
            shape=np.array(part.shape),
            linear=placed.linear,
            offset=placed.offset,
            points=len(placed.places),
            places=np.ascontiguousarray(placed.places, np.float64),
            out=part.ctypes.data,
            strides=np.array(part.strides) // part.itemsize,
        )
