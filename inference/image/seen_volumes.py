# SPDX-License-Identifier: GPL-3.0-or-later
"""Which volumes a part of the image shows, and which others shadow these."""

from collections.abc import Sequence

import numpy as np

from ..grids.grid import Grid
from ..plan.plan import make_tiles
from ..plan.resolution import BAND
from ..scene.camera import Camera
from ..scene.camera_rays import pixels_around, windows_around
from .framebuffer import Window


def shown_pixels(camera: Camera, grids: Sequence[Grid]) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the camera's window that may show a volume, bool (rows, columns), and the windows of each, int (V, 4).

    Windows (x0, y0, x1, y1) are of the image; those of volumes that are not seen are empty.
    """
    x0, y0, x1, y1 = camera.window
    shown = np.zeros((y1 - y0, x1 - x0), bool)
    windows = windows_around(camera, np.array([grid.corners() for grid in grids]).reshape(-1, 8, 3))
    # The more volumes there are, the smaller each is in the picture.
    detail = max(len(grids), 1) ** (-1.0 / 3.0)
    sizes = (windows[:, 2] - windows[:, 0]) * (windows[:, 3] - windows[:, 1])
    for n in np.flatnonzero(sizes > 0):
        left, top, right, bottom = windows[n] - [x0, y0, x0, y0]
        if sizes[n] <= SMALL:
            shown[top:bottom, left:right] = True
            continue
        around = pixels_around(camera, *grids[n].support(detail))
        rows, columns = np.flatnonzero(around.any(axis=1)), np.flatnonzero(around.any(axis=0))
        windows[n] = 0
        if len(rows):
            windows[n] = x0 + columns[0], y0 + rows[0], x0 + columns[-1] + 1, y0 + rows[-1] + 1
            shown[rows[0] : rows[-1] + 1] |= around[rows[0] : rows[-1] + 1]
    return shown, windows


# Pixels around a volume that are not told apart.
SMALL = 256
# Volumes of a part of the image above which it is cut, down to a band of pixels, and those that are compared in pairs.
MOST_VOLUMES, MOST_PAIRED = 16, 64


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

    def _shown(self, window: Window) -> np.ndarray:
        """bool (V,): volumes that a window shows."""
        x0, y0, x1, y1 = window
        left, top, right, bottom = self._windows.T
        return (left < x1) & (x0 < right) & (top < y1) & (y0 < bottom)

    def __call__(self, window: Window) -> np.ndarray:
        """Numbers int (N,) of the volumes that a window shows or that shadow these from a sun, ascending."""
        seen = self._shown(window)
        found = seen.copy()
        for low, high in self._lit:
            first, last = low[seen], high[seen]
            if len(first) > MOST_PAIRED:
                # What surrounds all of them.
                first, last = first.min(axis=0, keepdims=True), last.max(axis=0, keepdims=True)
            for begin, end in zip(first, last):
                found |= (
                    (low[:, :2] <= end[:2]).all(axis=1)
                    & (begin[:2] <= high[:, :2]).all(axis=1)
                    & (high[:, 2] >= begin[2])
                )
        return np.flatnonzero(found)

    def cut(self, window: Window) -> list[Window]:
        """A window in parts of whole bands, each of which shows few volumes or is a single band."""
        x0, y0, x1, y1 = window
        bands = -(-max(x1 - x0, y1 - y0) // BAND)
        if bands <= 1 or np.count_nonzero(self._shown(window)) <= MOST_VOLUMES:
            return [window]
        return [part for smaller in make_tiles(window, -(-bands // 2)) for part in self.cut(smaller)]
