# SPDX-License-Identifier: GPL-3.0-or-later
"""How far eyes see a point apart, which tells over how many pixels a picture is blurred."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..numerics.small_matmul import inverse
from ..scene.camera import Camera
from ..scene.camera_rays import image_rays, seen_at
from .eyes import Eyes

# Knots along an edge of a window at which spreads are computed.
KNOTS = 3
# Fraction of the spread of a point over which pixels are joined, and the spread in pixels of a point that is sharp.
JOINED, SHARP = 0.75, 0.25
# Ratio of the farthest to the nearest of two distances that tell how spreads vary between them, at least.
LEAST_RATIO = 1.5
# Times of eyes where nothing is carried.
NEVER = np.zeros(0)


class Spreads:
    """Covariances of where eyes see a point of a camera's ray, in a window of the image.

    Where a point is seen is linear in the reciprocal of its distance, for orthographic cameras in its distance. Two
    distances therefore tell the spread at all of them.

    ends: nearest and farthest distance that matter. frames: as of Movement, of what moves in front of the camera.
    times: (E,), at which eyes see what velocities carry besides; empty where nothing is carried.
    """

    def __init__(
        self,
        eyes: Eyes,
        camera: Camera,
        window: tuple[int, int, int, int],
        ends: tuple[float, float],
        frames: np.ndarray | None = None,
        times: np.ndarray = NEVER,
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
        if frames is not None:
            moving = ((points - back[:, 3]) @ inverse(back[:, :3]).T for back in frames)
        seen = np.stack([seen_at(eye, places) for eye, places in zip(eyes.cameras, moving)])
        first, last = self._places(np.array([near, far]))
        # (2, E, 2, knots): where at place 0, and the slope.
        slope = (seen[:, :, 1] - seen[:, :, 0]) / (last - first)
        lines = np.stack([seen[:, :, 0] - first * slope, slope])
        lines = lines - lines.mean(axis=1, keepdims=True)
        # (2, 2, 2, 2, knots): of lines and axes.
        count = len(eyes.cameras)
        products = np.einsum("aeik,bejk->abijk", lines, lines) / count
        powers = np.stack([products[0, 0], products[0, 1] + products[1, 0], products[1, 1]])
        #: (3, 3, knots): powers of the place, and xx, xy and yy.
        self._powers = np.stack([powers[:, 0, 0], powers[:, 0, 1], powers[:, 1, 1]], axis=1)
        self._camera = replace(camera, lens=None, shutter=None)
        self._duration = float(np.std(times)) if len(times) else 0.0
        #: (2, 2, knots): of lines and axes, how they vary with the time.
        self._with_time = np.einsum("aeik,e->aik", lines, times - np.mean(times)) / count if len(times) else None

    def _places(self, distances: np.ndarray) -> np.ndarray:
        return distances if self._linear else 1.0 / distances

    def sharpness(self, pixel: np.ndarray, distances: np.ndarray, velocities: np.ndarray | None = None) -> np.ndarray:
        """Inverse covariances float32 (N, 3), xx, xy and yy in pixels^-2, over which pixels are joined.

        pixel: int (N,), of the window, row by row. distances: (N,) along the rays. velocities: (N, 3) of what is there,
        world units per unit of time.
        """
        x0, y0, x1, y1 = self._window
        row, column = np.divmod(pixel, x1 - x0)
        knot = row * KNOTS // (y1 - y0) * KNOTS + column * KNOTS // (x1 - x0)
        place = self._places(np.maximum(distances, 1e-12))
        with np.errstate(all="ignore"):
            xx, xy, yy = (a[knot] + (b[knot] + c[knot] * place) * place for a, b, c in np.moveaxis(self._powers, 1, 0))
            if velocities is not None and self._with_time is not None and self._duration > 0.0:
                x, y = self._moved(column + x0 + 0.5, row + y0 + 0.5, distances, velocities)
                with_x, with_y = (a[knot] + b[knot] * place for a, b in np.moveaxis(self._with_time, 1, 0))
                square = self._duration**2
                xx, yy = xx + x * (square * x + 2.0 * with_x), yy + y * (square * y + 2.0 * with_y)
                xy = xy + square * x * y + x * with_y + y * with_x
            xx, xy, yy = JOINED**2 * xx + SHARP**2, JOINED**2 * xy, JOINED**2 * yy + SHARP**2
            found = np.stack([yy, -xy, xx], axis=1) / np.maximum(xx * yy - xy * xy, SHARP**4)[:, None]
        # What some eye sees beside or behind it is blurred without bounds.
        return np.nan_to_num(found, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)

    def _moved(
        self, column: np.ndarray, row: np.ndarray, distances: np.ndarray, velocities: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pixels per unit of time, (N,) each to the right and down, by which velocities move what is seen."""
        origins, directions, _ = image_rays(self._camera, column, row)
        points = origins + distances[:, None] * directions
        x, y = (seen_at(self._camera, points + self._duration * velocities) - [column, row]) / self._duration
        return x, y
