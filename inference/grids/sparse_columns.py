# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depths towards one sun, stored only where a sparse grid holds density.

Columns along the sun's rays are stored in tiles of 8 x 8, slice by slice, in rows of blocks across the sun's main axis.
Where the blocks of a row leave a tile unchanged, its depths are equal on all slices of the row and on those of
following rows that leave it unchanged, and are stored once.
"""

import numpy as np

from ..kernels.library import call
from ..plan.sun_columns import TilePlan
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.sparse_grid import EDGE, SparseGrid
from .optical_depth_sweep import column_placement, cubic, elements


class SparseColumns:
    """Optical depths of one SparseGrid, with the interface of DenseColumns.

    tiles: float32 (T, 8, 8), depths; tile 0 is 0. table: int32 (rows of blocks, tiles, tiles): twice the number of the
    tile that stores the row's first slice, plus 1 where each slice has a tile of its own, in their order. Raises
    Cancelled.
    """

    def __init__(self, grid: SparseGrid, direction: np.ndarray, cancel: CancelToken = NEVER):
        plan = TilePlan(grid, direction)
        shear, slabs = plan.shear, plan.slabs
        self.first = int(grid.first[shear.main]) - 1
        # Columns from positions in the padded grid, where voxel 0 is at 1, via positions in the blocks.
        k = np.array([shear.number(index) for index in range(EDGE * len(slabs))])
        starts = [grid.first[axis] - 1 - shear.first[n] - shear.slopes[n] * k for n, axis in enumerate(shear.others)]
        self.offsets = np.stack(starts, axis=1).astype(np.float32)
        self.size = [EDGE * n for n in plan.shape]
        self.tiles = np.zeros((plan.tiles(), EDGE, EDGE), np.float32)
        self.table = np.zeros((len(slabs), *plan.shape), np.int32)
        plane, latest = np.zeros(self.size, np.float32), np.zeros(plan.shape, np.int32)
        columns = plane.reshape(plan.shape[0], EDGE, plan.shape[1], EDGE).swapaxes(1, 2)
        free = 1
        for slab, touched, ending in plan.rows():
            cancel.check()
            # Tiles that the last row changed and this row does not keep their present depths.
            ended, count = int(ending.sum()), int(touched.sum())
            self.tiles[free : free + ended] = np.maximum(columns[ending], 0.0)
            latest[ending] = 2 * np.arange(free, free + ended)
            free += ended
            latest[touched] = 2 * (free + EDGE * np.arange(count)) + 1
            own = self.tiles[free : free + EDGE * count].reshape(count, EDGE, EDGE, EDGE)
            free += EDGE * count
            self.table[slab] = latest
            _sweep_blocks(grid, plan, slab, plane, touched, own)


def _sweep_blocks(
    grid: SparseGrid, plan: TilePlan, slab: int, columns: np.ndarray, touched: np.ndarray, own: np.ndarray
) -> None:
    """Add a row of blocks to columns, and fill the tiles that it touches."""
    slices = np.array(plan.shear.towards_sun(EDGE * slab, EDGE * (slab + 1)))
    starts, taps, _ = column_placement(plan.shear, slices, cubic)
    values, blocks = np.ascontiguousarray(grid.values, np.float32), plan.slabs[slab]
    call(
        "sweep_blocks",
        values=values,
        rows=len(values),
        strides=elements(np.moveaxis(values[0], plan.shear.main, 0)),
        blocks=np.count_nonzero(blocks),
        block_rows=blocks[blocks != 0].astype(np.int64),
        block_places=np.ascontiguousarray(np.argwhere(blocks)),
        slices=slices % EDGE,
        starts=starts,
        weights=taps,
        half_step=plan.shear.half_step,
        columns=columns,
        size=np.array(columns.shape),
        touched=len(own),
        tiles=np.ascontiguousarray(np.argwhere(touched)),
        depths=own,
    )
