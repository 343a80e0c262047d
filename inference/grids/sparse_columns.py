# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depths towards one sun, stored only where a sparse grid holds density.

Columns along the sun's rays are stored in tiles of 8 x 8, slice by slice, in rows of blocks across the sun's main axis.
Where the blocks of a row leave a tile unchanged, its depths are equal on all slices of the row and on those of
following rows that leave it unchanged, and are stored once.
"""

import numpy as np

from ..kernels.field_structures import BlockSweep
from ..kernels.library import Kernels
from ..plan.sun_columns import MORE, TilePlan
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.sparse_grid import EDGE, SparseGrid
from .optical_depth_sweep import column_placement, cubic, elements, shift_up


class SparseColumns:
    """Optical depths of one SparseGrid, with the interface of DenseColumns.

    tiles: float32 (T, 8, 8), depths; tile 0 is 0. table: int32 (rows of blocks, tiles, tiles): twice the number of the
    tile that stores the row's first slice, plus 1 where each slice has a tile of its own, in their order. kernels:
    compiled ones, or None. Raises Cancelled.
    """

    def __init__(
        self, grid: SparseGrid, direction: np.ndarray, cancel: CancelToken = NEVER, kernels: Kernels | None = None
    ):
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
            if kernels is not None:
                _sweep_blocks(kernels, grid, plan, slab, (b, c), plane, touched, own)
                continue
            blocks = np.moveaxis(grid.values[slabs[slab][b, c]], shear.main + 1, 1)
            for index in shear.towards_sun(EDGE * slab, EDGE * (slab + 1)):
                (tile_b, in_b, f_b), (tile_c, in_c, f_c) = plan.place(index)
                half_slices = shift_up(blocks[:, index % EDGE], f_b, f_c, cubic) * np.float32(shear.half_step)
                firsts = list(zip(EDGE * (b + tile_b) + in_b, EDGE * (c + tile_c) + in_c))
                _add(plane, half_slices, firsts)
                own[:, index % EDGE] = np.maximum(columns[touched], 0.0)
                _add(plane, half_slices, firsts)

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


def _sweep_blocks(
    kernels: Kernels,
    grid: SparseGrid,
    plan: TilePlan,
    slab: int,
    places: tuple[np.ndarray, np.ndarray],
    columns: np.ndarray,
    touched: np.ndarray,
    own: np.ndarray,
) -> None:
    """Add a row of blocks, at places (n,) and (n,), to columns, and fill the tiles that it touches."""
    slices = np.array(plan.shear.towards_sun(EDGE * slab, EDGE * (slab + 1)))
    starts, taps, _ = column_placement(plan.shear, slices, cubic)
    values = np.ascontiguousarray(grid.values, np.float32)
    kernels.prepare(
        "sweep_blocks",
        BlockSweep(
            values=values,
            rows=len(values),
            strides=elements(np.moveaxis(values[0], plan.shear.main, 0)),
            blocks=len(places[0]),
            block_rows=plan.slabs[slab][places].astype(np.int64),
            block_places=np.stack(places, axis=1).astype(np.int64),
            slices=slices % EDGE,
            starts=starts,
            weights=taps,
            half_step=plan.shear.half_step,
            columns=columns,
            size=np.array(columns.shape),
            touched=len(own),
            tiles=np.ascontiguousarray(np.argwhere(touched)),
            depths=own,
        ),
    )


def _add(columns: np.ndarray, values: np.ndarray, firsts: list[tuple[int, int]]) -> None:
    """Add (n, 8 + MORE, 8 + MORE) to columns from the first ones of each on."""
    for value, (b, c) in zip(values, firsts):
        columns[b : b + EDGE + MORE, c : c + EDGE + MORE] += value
