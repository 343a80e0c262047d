# SPDX-License-Identifier: GPL-3.0-or-later
"""Which parts of volumes surfaces shadow from a sun."""

import copy
from collections.abc import Sequence

import numpy as np

from ..numerics.intersection import box_interval
from ..numerics.small_matmul import inverse, product
from ..runtime.cancellation import NEVER, CancelToken
from .rasterization import batches, rasterize_nearest

#: Cells along the longer side of the volumes, as seen from the sun.
CELLS = 1024
# The map is tested at every COARSE-th row and column first.
COARSE = 16
# Fraction of its size by which a box is widened before all of it counts as shadowed.
MARGIN = 0.1


class ShadowMap:
    """Height of the highest surface above each cell of a plane perpendicular to the sun's direction.

    linear: (3, 3), offset: (3,): column, row and height from world positions, a frame as RayLines takes them.
    """

    def __init__(
        self,
        surfaces: Sequence[np.ndarray],
        direction: np.ndarray,
        corners: np.ndarray,
        cancel: CancelToken = NEVER,
        cells: int = CELLS,
    ):
        """Raises Cancelled.

        surfaces: triangles (T, 3, 3) of each, in the world. direction: (3,) unit vector to the sun. corners: (N, 3),
        whose convex hull holds all volumes. cells: along the longer side of these, as seen from the sun.
        """
        across = np.eye(3)[np.abs(direction).argmin()]
        across = np.cross(direction, across) / np.linalg.norm(np.cross(direction, across))
        axes = np.stack([across, np.cross(direction, across), direction])
        placed = product(corners, axes.T)
        low, high = placed.min(axis=0), placed.max(axis=0)
        cell = (high - low)[:2].max() / cells
        self.linear = axes / np.array([cell, cell, 1.0])[:, None]
        # The centres of the first cells have index 0.
        self.offset = -low / [cell, cell, 1.0] - [0.5, 0.5, 0.0]
        size = np.maximum(np.ceil((high - low)[:2] / cell), 1).astype(int)
        heights = np.full(size[::-1], -np.inf)
        for triangles in batches(surfaces):
            projected = product(triangles, self.linear.T) + self.offset
            highest, _ = rasterize_nearest(projected[..., :2], projected[..., 2], size, cancel)
            np.maximum(heights, highest, out=heights)
        self.heights = heights.astype(np.float32)

    def shades(self, corners: np.ndarray) -> bool:
        """Whether surfaces shadow any part of the boxes; corners: (B, 8, 3), in the order of `Grid.corners`."""
        return any(np.any(self._cells_below(box, stride)[1]) for stride in (COARSE, 1) for box in corners)

    def darkens(self, corners: np.ndarray) -> bool:
        """Whether surfaces shadow the boxes entirely, so that none of the sun's light reaches them.

        corners: as for `shades`.
        """
        return all(np.all(self._cells_below(box, stride, MARGIN)[0]) for stride in (COARSE, 1) for box in corners)

    def _cells_below(self, box: np.ndarray, stride: int, margin: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Whether surfaces lie above all of a box, and above any of it, in each cell whose column meets the box.

        box: (8, 3). stride: from one tested row or column to the next. margin: fraction of its size by which the box is
        widened.
        """
        heights = self.heights[::stride, ::stride]
        row, column = np.indices(heights.shape).reshape(2, -1)
        # A cell's column as a ray, in the frame in which the box is the unit cube.
        projected = box @ self.linear.T + self.offset
        turn = inverse(projected[[4, 2, 1]] - projected[0])
        foot = np.stack([column * stride, row * stride, np.zeros(len(row))], axis=1)
        low, high = box_interval(product(foot - projected[0], turn), turn[2:], -margin, 1.0 + margin)
        met = low < high
        return heights.reshape(-1)[met] > high[met], heights.reshape(-1)[met] > low[met]

    def transformed(self, linear: np.ndarray, centre: np.ndarray) -> "ShadowMap":
        """The same map in a frame whose x is the world's linear @ x + centre; linear: (3, 3), centre: (3,)."""
        moved = copy.copy(self)
        moved.linear, moved.offset = self.linear @ linear, self.linear @ centre + self.offset
        return moved

    def cell_visibility(self, cells: int, margin: int = 0, parts: int = 1) -> np.ndarray:
        """Mean visibility of the sun in the cells of the cube from -1/2 to 1/2, and in a margin of cells around it.

        cells: along an edge of the cube. margin: further cells beyond each face. parts: sample points along an edge of
        a cell. Returns float32 (n, n, n), n = cells + 2 margin.
        """
        count, half = cells + 2 * margin, 0.5 / cells * np.abs(self.linear).sum(axis=1)
        middle = (np.arange(count) + 0.5) / cells - margin / cells - 0.5
        inside = ((np.arange(parts) + 0.5) / parts - 0.5) / cells
        samples = self.linear @ np.stack(np.meshgrid(inside, inside, inside)).reshape(3, -1)
        x, y, z = (self.linear[:, axis, None] * middle for axis in range(3))
        slab = (y[:, :, None] + z[:, None]).reshape(3, -1) + self.offset[:, None]
        # Samples of a cell within the reach of a tile and those around it see heights between the extremes of these.
        size = int(np.ceil(half[:2].max())) + 1
        extremes = [_around_tiles(self.heights, size, extreme) for extreme in (np.maximum, np.minimum)]
        visibility = np.empty((count, count * count), np.float32)
        for lit, along in zip(visibility, x.T):
            index = (slab + along[:, None]).astype(np.float32)
            column, row = (np.clip(at / size, 0, n - 1).astype(int) for at, n in zip(index, extremes[0].shape[::-1]))
            most, least = (extreme[row, column] for extreme in extremes)
            lit[:] = index[2] - half[2] >= most
            some = np.flatnonzero((lit == 0.0) & (index[2] + half[2] >= least))
            at = index[:, some, None] + samples[:, None].astype(np.float32)
            lit[some] = self.visibility(at.reshape(3, -1)).reshape(len(some), parts**3).mean(axis=1)
        return visibility.reshape(count, count, count)

    def visibility_at(self, positions: np.ndarray) -> np.ndarray:
        """Visibility of the sun, as of `visibility`, at world positions (N, 3)."""
        return self.visibility((product(positions, self.linear.T) + self.offset).T.astype(np.float32))

    def visibility(self, index: np.ndarray) -> np.ndarray:
        """Visibility of the sun (N,) from 0 to 1 at indices float32 (3, N), by percentage-closer filtering.

        Interpolates the outcome of the shadow test between the four nearest cells.
        """
        column, row, height = index
        left, low = np.floor(column), np.floor(row)
        right, up = column - left, row - low
        rows, columns = self.heights.shape
        heights = self.heights.reshape(-1)
        visibility = np.zeros(len(height), np.float32)
        for i, x in ((left, 1.0 - right), (left + 1.0, right)):
            i = np.clip(i, 0, columns - 1).astype(np.int32)
            for j, y in ((low, 1.0 - up), (low + 1.0, up)):
                j = np.clip(j, 0, rows - 1).astype(np.int32)
                visibility += x * y * (height >= heights.take(j * columns + i))
        return visibility


def _around_tiles(heights: np.ndarray, size: int, extreme: np.ufunc) -> np.ndarray:
    """Largest or smallest of heights (rows, columns) in each tile of size x size cells and the eight around it."""
    for axis in (0, 1):
        heights = extreme.reduceat(heights, np.arange(0, heights.shape[axis], size), axis=axis)
        padded = np.moveaxis(np.pad(heights, [(int(a == axis),) * 2 for a in (0, 1)], mode="edge"), axis, 0)
        heights = np.moveaxis(extreme(extreme(padded[:-2], padded[1:-1]), padded[2:]), 0, axis)
    return heights
