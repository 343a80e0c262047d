# SPDX-License-Identifier: GPL-3.0-or-later
"""A grid that stores only the blocks of voxels that are not empty."""

import functools
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.interpolation import lerp_into

# Voxels along an edge of a block: those of an OpenVDB leaf node.
EDGE = 8
# Voxels along an edge of the cells that rays skip: of usual grids, and of those with more voxels along an edge, whose
# cells would take longer to find than rays take to cross larger ones.
CELL, LARGE, LARGE_CELL = 4, 1024, EDGE
# Blocks that are processed together.
BLOCKS_PER_BATCH = 1 << 14


class SparseGrid:
    """float32 values of (nx, ny, nz) voxels, trilinear in between, 0 outside and in blocks that are not stored.

    shape: voxels. table: int32 (bx, by, bz), the row of `values` that stores each block of 8 x 8 x 8 voxels; row 0 for
    empty blocks, which all blocks at the border are. values: float32 (1 + M, 8, 8, 8), 0 in row 0 and outside the
    shape. first: int (3,), position of voxel (0, 0, 0) in the blocks.

    Immutable: properties of all values are computed once.
    """

    def __init__(
        self, shape: Sequence[int] | np.ndarray, table: np.ndarray, values: np.ndarray, first: ArrayLike
    ) -> None:
        self.shape, self.table, self.values = tuple(int(n) for n in shape), table, values
        self.first = np.array(first, int)

    @property
    def cell(self) -> int:
        """Voxels along an edge of the cells that rays skip."""
        return CELL if max(self.shape) <= LARGE else LARGE_CELL

    @property
    def cells_first(self) -> np.ndarray:
        """int (3,), position of voxel (0, 0, 0) in the cells."""
        return self.first

    @classmethod
    def of_blocks(
        cls,
        shape: Sequence[int] | np.ndarray,
        first: ArrayLike,
        count: Sequence[int],
        numbers: np.ndarray,
        values: np.ndarray,
    ) -> "SparseGrid":
        """From M blocks of a box of `count` (3,) blocks that has no border of empty blocks yet.

        first: as in the class, without the border. numbers: int (M,), indices of the blocks in the flattened box.
        values: float32 (1 + M, 8, 8, 8), row 0 all 0.
        """
        table = np.zeros(np.array(count) + 2, np.int32)
        table[tuple(index + 1 for index in np.unravel_index(numbers, count))] = np.arange(1, len(numbers) + 1)
        return cls(shape, table, values, np.array(first) + EDGE)

    @classmethod
    def of_dense(cls, dense: np.ndarray) -> "SparseGrid":
        """The non-empty blocks of an array (nx, ny, nz)."""
        count = [-(-n // EDGE) for n in dense.shape]
        blocks = blocks_of(np.pad(dense, [(0, EDGE * b - n) for b, n in zip(count, dense.shape)]))
        numbers = np.flatnonzero(blocks.any(axis=(1, 2, 3)))
        values = np.concatenate([np.zeros((1, EDGE, EDGE, EDGE), np.float32), blocks[numbers].astype(np.float32)])
        return cls.of_blocks(dense.shape, (0, 0, 0), count, numbers, values)

    @property
    def nbytes(self) -> int:
        """Memory in bytes."""
        return self.table.nbytes + self.values.nbytes

    @functools.cached_property
    def peak(self) -> float:
        """Largest value."""
        return float(self.values.max())

    @functools.cached_property
    def lowest(self) -> float:
        """Smallest value."""
        return float(self.values.min())

    def max(self) -> float:
        """As `peak`, by numpy's name."""
        return self.peak

    def min(self) -> float:
        """As `lowest`, by numpy's name."""
        return self.lowest

    def any(self) -> bool:
        """Whether any value is not 0."""
        return self.peak != 0.0 or self.lowest != 0.0

    def with_values(self, values: np.ndarray) -> "SparseGrid":
        """Other values (1 + M, 8, 8, 8) in the same blocks."""
        return SparseGrid(self.shape, self.table, values, self.first)

    def with_rows(self, rows: np.ndarray) -> "SparseGrid":
        """As `with_values`, without row 0: (M, 8, 8, 8)."""
        return self.with_values(np.concatenate([np.zeros((1, EDGE, EDGE, EDGE), np.float32), rows]))

    def equals(self, other: object) -> bool:
        """Whether the other is a SparseGrid with the same blocks and values."""
        return (
            isinstance(other, SparseGrid)
            and self.shape == other.shape
            and np.array_equal(self.first, other.first)
            and np.array_equal(self.table, other.table)
            and np.array_equal(self.values, other.values)
        )

    def crop(self, low: ArrayLike, high: ArrayLike) -> "SparseGrid":
        """Voxels from low (3,) to before high (3,), outside which all must be 0; shares the values."""
        return SparseGrid(np.subtract(high, low), self.table, self.values, self.first + low)

    def halved(self) -> "SparseGrid":
        """The means of 2 x 2 x 2 voxels, from voxel 0 on; zeros behind the last."""
        odd, count = self.first & 1, [-(-n // 2) for n in self.table.shape]
        # Where voxel 0 is at an odd position, a large block reaches into a third block.
        padded = np.pad(self.table, [(0, 2 * large + 1 - n) for large, n in zip(count, self.table.shape)])
        reach = [range(2 + int(o)) for o in odd]
        parts = [
            padded[tuple(slice(o, o + 2 * n, 2) for o, n in zip(offset, count))] for offset in itertools.product(*reach)
        ]
        numbers = np.flatnonzero(np.any(parts, axis=0))
        values = np.zeros((1 + len(numbers), EDGE, EDGE, EDGE), np.float32)
        per_batch = max(BLOCKS_PER_BATCH // 32, 1)
        for start in range(0, len(numbers), per_batch):
            some = numbers[start : start + per_batch]
            fine = np.zeros((len(some), 3, EDGE, 3, EDGE, 3, EDGE), np.float32)
            for (x, y, z), rows in zip(itertools.product(*reach), parts):
                fine[:, x, :, y, :, z, :] = self.values[rows.ravel()[some]]
            fine = fine.reshape(-1, 3 * EDGE, 3 * EDGE, 3 * EDGE)
            for axis, o in enumerate(odd, 1):
                along = np.moveaxis(fine, axis, 0)[o : o + 2 * EDGE]
                fine = np.moveaxis(0.5 * (along[::2] + along[1::2]), 0, axis)
            values[1 + start : 1 + start + len(some)] = fine
        return SparseGrid.of_blocks([-(-n // 2) for n in self.shape], self.first // 2, count, numbers, values)

    def bounds(self) -> tuple[np.ndarray, np.ndarray] | None:
        """As `bounds.filled_bounds`."""
        if self._filled is None:
            return None
        return self._filled[0] - self.first, self._filled[1] - self.first

    @functools.cached_property
    def _filled(self) -> tuple[np.ndarray, np.ndarray] | None:
        """First and last + 1 of the blocks' voxels that are not 0, on each axis, or None if all are 0."""
        # Per axis: whether the planes of voxels of each block layer hold a value other than 0.
        filled = [np.zeros((n, EDGE), bool) for n in self.table.shape]
        for positions, rows in self._stored_blocks():
            nonzero = self.values[rows] != 0.0
            for axis, position in enumerate(positions):
                planes = nonzero.any(axis=tuple(a + 1 for a in range(3) if a != axis))
                for inner in range(EDGE):
                    filled[axis][position[planes[:, inner]], inner] = True
        voxels = [np.flatnonzero(planes) for planes in filled]
        if not len(voxels[0]):
            return None
        return np.array([planes[0] for planes in voxels]), np.array([planes[-1] + 1 for planes in voxels])

    def slabs(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the first voxel (3,) and the values of boxes, one per row of blocks along the first axis.

        Every voxel that is not 0 lies in a box. The next box overwrites the array.
        """
        last = self.first + self.shape
        buffer = np.zeros((EDGE, *(EDGE * n for n in self.table.shape[1:])), np.float32)
        blocks = buffer.reshape(EDGE, self.table.shape[1], EDGE, self.table.shape[2], EDGE)
        for number, slab in enumerate(self.table):
            y, z = np.nonzero(slab)
            if not len(y):
                continue
            blocks[:, y, :, z, :] = self.values[slab[y, z]]
            low = np.maximum(self.first, [EDGE * number, EDGE * y.min(), EDGE * z.min()])
            high = np.minimum(last, [EDGE * (number + 1), EDGE * (y.max() + 1), EDGE * (z.max() + 1)])
            inside = (slice(low[0] - EDGE * number, high[0] - EDGE * number), *map(slice, low[1:], high[1:]))
            if np.all(low < high):
                yield low - self.first, buffer[inside]
            blocks[:, y, :, z, :] = 0.0

    def dense(self) -> np.ndarray:
        """float32 (nx, ny, nz)."""
        dense = np.zeros(self.shape, np.float32)
        for low, values in self.slabs():
            dense[tuple(map(slice, low, np.add(low, values.shape)))] = values
        return dense

    def sample(self, index: np.ndarray) -> np.ndarray:
        """Values float32 (N,) at continuous indices float32 (3, N), trilinear, 0 outside."""
        below: list[tuple[np.ndarray, np.ndarray]] = []
        above: list[tuple[np.ndarray, np.ndarray]] = []
        fractions = []
        # For the two voxels around a position, on each axis: the parts of the flat index due to block and voxel.
        block, voxel = self.table.size, EDGE**3
        for along, size, first, blocks in zip(index, self.shape, self.first, self.table.shape):
            block, voxel = block // blocks, voxel // EDGE
            # Indices outside are clamped onto the voxels there, where everything is 0.
            position = np.clip(along, np.float32(-1.0), np.float32(size)) + np.float32(first)
            cell = position.astype(np.int32)
            fractions.append(np.subtract(position, cell, out=position))
            for ends, corner in ((below, cell), (above, cell + 1)):
                ends.append(((corner >> 3) * np.int32(block), (corner & 7) * np.int32(voxel)))
        table, values = self.table.reshape(-1), self.values.reshape(-1)
        fx, fy, fz = fractions

        def at(*ends: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
            flat = table.take(ends[0][0] + ends[1][0] + ends[2][0]).astype(np.intp)
            flat *= EDGE**3
            flat += ends[0][1] + ends[1][1] + ends[2][1]
            return values.take(flat)

        def edge(x: tuple[np.ndarray, np.ndarray], y: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
            return lerp_into(at(x, y, below[2]), at(x, y, above[2]), fz)

        y0 = lerp_into(edge(below[0], below[1]), edge(below[0], above[1]), fy)
        y1 = lerp_into(edge(above[0], below[1]), edge(above[0], above[1]), fy)
        return lerp_into(y0, y1, fx)

    def cells(self) -> np.ndarray:
        """bool, cells of `cell` voxels along an edge, that hold a value other than 0."""
        per_block = EDGE // self.cell
        filled = np.zeros([n * per_block for n in self.table.shape], bool)
        blocks = filled.reshape([size for n in self.table.shape for size in (n, per_block)])
        for (x, y, z), rows in self._stored_blocks():
            cells = (self.values[rows] != 0.0).reshape(-1, *(per_block, self.cell) * 3)
            blocks[x, :, y, :, z, :] = cells.any(axis=(2, 4, 6))
        return filled

    def cell_peaks(self) -> np.ndarray:
        """float32, the largest value in cells of `cell` voxels along an edge."""
        per_block = EDGE // self.cell
        peaks = np.zeros([n * per_block for n in self.table.shape], np.float32)
        blocks = peaks.reshape([size for n in self.table.shape for size in (n, per_block)])
        for (x, y, z), rows in self._stored_blocks():
            cells = self.values[rows].reshape(-1, *(per_block, self.cell) * 3)
            blocks[x, :, y, :, z, :] = cells.max(axis=(2, 4, 6))
        return peaks

    def _stored_blocks(self) -> Iterator[tuple[tuple[np.ndarray, ...], np.ndarray]]:
        """Yield positions, three int (n,), and rows (n,) of the stored blocks, in batches."""
        positions = np.nonzero(self.table)
        rows = self.table[positions]
        for start in range(0, len(rows), BLOCKS_PER_BATCH):
            span = slice(start, start + BLOCKS_PER_BATCH)
            yield tuple(position[span] for position in positions), rows[span]


def blocks_of(dense: np.ndarray) -> np.ndarray:
    """(blocks, 8, 8, 8) of an array whose edges are multiples of 8, in the order of the flattened box of blocks."""
    split = dense.reshape([size for n in dense.shape for size in (n // EDGE, EDGE)])
    return split.transpose(0, 2, 4, 1, 3, 5).reshape(-1, EDGE, EDGE, EDGE)
