# SPDX-License-Identifier: GPL-3.0-or-later
"""How far eyes see a point apart, which tells over how many pixels a picture is blurred."""

from collections.abc import Iterable

import numpy as np

from ..scene.camera import Camera
from ..scene.camera_rays import image_rays, seen_at
from .eyes import Eyes

# Knots along an edge of a window at which spreads are computed.
KNOTS = 3
# Fraction of the spread of a point over which pixels are joined, and the spread in pixels of a point that is sharp.
JOINED, SHARP = 0.75, 0.25
# Ratio of the farthest to the nearest of two distances that tell how spreads vary between them, at least.
LEAST_RATIO = 1.5


class Spreads:
    """Covariances of where eyes see a point of a camera's ray, in a window of the image.

    Where a point is seen is linear in the reciprocal of its distance, for orthographic cameras in its distance. Two
    distances therefore tell the spread at all of them.

    ends: nearest and farthest distance that matter. motion: as of BoundMedium, of what moves in front of the camera.
    """

    def __init__(
        self,
        eyes: Eyes,
        camera: Camera,
        window: tuple[int, int, int, int],
        ends: tuple[float, float],
        motion: np.ndarray | None = None,
    ):
        (x0, y0, x1, y1), (near, far) = window, ends
        self._window, self._linear = window, camera.projection == "orthographic"
        near = max(near, 1e-12)
        far = max(far, LEAST_RATIO * near)
        part = (np.arange(KNOTS) + 0.5) / KNOTS
        x, y = (values.ravel() for values in np.meshgrid(x0 + part * (x1 - x0), y0 + part * (y1 - y0)))
        origins, directions, _ = image_rays(camera, x, y)
        points = np.stack([origins + distance * directions for distance in (near, far)])
        moving: Iterable[np.ndarray] = [points] * len(eyes.cameras)
        if motion is not None:
            moving = ((points - back[:, 3]) @ np.linalg.inv(back[:, :3]).T for back in motion)
        seen = np.stack([seen_at(eye, places) for eye, places in zip(eyes.cameras, moving)])
        first, last = self._places(np.array([near, far]))
        # (2, E, 2, knots): where at place 0, and the slope.
        slope = (seen[:, :, 1] - seen[:, :, 0]) / (last - first)
        lines = np.stack([seen[:, :, 0] - first * slope, slope])
        lines = lines - lines.mean(axis=1, keepdims=True)
        # (2, 2, 2, 2, knots): of lines and axes.
        products = np.einsum("aeik,bejk->abijk", lines, lines) / len(eyes.cameras)
        powers = np.stack([products[0, 0], products[0, 1] + products[1, 0], products[1, 1]])
        #: (3, 3, knots): powers of the place, and xx, xy and yy.
        self._powers = np.stack([powers[:, 0, 0], powers[:, 0, 1], powers[:, 1, 1]], axis=1)

    def _places(self, distances: np.ndarray) -> np.ndarray:
        return distances if self._linear else 1.0 / distances

    def sharpness(self, pixel: np.ndarray, distances: np.ndarray) -> np.ndarray:
        """Inverse covariances float32 (N, 3), xx, xy and yy in pixels^-2, over which pixels are joined.

        pixel: int (N,), of the window, row by row. distances: (N,) along the rays.
        """
        x0, y0, x1, y1 = self._window
        row, column = np.divmod(pixel, x1 - x0)
        knot = row * KNOTS // (y1 - y0) * KNOTS + column * KNOTS // (x1 - x0)
        place = self._places(np.maximum(distances, 1e-12))
        with np.errstate(all="ignore"):
            xx, xy, yy = (a[knot] + (b[knot] + c[knot] * place) * place for a, b, c in np.moveaxis(self._powers, 1, 0))
            xx, xy, yy = JOINED**2 * xx + SHARP**2, JOINED**2 * xy, JOINED**2 * yy + SHARP**2
            found = np.stack([yy, -xy, xx], axis=1) / np.maximum(xx * yy - xy * xy, SHARP**4)[:, None]
        # What some eye sees beside or behind it is blurred without bounds.
        return np.nan_to_num(found, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
