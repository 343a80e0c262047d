"""Which parts of volumes surfaces shade from a sun."""

import numpy as np

from .surfaces import covered

# Cells along the longer side of the volumes, as the sun sees them.
CELLS = 1024


class SunMap:
    """How high above each cell of a plane across the sun's direction the highest surface lies.

    linear: (3, 3); offset: (3,): column, row and height from world positions, as frames of `RaySteps` have them.
    """

    def __init__(self, surfaces, direction: np.ndarray, corners: np.ndarray):
        """surfaces: Surfaces; direction: (3,) unit vector to the sun; corners: (N, 3), whose hull holds all volumes."""
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
            for flat, height in covered(place[..., :2], place[..., 2], size):
                np.maximum.at(heights, flat, height)
        self.heights = heights.reshape(size[1], size[0]).astype(np.float32)

    @property
    def empty(self) -> bool:
        """Whether no surface lies above or below the volumes."""
        return not np.isfinite(self.heights).any()

    def lit(self, index: np.ndarray) -> np.ndarray:
        """Share of the light (N,) that reaches indices float32 (3, N): the four cells around tell, by their nearness."""
        column, row, height = index
        left, low = np.floor(column), np.floor(row)
        across, up = column - left, row - low
        rows, columns = self.heights.shape
        share = np.zeros(len(height), np.float32)
        for i, x in ((left, 1.0 - across), (left + 1.0, across)):
            i = np.clip(i, 0, columns - 1).astype(np.intp)
            for j, y in ((low, 1.0 - up), (low + 1.0, up)):
                j = np.clip(j, 0, rows - 1).astype(np.intp)
                share += x * y * (height >= self.heights[j, i])
        return share
