"""A grid of which only blocks that hold anything are kept."""

import functools
from collections.abc import Iterator

import numpy as np

from ..numerics.interpolation import between

# Voxels an edge of a block: those of OpenVDB's leaves.
EDGE = 8
# Blocks that are looked at together.
BLOCKS_PER_BATCH = 1 << 14


class SparseGrid:
    """float32 values of (nx, ny, nz) voxels, trilinear in between, 0 outside and in blocks that are not kept.

    shape: voxels. table: int32 (bx, by, bz), the row of `values` that holds each block of 8 x 8 x 8 voxels; row 0 where
    all is 0, and so in all blocks at the rim. values: float32 (1 + M, 8, 8, 8), 0 in row 0 and outside the shape.
    first: int (3,), where the blocks hold voxel (0, 0, 0).

    Not to be changed: what is asked of all values is found once.
    """

    # Voxels an edge of the cells that rays skip.
    CELL = 4

    def __init__(self, shape, table: np.ndarray, values: np.ndarray, first):
        self.shape, self.table, self.values = tuple(int(n) for n in shape), table, values
        self.first = np.array(first, int)

    @property
    def cells_first(self) -> np.ndarray:
        """int (3,), where the cells hold voxel (0, 0, 0)."""
        return self.first

    @classmethod
    def of_blocks(cls, shape, first, count, numbers, values) -> "SparseGrid":
        """From some blocks of a box of `count` (3,) blocks, the other arguments without a rim.

        numbers: int (M,), places in the flattened box; values: float32 (1 + M, 8, 8, 8), row 0 all 0.
        """
        table = np.zeros(np.array(count) + 2, np.int32)
        table[tuple(part + 1 for part in np.unravel_index(numbers, count))] = np.arange(1, len(numbers) + 1)
        return cls(shape, table, values, np.array(first) + EDGE)

    @classmethod
    def of_dense(cls, dense: np.ndarray) -> "SparseGrid":
        """The blocks of an array (nx, ny, nz) that are not 0 everywhere."""
        count = [-(-n // EDGE) for n in dense.shape]
        blocks = blocks_of(np.pad(dense, [(0, EDGE * b - n) for b, n in zip(count, dense.shape)]))
        numbers = np.flatnonzero(blocks.any(axis=(1, 2, 3)))
        values = np.concatenate([np.zeros((1, EDGE, EDGE, EDGE), np.float32), blocks[numbers].astype(np.float32)])
        return cls.of_blocks(dense.shape, (0, 0, 0), count, numbers, values)

    @property
    def nbytes(self) -> int:
        return self.table.nbytes + self.values.nbytes

    @functools.cached_property
    def peak(self) -> float:
        return float(self.values.max())

    @functools.cached_property
    def lowest(self) -> float:
        return float(self.values.min())

    def max(self) -> float:
        return self.peak

    def min(self) -> float:
        return self.lowest

    def any(self) -> bool:
        return self.peak != 0.0 or self.lowest != 0.0

    def with_values(self, values: np.ndarray) -> "SparseGrid":
        """Other values (1 + M, 8, 8, 8) in the same blocks."""
        return SparseGrid(self.shape, self.table, values, self.first)

    def with_rows(self, rows: np.ndarray) -> "SparseGrid":
        """As `with_values`, without the first, which is 0."""
        return self.with_values(np.concatenate([np.zeros((1, EDGE, EDGE, EDGE), np.float32), rows]))

    def equals(self, other) -> bool:
        return (isinstance(other, SparseGrid) and self.shape == other.shape and np.array_equal(self.first, other.first)
                and np.array_equal(self.table, other.table) and np.array_equal(self.values, other.values))

    def crop(self, low, high) -> "SparseGrid":
        """Voxels from low (3,) to before high (3,), outside which all must be 0."""
        return SparseGrid(np.subtract(high, low), self.table, self.values, self.first + low)

    def bounds(self):
        """As `filled_bounds`."""
        if self._filled is None:
            return None
        return self._filled[0] - self.first, self._filled[1] - self.first

    @functools.cached_property
    def _filled(self):
        """First and one past the last of the blocks' voxels that are not 0, or None."""
        # Of each plane of voxels along each axis, whether any of its blocks' planes holds something.
        filled = [np.zeros((n, EDGE), bool) for n in self.table.shape]
        for places, rows in self._kept():
            held = self.values[rows] != 0.0
            for axis, place in enumerate(places):
                planes = held.any(axis=tuple(a + 1 for a in range(3) if a != axis))
                for inner in range(EDGE):
                    filled[axis][place[planes[:, inner]], inner] = True
        found = [np.flatnonzero(planes) for planes in filled]
        if not len(found[0]):
            return None
        return np.array([planes[0] for planes in found]), np.array([planes[-1] + 1 for planes in found])

    def slabs(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield boxes of values, a row of blocks along the first axis at a time, and of each its first voxel (3,).

        All that is not 0 lies in one of them. The next one overwrites an array.
        """
        last = self.first + self.shape
        room = np.zeros((EDGE, *(EDGE * n for n in self.table.shape[1:])), np.float32)
        blocks = room.reshape(EDGE, self.table.shape[1], EDGE, self.table.shape[2], EDGE)
        for number, slab in enumerate(self.table):
            y, z = np.nonzero(slab)
            if not len(y):
                continue
            blocks[:, y, :, z, :] = self.values[slab[y, z]]
            low = np.maximum(self.first, [EDGE * number, EDGE * y.min(), EDGE * z.min()])
            high = np.minimum(last, [EDGE * (number + 1), EDGE * (y.max() + 1), EDGE * (z.max() + 1)])
            inside = (slice(low[0] - EDGE * number, high[0] - EDGE * number), *map(slice, low[1:], high[1:]))
            if np.all(low < high):
                yield low - self.first, room[inside]
            blocks[:, y, :, z, :] = 0.0

    def dense(self) -> np.ndarray:
        """float32 (nx, ny, nz)."""
        dense = np.zeros(self.shape, np.float32)
        for low, values in self.slabs():
            dense[tuple(map(slice, low, np.add(low, values.shape)))] = values
        return dense

    def sample(self, index: np.ndarray) -> np.ndarray:
        """Values float32 (N,) at continuous indices float32 (3, N), trilinear, 0 outside."""
        below, above, fractions = [], [], []
        # Of both voxels around a place, on each axis: the block's part of its number, and the voxel's within.
        block, voxel = self.table.size, EDGE**3
        for at, size, first, blocks in zip(index, self.shape, self.first, self.table.shape):
            block, voxel = block // blocks, voxel // EDGE
            # Indices outside are clamped onto the voxels there, where all is 0.
            position = np.clip(at, np.float32(-1.0), np.float32(size)) + np.float32(first)
            cell = position.astype(np.int32)
            fractions.append(np.subtract(position, cell, out=position))
            for ends, place in ((below, cell), (above, cell + 1)):
                ends.append(((place >> 3) * np.int32(block), (place & 7) * np.int32(voxel)))
        table, values = self.table.reshape(-1), self.values.reshape(-1)
        fx, fy, fz = fractions

        def at(*ends):
            place = table.take(ends[0][0] + ends[1][0] + ends[2][0]).astype(np.intp)
            place *= EDGE**3
            place += ends[0][1] + ends[1][1] + ends[2][1]
            return values.take(place)

        def edge(x, y):
            return between(at(x, y, below[2]), at(x, y, above[2]), fz)

        y0 = between(edge(below[0], below[1]), edge(below[0], above[1]), fy)
        y1 = between(edge(above[0], below[1]), edge(above[0], above[1]), fy)
        return between(y0, y1, fx)

    def cells(self) -> np.ndarray:
        """bool, which cells hold anything."""
        parts = EDGE // self.CELL
        filled = np.zeros([n * parts for n in self.table.shape], bool)
        blocks = filled.reshape([size for n in self.table.shape for size in (n, parts)])
        for (x, y, z), rows in self._kept():
            cells = (self.values[rows] != 0.0).reshape(-1, *(parts, self.CELL) * 3)
            blocks[x, :, y, :, z, :] = cells.any(axis=(2, 4, 6))
        return filled

    def _kept(self):
        """Yield places, three int (n,), and rows (n,) of some blocks at a time."""
        places = np.nonzero(self.table)
        rows = self.table[places]
        for start in range(0, len(rows), BLOCKS_PER_BATCH):
            span = slice(start, start + BLOCKS_PER_BATCH)
            yield tuple(place[span] for place in places), rows[span]


def blocks_of(dense: np.ndarray) -> np.ndarray:
    """(blocks, 8, 8, 8) of an array whose edges are multiples of 8, in the order of the flattened box of blocks."""
    split = dense.reshape([size for n in dense.shape for size in (n // EDGE, EDGE)])
    return split.transpose(0, 2, 4, 1, 3, 5).reshape(-1, EDGE, EDGE, EDGE)
