# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depth from any point of a grid towards one sun.

Each slice stores the columns of the sweep where they pass it, along the sun's own rays; the sweep reads the density by
cubic interpolation. The ray from a point meets a slice between four columns, and one linear interpolation is all that
blurs the edge of a shadow. Where voxels are optically thick even that is too much, and the first slices are integrated
instead.
"""

from dataclasses import dataclass

import numpy as np

from ..kernels import structures
from ..kernels.library import call
from ..plan.sun_columns import BEFORE, MORE
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.sparse_grid import EDGE, SparseGrid
from .dense_grid import DenseGrid
from .described import describe_grid
from .optical_depth_sweep import cubic, sweep
from .sparse_columns import SparseColumns

# Optical thickness of a slice above which slices are integrated; number of slices per unit of it, and at most.
THIN_SLICE = 0.35
SLICES_PER_DEPTH, MAX_SLICES = 4.0, 4
# Optical thickness of a slice above which every point is integrated, split at voxel planes; below, only points whose
# optical depths to sun and camera sum to at most VISIBLE.
STEEP_SLICE, VISIBLE = 4.0, 6.0
# Optical depth beyond which rays are not followed.
MAX_DEPTH = 30.0


class DenseColumns:
    """Optical depths of one padded density on slices across the sun's main axis, in columns along its rays.

    padded: float32, from `pad_with_zeros`. direction: (3,) towards the sun, d(index)/d(world unit). Raises
    Cancelled.

    offsets: float32 (slices, 2), added to a position in the padded grid on a slice gives its column. size: (2,)
    columns. first: added to the number of a slice of the padded grid, where it is stored.
    """

    first = 1

    def __init__(self, padded: np.ndarray, direction: np.ndarray, cancel: CancelToken = NEVER):
        main = int(np.abs(direction).argmax())
        shape = [padded.shape[axis] + MORE for axis in range(3) if axis != main]
        # One more slice at either end, beyond which there is no density.
        self.depths = np.zeros((padded.shape[main] + 2, *shape), np.float32)
        self.offsets = np.ones((len(self.depths), 2), np.float32)
        self.size = shape
        beyond = sweep(padded, direction, 1.0, cubic, self.depths[1:-1], cancel)
        self.offsets[1:-1] = np.float32(BEFORE) - beyond


@dataclass(frozen=True)
class Integration:
    """How the optical depth is computed where voxels are optically thick.

    slices: number that is integrated, 0 for none. everywhere: whether at every point, or only where the sun and the
    camera are visible. steep: whether integrals are split at planes of voxel centres.
    """

    slices: int
    everywhere: bool
    steep: bool


class SunOpticalDepth:
    """Optical depth through one grid towards one sun, for an extinction of 1 per unit density and world unit.

    grid: DenseGrid or SparseGrid. direction: (3,) towards the sun, d(index)/d(world unit). octaves: by which the voxels
    of the grid are larger than those whose indices points are given in; direction is in the larger ones. Raises
    Cancelled.
    """

    def __init__(
        self, grid: DenseGrid | SparseGrid, direction: np.ndarray, cancel: CancelToken = NEVER, octaves: int = 0
    ):
        self.octaves = octaves
        self.grid, self.direction, self.main = grid, direction, int(np.abs(direction).argmax())
        self.peak = grid.peak
        self.others = [axis for axis in range(3) if axis != self.main]
        self.step = 1 if direction[self.main] > 0.0 else -1
        # From one slice to the next: the displacement in indices, and its length in world units.
        self.move = (direction / abs(direction[self.main])).astype(np.float32)
        self.length = np.float32(1.0 / abs(direction[self.main]))
        self.columns: SparseColumns | DenseColumns
        if isinstance(grid, SparseGrid):
            self.columns = SparseColumns(grid, direction, cancel)
        else:
            self.columns = DenseColumns(grid.padded, direction, cancel)

    def integration(self, sigma_t: float) -> Integration:
        """How the optical depth is computed for an extinction per unit density and world unit."""
        thickest = self.peak * sigma_t * float(self.length)
        if thickest < THIN_SLICE:
            return Integration(0, everywhere=False, steep=False)
        slices = int(np.ceil(min(SLICES_PER_DEPTH * thickest, MAX_SLICES)))
        return Integration(slices, everywhere=thickest >= STEEP_SLICE, steep=thickest > STEEP_SLICE)

    def __call__(self, index: np.ndarray, sigma_t: float, may_be_outside: bool = True) -> np.ndarray:
        """Optical depth float32 (N,) at continuous indices float32 (3, N).

        may_be_outside: whether points may lie outside the support. They are moved towards the sun onto it; where the
        ray misses it the depth is 0.
        """
        depth = np.empty(index.shape[1], np.float32)
        call(
            "sun_depths",
            density=describe_grid(self.grid),
            columns=self.described(sigma_t),
            sigma_t=sigma_t,
            outside=may_be_outside,
            points=len(depth),
            index=np.ascontiguousarray(index, np.float32),
            out=depth,
        )
        return depth

    def described(self, sigma_t: float) -> structures.Shared:
        """As compiled kernels read it, for an extinction per unit density and world unit."""
        columns, integration = self.columns, self.integration(sigma_t)
        offsets = np.ascontiguousarray(columns.offsets, np.float32)
        if isinstance(columns, SparseColumns):
            table, depths = np.ascontiguousarray(columns.table, np.int32), columns.tiles
            assert tuple(EDGE * n for n in table.shape) == (len(offsets), *columns.size)
        else:
            table, depths = None, columns.depths
            assert depths.shape == (len(offsets), *columns.size)
        return structures.SunColumns(
            octaves=self.octaves,
            density=describe_grid(self.grid) if self.octaves else structures.Grid(),
            depths=np.ascontiguousarray(depths, np.float32),
            table=table,
            offsets=offsets,
            slices=len(offsets),
            size=np.array(columns.size),
            tiles=0 if table is None else len(depths),
            first=columns.first,
            main=self.main,
            others=np.array(self.others),
            step=self.step,
            integrated=integration.slices,
            everywhere=integration.everywhere,
            steep=integration.steep,
            visible=VISIBLE,
            deepest=MAX_DEPTH,
            move=np.float64(self.move),
            length=float(self.length),
            direction=np.float64(self.direction),
        )
