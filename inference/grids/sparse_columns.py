# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depths towards one sun, stored only where a sparse grid holds density.

Columns along the sun's rays are stored in tiles of 8 x 8, slice by slice, in rows of blocks across the sun's main axis.
Where the blocks of a row leave a tile unchanged, its depths are equal on all slices of the row and on those of
following rows that leave it unchanged, and are stored once.
"""

import numpy as np

from ..plan.sun_columns import MORE, TilePlan, reached
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.sparse_grid import EDGE, SparseGrid
from .optical_depth_sweep import cubic, shift_up


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
        columns, latest = np.zeros((*plan.shape, EDGE, EDGE), np.float32), np.zeros(plan.shape, np.int32)
        free = 1
        for slab, touched, left in plan.rows():
            cancel.check()
            # Tiles that the last row changed and this row does not keep their present depths.
            ended, count = int(left.sum()), int(touched.sum())
            self.tiles[free : free + ended] = np.maximum(columns[left], 0.0)
            latest[left] = 2 * np.arange(free, free + ended)
            free += ended
            latest[touched] = 2 * (free + EDGE * np.arange(count)) + 1
            own = self.tiles[free : free + EDGE * count].reshape(count, EDGE, EDGE, EDGE)
            free += EDGE * count
            self.table[slab] = latest
            b, c = np.nonzero(slabs[slab])
            blocks = np.moveaxis(grid.values[slabs[slab][b, c]], shear.main + 1, 1)
            for index in shear.towards_sun(EDGE * slab, EDGE * (slab + 1)) if count else ():
                (tile_b, in_b, f_b), (tile_c, in_c, f_c) = plan.place(index)
                resampled = np.zeros((len(b), EDGE * reached(in_b), EDGE * reached(in_c)), np.float32)
                half_slice = resampled[:, in_b : in_b + EDGE + MORE, in_c : in_c + EDGE + MORE]
                half_slice[:] = shift_up(blocks[:, index % EDGE], f_b, f_c, cubic)
                half_slice *= np.float32(shear.half_step)
                _add(columns, resampled, b + tile_b, c + tile_c)
                own[:, index % EDGE] = np.maximum(columns[touched], 0.0)
                _add(columns, resampled, b + tile_b, c + tile_c)

    def slices(self, number: np.ndarray) -> np.ndarray:
        """Where slices of the padded grid, int (N,), are stored."""
        return np.clip(number + self.first, 0, len(self.offsets) - 1)

    def corners(self, number: np.ndarray, b: np.ndarray, c: np.ndarray) -> list[np.ndarray]:
        """Depths (N,) of columns (b, c), (b, c + 1), (b + 1, c) and (b + 1, c + 1) on slices from `slices`."""
        table, tiles = self.table.reshape(-1), self.tiles.reshape(-1)
        _, tiles_b, tiles_c = self.table.shape
        row, inner = (number >> 3) * np.int32(tiles_b), number & 7
        found = []
        for b_end in (b, b + 1):
            line, above = (row + (b_end >> 3)) * np.int32(tiles_c), (b_end & 7) << 3
            for c_end in (c, c + 1):
                tile = table.take(line + (c_end >> 3))
                tile = ((tile >> 1) + (tile & 1) * inner).astype(np.intp)
                tile <<= 6
                tile += above + (c_end & 7)
                found.append(tiles.take(tile))
        return found


def _add(columns: np.ndarray, values: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    """Add (n, 8 i, 8 j) to i by j tiles each, whose first is (b, c)."""
    parts = values.reshape(len(values), -1, EDGE, values.shape[2] // EDGE, EDGE)
    for i in range(parts.shape[1]):
        for j in range(parts.shape[3]):
            columns[b + i, c + j] += parts[:, i, :, j]
