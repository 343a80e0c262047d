"""Optical depths towards one sun, kept only where a sparse grid holds something.

Columns along the sun's rays are kept in tiles of 8 x 8, slice by slice, in rows of blocks across the sun's main axis.
Where a row's blocks leave a tile alone, its depths are the same on all the row's slices, and on those of the next such
row: they are kept once.
"""

import numpy as np

from .transmittance import BEFORE, MORE, Shear, cubic, shift_up

EDGE = 8


class SparseColumns:
    """Of one SparseGrid; as DenseColumns.

    tiles: float32 (T, 8, 8), depths; tile 0 is 0. table: int32 (rows of blocks, tiles, tiles): twice the number of
    the tile that holds the row's first slice, and 1 more where each slice has a tile of its own, in their order.
    """

    def __init__(self, grid, direction: np.ndarray, check=lambda: None):
        plan = TilePlan(grid, direction)
        shear, slabs = plan.shear, plan.slabs
        self.first = int(grid.first[shear.main]) - 1
        # From places in the padded grid, where voxel 0 lies at 1, over places in the blocks.
        k = np.array([shear.number(index) for index in range(EDGE * len(slabs))])
        starts = [grid.first[axis] - 1 - shear.first[n] - shear.slopes[n] * k for n, axis in enumerate(shear.others)]
        self.offsets = np.stack(starts, axis=1).astype(np.float32)
        self.size = [EDGE * n for n in plan.shape]
        self.tiles = np.zeros((plan.tiles(), EDGE, EDGE), np.float32)
        self.table = np.zeros((len(slabs), *plan.shape), np.int32)
        columns, latest = np.zeros((*plan.shape, EDGE, EDGE), np.float32), np.zeros(plan.shape, np.int32)
        free = 1
        for slab, touched, left in plan.rows():
            check()
            # What the last row changed and this does not stays as it is now.
            ended, count = int(left.sum()), int(touched.sum())
            self.tiles[free:free + ended] = np.maximum(columns[left], 0.0)
            latest[left] = 2 * np.arange(free, free + ended)
            free += ended
            latest[touched] = 2 * (free + EDGE * np.arange(count)) + 1
            own = self.tiles[free:free + EDGE * count].reshape(count, EDGE, EDGE, EDGE)
            free += EDGE * count
            self.table[slab] = latest
            b, c = np.nonzero(slabs[slab])
            blocks = np.moveaxis(grid.values[slabs[slab][b, c]], shear.main + 1, 1)
            for index in shear.towards_sun(EDGE * slab, EDGE * (slab + 1)) if count else ():
                (tile_b, in_b, f_b), (tile_c, in_c, f_c) = plan.place(index)
                spread = np.zeros((len(b), EDGE * reached(in_b), EDGE * reached(in_c)), np.float32)
                half_slice = spread[:, in_b:in_b + EDGE + MORE, in_c:in_c + EDGE + MORE]
                half_slice[:] = shift_up(blocks[:, index % EDGE], f_b, f_c, cubic)
                half_slice *= np.float32(shear.half_step)
                _add(columns, spread, b + tile_b, c + tile_c)
                own[:, index % EDGE] = np.maximum(columns[touched], 0.0)
                _add(columns, spread, b + tile_b, c + tile_c)

    def slices(self, number: np.ndarray) -> np.ndarray:
        """Where slices of the padded grid, int (N,), are kept."""
        return np.clip(number + self.first, 0, len(self.offsets) - 1)

    def corners(self, number, b, c):
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


class TilePlan:
    """Which tiles of columns the blocks of a SparseGrid change, on their way from the sun."""

    def __init__(self, grid, direction: np.ndarray):
        main = int(np.abs(direction).argmax())
        self.slabs = np.moveaxis(grid.table, main, 0)
        # Columns lie as DenseColumns has them: slices -1 and, at the other end, 1 beyond the last.
        ends = grid.first[main] - 1, grid.first[main] + grid.shape[main] + 1
        self.shear = Shear([EDGE * n for n in grid.table.shape], direction, *ends)
        self.shape = [-(-n // EDGE) + 1 for n in self.shear.size]

    def place(self, index: int):
        """On both other axes, for a slice: tile and column in it where block 0 begins, and the fraction beyond."""
        found = []
        for whole, fraction, first in zip(*self.shear.shift(index), self.shear.first):
            found.append((*divmod(-BEFORE - whole - first, EDGE), fraction))
        return found

    def rows(self):
        """Yield from the sun on: the row of blocks, bool (tiles, tiles) of what it changes, and of what it leaves."""
        before = np.zeros(self.shape, bool)
        for slab in self.shear.towards_sun(0, len(self.slabs)):
            b, c = np.nonzero(self.slabs[slab])
            touched = np.zeros(self.shape, bool)
            places = {
                (tile_b + i, tile_c + j)
                for (tile_b, in_b, _), (tile_c, in_c, _) in map(self.place, range(EDGE * slab, EDGE * (slab + 1)))
                for i in range(reached(in_b)) for j in range(reached(in_c))
            }
            for tile_b, tile_c in places:
                touched[b + tile_b, c + tile_c] = True
            yield slab, touched, before & ~touched
            before = touched

    def tiles(self) -> int:
        """How many are kept."""
        return 1 + sum(EDGE * int(touched.sum()) + int(left.sum()) for _, touched, left in self.rows())


def reached(inside: int) -> int:
    """How many tiles in a row a block reaches that begins so many columns inside a tile."""
    return -(-(inside + EDGE + MORE) // EDGE)


def _add(columns, spread, b, c) -> None:
    """Add (n, 8 i, 8 j) to i by j tiles each, the first of them (b, c)."""
    parts = spread.reshape(len(spread), -1, EDGE, spread.shape[2] // EDGE, EDGE)
    for i in range(parts.shape[1]):
        for j in range(parts.shape[3]):
            columns[b + i, c + j] += parts[:, i, :, j]


def column_bytes(grid, direction: np.ndarray) -> int:
    """Bytes that a SparseColumns keeps."""
    plan = TilePlan(grid, direction)
    return 4 * (EDGE * EDGE * plan.tiles() + len(plan.slabs) * int(np.prod(plan.shape)))
