# SPDX-License-Identifier: GPL-3.0-or-later
"""Columns along a sun's rays through a grid, and how many of them a sparse grid stores."""

from collections.abc import Iterator, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..scene.sparse_grid import EDGE, SparseGrid

# Numbers of slices, or one.
Slices = TypeVar("Slices", int, np.ndarray)
# Columns that a slice reaches before its first cell, and how many more columns than cells it reaches.
BEFORE, MORE = 2, 3


class Shear:
    """Columns along the sun's rays, through slices across its main axis.

    shape: (3,) cells. direction: (3,) towards the sun, in index units. low, high: lowest and highest slice of the main
    axis. On the slice farthest from the sun columns lie on cells; on all others they may lie between cells, at the same
    offset from each. main, others: axes. slopes: cells of the other axes per slice. first: number of the lowest column
    on each. size: number of columns on each. half_step: length of half a slice along the rays, in the direction's unit.
    """

    def __init__(self, shape: Sequence[int], direction: ArrayLike, low: int | None = None, high: int | None = None):
        direction = np.asarray(direction, np.float64)
        self.main = int(np.abs(direction).argmax())
        self.others = [axis for axis in range(3) if axis != self.main]
        self.rising, count = direction[self.main] > 0.0, shape[self.main]
        self.farthest = (low or 0) if self.rising else (count - 1 if high is None else high)
        self.half_step = 0.5 / abs(direction[self.main])
        # A column p passes cell b of the k-th slice towards the sun at b = p + slope * k.
        self.slopes = [direction[axis] / abs(direction[self.main]) for axis in self.others]
        # Shift of columns, in cells, over all slices.
        ends = [sorted(slope * self.number(index) for index in (0, count - 1)) for slope in self.slopes]
        self.first = [int(np.floor(-last)) - BEFORE for _, last in ends]
        self.size = [
            shape[axis] + int(np.ceil(last - first)) + MORE + 3 for axis, (first, last) in zip(self.others, ends)
        ]

    def towards_sun(self, first: int, end: int) -> range:
        """Slices from first to before end, in the order in which the sun's light passes them."""
        return range(end - 1, first - 1, -1) if self.rising else range(first, end)

    def number(self, index: Slices) -> Slices:
        """By how many slices a slice, or each of some (n,), is nearer to the sun than the farthest."""
        return index - self.farthest if self.rising else self.farthest - index

    def shift(self, slices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By how much columns have moved on slices (n,): whole cells int64 (n, 2), and fractions float32 (n, 2)."""
        shifts = self.number(slices)[:, None] * self.slopes
        whole = np.floor(shifts)
        return whole.astype(np.int64), (shifts - whole).astype(np.float32)


class TilePlan:
    """Which tiles of columns the blocks of a SparseGrid change on the way from the sun.

    grid: SparseGrid. direction: (3,) towards the sun, in index units. slabs: the grid's table, main axis first.
    shape: tiles on the other axes.
    """

    def __init__(self, grid: SparseGrid, direction: np.ndarray):
        main = int(np.abs(direction).argmax())
        self.slabs = np.moveaxis(grid.table, main, 0)
        # As in DenseColumns, there is one more slice at either end: -1 and one beyond the last.
        ends = grid.first[main] - 1, grid.first[main] + grid.shape[main] + 1
        self.shear = Shear([EDGE * n for n in grid.table.shape], direction, *ends)
        self.shape = [-(-n // EDGE) + 1 for n in self.shear.size]

    def place(self, index: int) -> list[tuple[int, int, np.float32]]:
        """Where block 0 begins on a slice, on both other axes: tile, column in it, and the fraction beyond."""
        (whole,), (fractions,) = self.shear.shift(np.array([index]))
        return [
            (*divmod(int(-BEFORE - cells - first), EDGE), fraction)
            for cells, fraction, first in zip(whole, fractions, self.shear.first)
        ]

    def rows(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield rows of blocks from the sun on: number, and bool (tiles, tiles) that it changes and that it leaves.

        A row leaves the tiles that the previous row changed and it does not.
        """
        before = np.zeros(self.shape, bool)
        for slab in self.shear.towards_sun(0, len(self.slabs)):
            b, c = np.nonzero(self.slabs[slab])
            touched = np.zeros(self.shape, bool)
            places = {
                (tile_b + i, tile_c + j)
                for (tile_b, in_b, _), (tile_c, in_c, _) in map(self.place, range(EDGE * slab, EDGE * (slab + 1)))
                for i in range(reached(in_b))
                for j in range(reached(in_c))
            }
            for tile_b, tile_c in places:
                touched[b + tile_b, c + tile_c] = True
            yield slab, touched, before & ~touched
            before = touched

    def tiles(self) -> int:
        """Number of tiles that are stored."""
        return 1 + sum(EDGE * int(touched.sum()) + int(left.sum()) for _, touched, left in self.rows())


def reached(inside: int) -> int:
    """Number of tiles in a row that a block reaches if it begins `inside` columns into a tile."""
    return -(-(inside + EDGE + MORE) // EDGE)


def column_bytes(grid: SparseGrid, direction: np.ndarray) -> int:
    """Memory of a SparseColumns in bytes."""
    plan = TilePlan(grid, direction)
    return 4 * (EDGE * EDGE * plan.tiles() + len(plan.slabs) * int(np.prod(plan.shape)))
