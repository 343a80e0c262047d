"""Which parts of volumes surfaces shade from a sun."""

import copy

import numpy as np

from ..numerics.intersection import box_interval
from ..runtime.cancellation import NEVER, CancelToken
from .rasterization import rasterize

# Cells along the longer side of the volumes, as the sun sees them.
CELLS = 1024
# Of the map's rows and columns, one in so many is looked at first for whether anything or all is shaded.
FEW = 16
# Boxes are widened by this share before all of them counts as shaded.
MARGIN = 0.1


class ShadowMap:
    """How high above each cell of a plane across the sun's direction the highest surface lies.

    linear: (3, 3); offset: (3,): column, row and height from world positions, as frames of `RaySteps` have them.
    """

    def __init__(self, surfaces, direction: np.ndarray, corners: np.ndarray, cancel: CancelToken = NEVER):
        """surfaces: Surfaces; direction: (3,) unit vector to the sun; corners: (N, 3), whose hull holds all volumes.
        """
        aside = np.eye(3)[np.abs(direction).argmin()]
        aside = np.cross(direction, aside) / np.linalg.norm(np.cross(direction, aside))
        turned = np.stack([aside, np.cross(direction, aside), direction])
        low, high = (corners @ turned.T).min(axis=0), (corners @ turned.T).max(axis=0)
        cell = (high - low)[:2].max() / CELLS
        self.linear = turned / np.array([cell, cell, 1.0])[:, None]
        # Middles of the first cells have the index 0.
        self.offset = -low / [cell, cell, 1.0] - [0.5, 0.5, 0.0]
        size = np.maximum(np.ceil((high - low)[:2] / cell), 1).astype(int)
        heights = np.full(size[0] * size[1], -np.inf)
        for surface in surfaces:
            place = surface.triangles @ self.linear.T + self.offset
            for flat, height, _ in rasterize(place[..., :2], place[..., 2], size, cancel):
                np.maximum.at(heights, flat, height)
        self.heights = heights.reshape(size[1], size[0]).astype(np.float32)

    def shades(self, corners) -> bool:
        """Whether a surface lies above any part of some boxes; corners: (B, 8, 3), as `Grid.corners` gives them."""
        return any(np.any(self._met(box, every)[1]) for every in (FEW, 1) for box in corners)

    def darkens(self, corners) -> bool:
        """Whether surfaces lie above all of some boxes, so that none of the sun's light reaches them."""
        return all(np.all(self._met(box, every, MARGIN)[0]) for every in (FEW, 1) for box in corners)

    def _met(self, box, every: int, margin: float = 0.0):
        """Of the cells, one in `every`, that a box's columns meet, widened by a share of it: whether surfaces lie above all
        of the box there, and above any of it.
        """
        heights = self.heights[::every, ::every]
        row, column = np.indices(heights.shape).reshape(2, -1)
        # A cell's column as a ray in the frame in which the box is a unit cube.
        place = box @ self.linear.T + self.offset
        turn = np.linalg.inv(place[[4, 2, 1]] - place[0])
        foot = np.stack([column * every, row * every, np.zeros(len(row))], axis=1)
        low, high = box_interval((foot - place[0]) @ turn, turn[2:], -margin, 1.0 + margin)
        met = low < high
        return heights.reshape(-1)[met] > high[met], heights.reshape(-1)[met] > low[met]

    def seen_from(self, turn, centre) -> "ShadowMap":
        """The same in a frame in which x stands for the world's turn @ x + centre; turn: (3, 3), centre: (3,)."""
        turned = copy.copy(self)
        turned.linear, turned.offset = self.linear @ turn, self.linear @ centre + self.offset
        return turned

    def lit_cells(self, cells: int, margin: int = 0, parts: int = 1) -> np.ndarray:
        """Mean share of the light in each of cells^3 cells of a cube, from -1/2 to 1/2, and `margin` more around them.

        parts: places along a cell's edge. Returns float32 (n, n, n), n = cells + 2 margin.
        """
        count = cells + 2 * margin
        place = (np.arange(count * parts) + 0.5) / (cells * parts) - margin / cells - 0.5
        x, y, z = (np.float32(self.linear[:, axis, None] * place) for axis in range(3))
        z += self.offset[:, None].astype(np.float32)
        share = np.empty((count,) * 3, np.float32)
        for i in range(count):
            slab = x[:, i * parts : (i + 1) * parts, None, None] + (y[:, :, None] + z[:, None])[:, None]
            found = self.lit(slab.reshape(3, -1)).reshape(parts, count, parts, count, parts)
            share[i] = found.mean(axis=(0, 2, 4))
        return share

    def lit(self, index: np.ndarray) -> np.ndarray:
        """Share of the light (N,) that reaches indices float32 (3, N): the four cells around tell, by their nearness."""
        column, row, height = index
        left, low = np.floor(column), np.floor(row)
        across, up = column - left, row - low
        rows, columns = self.heights.shape
        heights = self.heights.reshape(-1)
        share = np.zeros(len(height), np.float32)
        for i, x in ((left, 1.0 - across), (left + 1.0, across)):
            i = np.clip(i, 0, columns - 1).astype(np.int32)
            for j, y in ((low, 1.0 - up), (low + 1.0, up)):
                j = np.clip(j, 0, rows - 1).astype(np.int32)
                share += x * y * (height >= heights.take(j * columns + i))
        return share
