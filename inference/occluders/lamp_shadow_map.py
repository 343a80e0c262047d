# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points surfaces shadow from a lamp."""

import functools
from collections.abc import Sequence

import numpy as np

from ..runtime.cancellation import NEVER, CancelToken
from ..scene.camera import Camera
from ..scene.description import Surface
from .depth_buffer import SAMPLES, DepthBuffer

#: Distances along an edge of each of the six faces of the cube around a lamp.
CELLS = 1024
# Cells along an edge of the squares whose extremes are known; the kernel holds it, too.
BLOCK = 16


class LampShadowMap:
    """Distance of the nearest surface from a point, in all directions, on the faces of a cube around it.

    distances: float32 (6, n, n), infinity where there is no surface.
    """

    def __init__(
        self, surfaces: Sequence[Surface], position: np.ndarray, cells: int = CELLS, cancel: CancelToken = NEVER
    ):
        """position: (3,) in the world. cells: n, a multiple of `depth_buffer.SAMPLES`. Raises Cancelled."""
        self.position, size = np.asarray(position, np.float64), cells // SAMPLES
        self.frames = []
        faces = []
        for axis in range(3):
            for sign in (1.0, -1.0):
                # A camera that looks along its -Z.
                columns = [sign * np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3], -sign * np.eye(3)[axis]]
                matrix = np.eye(4)
                matrix[:3, :3], matrix[:3, 3] = np.stack(columns, axis=1), position
                self.frames.append(matrix[:3, :3])
                camera = Camera(matrix, resolution=(size, size), fov=np.pi / 2.0)
                distances = DepthBuffer(surfaces, camera, cancel).distances(camera.window, cancel)
                distances = distances.reshape(size, size, SAMPLES, SAMPLES).transpose(0, 2, 1, 3)
                faces.append(distances.reshape(cells, cells))
        self.distances = np.stack(faces).astype(np.float32)

    @functools.cached_property
    def extremes(self) -> np.ndarray:
        """Least and largest distance, float32 (6, m, m, 2), in squares of BLOCK x BLOCK cells.

        The next row and column count, too: filtering from a cell of the square may read them.
        """
        blocks = -(-self.distances.shape[1] // BLOCK)
        missing = blocks * BLOCK + 1 - self.distances.shape[1]
        cells = np.pad(self.distances, [(0, 0), (0, missing), (0, missing)], mode="edge")
        return np.stack([_in_squares(cells, blocks, extreme) for extreme in (np.minimum, np.maximum)], axis=-1)

    @property
    def empty(self) -> bool:
        """Whether there is no surface in any direction."""
        return bool(np.isinf(self.distances).all())

    def distance(self, directions: np.ndarray) -> np.ndarray:
        """Distance float32 (N,) of the nearest surface in directions (N, 3), or infinity."""
        face, column, row = self._cells(directions)
        return self.distances[face, self._clipped(np.rint(row)), self._clipped(np.rint(column))]

    def visibility(self, points: np.ndarray) -> np.ndarray:
        """Visibility float32 (N,) of the lamp from 0 to 1 at world points (N, 3), by percentage-closer filtering.

        Interpolates the outcome of the shadow test between the four nearest directions.
        """
        away = np.asarray(points, np.float64) - self.position
        distance = np.linalg.norm(away, axis=1).astype(np.float32)
        visibility = np.zeros(len(away), np.float32)
        face, column, row = self._cells(away)
        left, top = np.floor(column), np.floor(row)
        u, v = (column - left).astype(np.float32), (row - top).astype(np.float32)
        for i, x in ((left, 1.0 - u), (left + 1.0, u)):
            for j, y in ((top, 1.0 - v), (top + 1.0, v)):
                visibility += x * y * (distance <= self.distances[face, self._clipped(j), self._clipped(i)])
        return visibility

    def _cells(self, away: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Face int (N,), and continuous column and row (N,) on it, in which vectors (N, 3) from the lamp point."""
        axis = np.abs(away).argmax(axis=1)
        along = np.take_along_axis(away, axis[:, None], 1)[:, 0]
        face = 2 * axis + (along < 0.0)
        local = np.einsum("nij,ni->nj", np.stack(self.frames)[face], away)
        depth, half = np.maximum(-local[:, 2], 1e-30), 0.5 * self.distances.shape[1]
        return face, (local[:, 0] / depth + 1.0) * half - 0.5, (1.0 - local[:, 1] / depth) * half - 0.5

    def _clipped(self, cells: np.ndarray) -> np.ndarray:
        """Indices int (N,) of columns or rows, within a face."""
        return np.clip(cells, 0, self.distances.shape[1] - 1).astype(int)


def _in_squares(cells: np.ndarray, blocks: int, extreme: np.ufunc) -> np.ndarray:
    """Least or largest (6, m, m) of cells (6, n, n) in squares; n: m BLOCK + 1."""
    starts = np.arange(0, blocks * BLOCK, BLOCK)
    rows = extreme(extreme.reduceat(cells[:, :-1], starts, axis=1), cells[:, BLOCK::BLOCK])
    return extreme(extreme.reduceat(rows[:, :, :-1], starts, axis=2), rows[:, :, BLOCK::BLOCK])
