# SPDX-License-Identifier: GPL-3.0-or-later
"""Which volumes a part of the image shows, and which others shadow these."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..blur.eyes import Eyes
from ..grids.grid import Grid
from ..scene.camera import Camera
from ..scene.camera_rays import pixels_around
from .framebuffer import Window

# Edge in pixels of the squares in which several eyes' pixels are told apart.
SQUARE = 8


def shown_pixels(camera: Camera, grids: Sequence[Grid], eyes: Eyes | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the camera's window that may show a volume, bool (rows, columns), and the windows of each, int (V, 4).

    Windows (x0, y0, x1, y1) are of the image; those of volumes that are not seen are empty. eyes: of the camera.
    """
    x0, y0, x1, y1 = camera.window
    shown, windows = np.zeros((y1 - y0, x1 - x0), bool), np.zeros((len(grids), 4), int)
    # The more volumes there are, the smaller each is in the picture.
    detail = max(len(grids), 1) ** (-1.0 / 3.0) * (1.0 if eyes is None else 0.5)
    for window, grid in zip(windows, grids):
        cells, corners = grid.support(detail)
        around = pixels_around(camera, cells, corners) if eyes is None else _around(camera, eyes, cells, corners)
        rows, columns = np.flatnonzero(around.any(axis=1)), np.flatnonzero(around.any(axis=0))
        if len(rows):
            window[:] = x0 + columns[0], y0 + rows[0], x0 + columns[-1] + 1, y0 + rows[-1] + 1
            shown[rows[0] : rows[-1] + 1] |= around[rows[0] : rows[-1] + 1]
    return shown, windows


def _around(camera: Camera, eyes: Eyes, cells: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """As `pixels_around`, of all eyes together."""
    (width, height), (x0, y0, x1, y1) = camera.resolution, camera.window
    across = -(-width // SQUARE)
    scale = across / width
    down = int(np.ceil(height * scale))
    found = np.zeros((down + 2, across + 2), bool)
    for eye in eyes.cameras:
        found[1:-1, 1:-1] |= pixels_around(replace(eye, resolution=(across, down), region=None), cells, corners)
    # The middle of the image stays where it is, which moves rows by less than a square.
    found[:, 1:-1] |= found[:, :-2] | found[:, 2:]
    found[1:-1] |= found[:-2] | found[2:]
    columns = ((np.arange(x0, x1) + 0.5) * scale).astype(int)
    rows = ((np.arange(y0, y1) + 0.5 - 0.5 * height) * scale + 0.5 * down).astype(int)
    return found[1 + np.clip(rows, 0, down - 1)[:, None], 1 + np.clip(columns, 0, across - 1)]


class SeenVolumes:
    """The volumes that matter to parts of an image.

    windows: of `shown_pixels`. corners: (8 V, 3), of the volumes' boxes in the world. suns: directions (L, 3) towards
    them.
    """

    def __init__(self, windows: np.ndarray, corners: np.ndarray, suns: Sequence[np.ndarray]):
        self._windows, self._lit = windows, []
        for direction in suns:
            # Rectangles across the sun's rays, and where along them boxes end.
            across = np.linalg.svd(direction[None])[2][1:]
            frame = corners @ np.vstack([across, direction]).T
            boxes = frame.reshape(-1, 8, 3)
            self._lit.append((boxes.min(axis=1), boxes.max(axis=1)))

    def __call__(self, window: Window) -> np.ndarray:
        """Numbers int (N,) of the volumes that a window shows or that shadow these from a sun, ascending."""
        x0, y0, x1, y1 = window
        left, top, right, bottom = self._windows.T
        seen = (left < x1) & (x0 < right) & (top < y1) & (y0 < bottom)
        found = seen.copy()
        for low, high in self._lit:
            for one in np.flatnonzero(seen):
                crosses = (low[:, :2] <= high[one, :2]).all(axis=1) & (low[one, :2] <= high[:, :2]).all(axis=1)
                found |= crosses & (high[:, 2] >= low[one, 2])
        return np.flatnonzero(found)
