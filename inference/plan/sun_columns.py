"""Where columns along a sun's rays lie, and how many of them a sparse grid needs."""

import numpy as np

from ..scene.sparse_grid import EDGE

# Columns that a slice's cells reach: before the first cell, and more than there are cells.
BEFORE, MORE = 2, 3


class Shear:
    """Columns along the sun's rays through slices across its main axis.

    shape: (3,) cells; direction: (3,) the sun's, in index units; low, high: the lowest and the highest slice of the main
    axis; on the one farther from the sun columns lie on cells. All others may lie between them, alike wherever the
    cells begin. main, others: axes; slopes: of the columns, cells of
    the other axes a slice; first: the least column of each, over which columns are counted; size: how many; half_step:
    half a slice's way, in the direction's unit of length.
    """

    def __init__(self, shape, direction, low=None, high=None):
        direction = np.asarray(direction, np.float64)
        self.main = int(np.abs(direction).argmax())
        self.others = [axis for axis in range(3) if axis != self.main]
        self.rising, count = direction[self.main] > 0.0, shape[self.main]
        self.farthest = (low or 0) if self.rising else (count - 1 if high is None else high)
        self.half_step = 0.5 / abs(direction[self.main])
        # A column passes cell (b, c) of the k-th slice towards the sun at b = p + slope * k.
        self.slopes = [direction[axis] / abs(direction[self.main]) for axis in self.others]
        # Cells that columns shift by on the way through all slices.
        ends = [sorted(slope * self.number(index) for index in (0, count - 1)) for slope in self.slopes]
        self.first = [int(np.floor(-last)) - BEFORE for _, last in ends]
        self.size = [
            shape[axis] + int(np.ceil(last - first)) + MORE + 3 for axis, (first, last) in zip(self.others, ends)]

    def towards_sun(self, first: int, end: int) -> range:
        """Numbers from first to before end in the order in which the sun's light passes them."""
        return range(end - 1, first - 1, -1) if self.rising else range(first, end)

    def number(self, index: int) -> int:
        """Of a slice: by how many it is nearer to the sun than the farthest."""
        return index - self.farthest if self.rising else self.farthest - index

    def shift(self, index: int):
        """How far columns have moved on a slice: whole cells on both other axes, and fractions."""
        shifts = [slope * self.number(index) for slope in self.slopes]
        whole = [int(np.floor(shift)) for shift in shifts]
        return whole, [np.float32(shift - n) for shift, n in zip(shifts, whole)]


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


def column_bytes(grid, direction: np.ndarray) -> int:
    """Bytes that a SparseColumns keeps."""
    plan = TilePlan(grid, direction)
    return 4 * (EDGE * EDGE * plan.tiles() + len(plan.slabs) * int(np.prod(plan.shape)))
