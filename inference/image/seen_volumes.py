# SPDX-License-Identifier: GPL-3.0-or-later
"""Which volumes a part of the image shows, and which others shadow these."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..blur.eyes import Eyes
from ..grids.bound_medium import Movement
from ..grids.grid import Grid
from ..numerics.small_matmul import inverse
from ..plan.plan import make_tiles
from ..plan.resolution import BAND
from ..scene.camera import Camera
from ..scene.camera_rays import pixels_around, windows_around
from .framebuffer import Window

# Pixels around a volume that are not told apart.
SMALL = 256
# Volumes of a part of the image above which it is cut, down to a band of pixels, and those that are compared in pairs.
MOST_VOLUMES, MOST_PAIRED = 16, 64
# Edge in pixels of the squares in which several eyes' pixels are told apart.
SQUARE = 8


def shown_pixels(
    camera: Camera, grids: Sequence[Grid], eyes: Eyes | None = None, motion: Sequence[Movement | None] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the camera's window that may show a volume, bool (rows, columns), and the windows of each, int (V, 4).

    Windows (x0, y0, x1, y1) are of the image; those of volumes that are not seen are empty. eyes: of the camera.
    motion: as of BoundMedium, of each volume; empty where none moves.
    """
    x0, y0, x1, y1 = camera.window
    shown = np.zeros((y1 - y0, x1 - x0), bool)
    moving = motion or [None] * len(grids)
    boxes = np.array([_corners(grid, own) for grid, own in zip(grids, moving)]).reshape(-1, 8, 3)
    windows = windows_around(camera, boxes) if eyes is None else _windows_around(eyes, boxes, moving)
    # The more volumes there are, the smaller each is in the picture.
    detail = max(len(grids), 1) ** (-1.0 / 3.0) * (1.0 if eyes is None else 0.5)
    sizes = (windows[:, 2] - windows[:, 0]) * (windows[:, 3] - windows[:, 1])
    for n in np.flatnonzero(sizes > 0):
        left, top, right, bottom = windows[n] - [x0, y0, x0, y0]
        if sizes[n] <= SMALL or camera.projection == "equirectangular":
            shown[top:bottom, left:right] = True
            continue
        cells, corners = grids[n].support(detail)
        own = moving[n]
        if own is not None and own.flow is not None:
            # What it holds may be anywhere in its box.
            cells, corners = np.ones((1, 1, 1), bool), boxes[n].reshape(2, 2, 2, 3)
        around = (
            pixels_around(camera, cells, corners)
            if eyes is None
            else _around(camera, eyes, cells, _moving(corners, eyes, own))
        )
        rows, columns = np.flatnonzero(around.any(axis=1)), np.flatnonzero(around.any(axis=0))
        windows[n] = 0
        if len(rows):
            windows[n] = x0 + columns[0], y0 + rows[0], x0 + columns[-1] + 1, y0 + rows[-1] + 1
            shown[rows[0] : rows[-1] + 1] |= around[rows[0] : rows[-1] + 1]
    return shown, windows


def _corners(grid: Grid, motion: Movement | None) -> np.ndarray:
    """World corners (8, 3), at the frame, of the box in which rays may meet what a volume holds."""
    if motion is None or motion.flow is None:
        return grid.corners()
    return grid.corners_of(*motion.flow.support(grid))


def _moving(corners: np.ndarray, eyes: Eyes, motion: Movement | None) -> Iterator[np.ndarray]:
    """Places (..., 3) at the frame, where each eye sees them."""
    for number in range(len(eyes.cameras)):
        if motion is None:
            yield corners
        else:
            frame = motion.frames[number]
            yield (corners - frame[:, 3]) @ inverse(frame[:, :3]).T


def _windows_around(eyes: Eyes, corners: np.ndarray, motion: Sequence[Movement | None]) -> np.ndarray:
    """As `windows_around`, of all eyes together."""
    moving = [list(_moving(box, eyes, own)) for box, own in zip(corners, motion)]
    boxes = np.array(moving).reshape(len(corners), len(eyes.cameras), 8, 3).swapaxes(0, 1)
    windows = np.stack([windows_around(eye, seen) for eye, seen in zip(eyes.cameras, boxes)])
    seen = (windows[..., 2:] > windows[..., :2]).all(axis=2, keepdims=True)
    low = np.where(seen, windows[..., :2], np.iinfo(windows.dtype).max).min(axis=0)
    high = np.where(seen, windows[..., 2:], 0).max(axis=0)
    return np.concatenate([np.minimum(low, high), high], axis=1)


def _around(camera: Camera, eyes: Eyes, cells: np.ndarray, corners: Iterable[np.ndarray]) -> np.ndarray:
    """As `pixels_around`, of all eyes together; corners: as each eye sees them."""
    (width, height), (x0, y0, x1, y1) = camera.resolution, camera.window
    across = -(-width // SQUARE)
    scale = across / width
    down = int(np.ceil(height * scale))
    found = np.zeros((down + 2, across + 2), bool)
    for eye, seen in zip(eyes.cameras, corners):
        found[1:-1, 1:-1] |= pixels_around(replace(eye, resolution=(across, down), region=None), cells, seen)
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
            if not len(first):
                break
            # First those around all of them.
            some = np.flatnonzero(_shadows(low, high, first.min(axis=0), last.max(axis=0)))
            if len(first) <= MOST_PAIRED:
                some = some[_shadows(low[some, None], high[some, None], first, last).any(axis=1)]
            found[some] = True
        return np.flatnonzero(found)

    def cut(self, window: Window) -> list[Window]:
        """A window in parts of whole bands, each of which shows few volumes or is a single band."""
        x0, y0, x1, y1 = window
        bands = -(-max(x1 - x0, y1 - y0) // BAND)
        if bands <= 1 or np.count_nonzero(self._shown(window)) <= MOST_VOLUMES:
            return [window]
        return [part for smaller in make_tiles(window, -(-bands // 2)) for part in self.cut(smaller)]


def _shadows(low: np.ndarray, high: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Whether boxes, as of `SeenVolumes`, lie between others and a sun; arrays (..., 3), of ends of both."""
    across = (low[..., :2] <= last[..., :2]) & (first[..., :2] <= high[..., :2])
    return across.all(axis=-1) & (high[..., 2] >= first[..., 2])
