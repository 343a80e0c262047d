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


def inner_points(times: int) -> np.ndarray:
    """times x times x times points in a voxel (P, 3), from its centre."""
    along = (np.arange(times) + 0.5) / times - 0.5
    return np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)


#: 2 x 2 x 2 points in a voxel, beside its centre.
INNER = inner_points(2)


@dataclass(frozen=True)
class Placement:
    """Where the voxels of one grid lie in another.

    linear: (3, 3) and offset: (3,), continuous indices of the other grid from voxels. points: (P, 3), offsets
    from the centre of each voxel to the points that are averaged, in those indices.
    """

    linear: np.ndarray
    offset: np.ndarray
    points: np.ndarray

    def beside(self, first: np.ndarray) -> "Placement":
        """The placement of voxels that count from `first`, int (3,)."""
        return Placement(self.linear, self.offset + self.linear @ first, self.points)


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
    planes_per_call = max(POINTS_PER_BATCH // max(out[:1].size * len(placement.points), 1), 1)
    for start in range(0, len(out), planes_per_call):
        cancel.check()
        planes, placed = out[start : start + planes_per_call], placement.beside(np.array([start, 0, 0]))
        call(
            "resample",
            grid=describe_grid(grid),
            occupancy=describe_occupancy(occupancy),
            power=power,
            shape=np.array(planes.shape),
            linear=placed.linear,
            offset=placed.offset,
            points=len(placed.points),
            places=np.ascontiguousarray(placed.points, np.float64),
            out=planes.ctypes.data,
            strides=np.array(planes.strides) // planes.itemsize,
        )
