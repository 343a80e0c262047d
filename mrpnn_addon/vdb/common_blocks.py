# SPDX-License-Identifier: GPL-3.0-or-later
"""Aligned grids of one file, in the blocks in which any of them is not 0."""

from collections.abc import Mapping, Sequence

import numpy as np

from ...inference.scene.sparse_grid import EDGE, SparseGrid, blocks_of


class CommonBlocks:
    """Grids by name, SparseGrids and arrays, placed in a common box.

    offsets: int (3,) by name, position of each grid in the box. shape: (3,) voxels of the box. backgrounds: values
    outside the grids, by name. arrays: float32 (K, 8, 8, 8) by name.

    Raises ValueError where blocks of SparseGrids overlap partially.
    """

    def __init__(
        self,
        grids: dict[str, np.ndarray | SparseGrid],
        offsets: Mapping[str, np.ndarray],
        shape: Sequence[int] | np.ndarray,
        backgrounds: Mapping[str, float],
    ) -> None:
        starts = [offsets[name] - grid.first for name, grid in grids.items() if isinstance(grid, SparseGrid)]
        self.origin = -(-starts[0] % EDGE) if starts else np.zeros(3, int)
        if any(np.any((start - self.origin) % EDGE) for start in starts):
            raise ValueError("blocks overlap in part")
        count = -(-(np.array(shape) - self.origin) // EDGE)
        found: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for name, grid in grids.items():
            places, values = _blocks(grid, offsets[name] - self.origin, backgrounds[name])
            found[name] = np.ravel_multi_index(tuple(places.T), count), values
        self._alone: SparseGrid | None = None
        if len(found) == 1:
            ((name, (numbers, values)),) = found.items()
            self.arrays = {name: values}
            only = grids[name]
            self._alone = only if isinstance(only, SparseGrid) else None
        else:
            numbers = np.unique(np.concatenate([part for part, _ in found.values()]))
            shape_of_blocks = len(numbers), EDGE, EDGE, EDGE
            self.arrays = {name: np.full(shape_of_blocks, backgrounds[name], np.float32) for name in found}
            for name, (part, values) in found.items():
                self.arrays[name][np.searchsorted(numbers, part)] = values
        self.corners = EDGE * np.stack(np.unravel_index(numbers, count), axis=1) + self.origin
        self._frame = self._alone or SparseGrid.of_blocks(shape, -self.origin, count, numbers, None)

    def index(self, voxels: np.ndarray) -> np.ndarray:
        """int (n, 3), positions in the box of voxels int (n,) of the flattened arrays."""
        block, voxel = np.divmod(voxels, EDGE**3)
        return self.corners[block] + np.stack(np.unravel_index(voxel, (EDGE,) * 3), axis=1)

    def grid(self, values: np.ndarray) -> SparseGrid:
        """The SparseGrid of values (K, 8, 8, 8)."""
        # A single SparseGrid's own values need no copy.
        if self._alone is not None and values is next(iter(self.arrays.values())):
            return self._alone
        return self._frame.with_rows(values)


def _blocks(grid: np.ndarray | SparseGrid, offset: np.ndarray, background: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions int (n, 3) and values float32 (n, 8, 8, 8) of the blocks in which a grid is not its background.

    offset: int (3,), position of the grid in the box.
    """
    if isinstance(grid, SparseGrid):
        places = np.argwhere(grid.table)
        order = np.argsort(grid.table[tuple(places.T)])
        return places[order] + (offset - grid.first) // EDGE, grid.values[1:]
    first = offset // EDGE
    last = -(-(offset + grid.shape) // EDGE)
    around = [(o - EDGE * a, EDGE * b - o - n) for o, a, b, n in zip(offset, first, last, grid.shape)]
    values = blocks_of(np.pad(grid, around, constant_values=background))
    held = np.flatnonzero((values != np.float32(background)).any(axis=(1, 2, 3)))
    return np.stack(np.unravel_index(held, last - first), axis=1) + first, values[held]
