# SPDX-License-Identifier: GPL-3.0-or-later
"""Where opaque surfaces end camera rays.

Triangles are rasterized at several sample points per pixel; the nearest wins. A pixel crossed by the edge of a surface
is rendered as several rays, one for each distance at which parts of it end.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..runtime.cancellation import NEVER, CancelToken
from ..scene.camera import Camera
from ..scene.description import Surface
from .rasterization import rasterize

#: Sample points per axis and pixel.
SAMPLES = 4
# Distances that are distinguished within one pixel, as fractions of the interval of the ray within volumes.
DISTANCES = 16
# Pixels along the edges of the squares in which pixels are sampled.
TILE = 64
# Triangles are clipped at least at this fraction of the farthest one's distance.
CLOSEST = 1e-6


class DepthBuffer:
    """Surfaces as a perspective or orthographic camera sees them."""

    def __init__(self, surfaces: Sequence[Surface], camera: Camera, cancel: CancelToken = NEVER):
        """Raises Cancelled."""
        self.camera = camera
        # Every camera shows only what lies beyond its near clipping plane.
        eye, farthest = camera.world_matrix[:3, 3], 0.0
        for surface in surfaces:
            cancel.check()
            farthest = max(farthest, np.abs(surface.triangles - eye).max(initial=0.0))
        closest = max(camera.clip[0], CLOSEST * farthest)
        self.extent = 2.0 * np.tan(0.5 * camera.fov)
        projected = [self._project(surface.triangles - eye, closest, cancel) for surface in surfaces]
        self.place, self.value, number = (np.concatenate(parts) for parts in zip(*projected))
        # Number of each triangle among those of all surfaces.
        begin = np.cumsum([0, *(len(surface.triangles) for surface in surfaces[:-1])])
        self.number = number + np.repeat(begin, [len(parts[2]) for parts in projected])
        # Pixels that each triangle may reach, so that small windows need not look at all of them.
        self.low, self.high = self.place.min(axis=1) - 1.0, self.place.max(axis=1) + 1.0

    def _project(
        self, corners: np.ndarray, closest: float, cancel: CancelToken
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Project triangles to pixel coordinates (T, 3, 2), with values (T, 3) that grow towards the camera.

        The values interpolate linearly in the image: depth for orthographic cameras, 1 / depth for perspective ones.
        Also returns of which triangle each is a part, int (T,).
        """
        cancel.check()
        camera = self.camera
        rotation = camera.world_matrix[:3, :3] / np.linalg.norm(camera.world_matrix[:3, :3], axis=0)
        corners, number = _beyond(corners @ rotation, closest)
        cancel.check()
        width, height = camera.resolution
        if camera.projection == "orthographic":
            plane, value = corners[..., :2] / camera.ortho_scale, corners[..., 2]
        else:
            value = -1.0 / corners[..., 2]
            plane = corners[..., :2] * value[..., None] / self.extent
        place = np.stack(
            [(plane[..., 0] - camera.shift[0] + 0.5) * width, 0.5 * height - (plane[..., 1] - camera.shift[1]) * width],
            axis=-1,
        )
        return place, value, number

    def triangles(self, window: tuple[int, int, int, int], cancel: CancelToken = NEVER) -> np.ndarray:
        """Numbers int (rows, columns) of the nearest triangles at the sample points of the window's pixels.

        -1 where there is none. Raises Cancelled.
        """
        size, near, place = self._raster(window)
        found, number = np.full(size[0] * size[1], -np.inf), np.full(size[0] * size[1], -1)
        for flat, value, triangle in rasterize(place, self.value[near], size, cancel):
            np.maximum.at(found, flat, value)
            nearest = found[flat] == value
            number[flat[nearest]] = self.number[near[triangle[nearest]]]
        return number.reshape(size[1], size[0])

    def _raster(self, window: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns and rows of a window's sample points, and which triangles may reach them, with their corners."""
        x0, y0, x1, y1 = window
        near = self._near(window)
        return np.array([x1 - x0, y1 - y0]) * SAMPLES, near, (self.place[near] - [x0, y0]) * SAMPLES - 0.5

    def distances(self, window: tuple[int, int, int, int], cancel: CancelToken = NEVER) -> np.ndarray:
        """Distances float64 (N, SAMPLES^2) along rays through the window's pixels, row by row.

        Infinity where there is no surface. Raises Cancelled.
        """
        x0, y0, x1, y1 = window
        size, near, place = self._raster(window)
        found = np.full(size[0] * size[1], -np.inf)
        for flat, value, _ in rasterize(place, self.value[near], size, cancel):
            np.maximum.at(found, flat, value)
        columns, rows = (first + (np.arange(n) + 0.5) / SAMPLES for first, n in zip((x0, y0), size))
        distance = self._along(found.reshape(size[1], size[0]), columns, rows)
        parts = distance.reshape(y1 - y0, SAMPLES, x1 - x0, SAMPLES).transpose(0, 2, 1, 3)
        return parts.reshape(-1, SAMPLES**2)

    def corner_distances(self, window: tuple[int, int, int, int], cancel: CancelToken = NEVER) -> np.ndarray:
        """Distances float64 (rows + 1, columns + 1) along rays through the corners of the window's pixels.

        Infinity where there is no surface. Raises Cancelled.
        """
        x0, y0, x1, y1 = window
        near = self._near(window)
        size = np.array([x1 - x0, y1 - y0]) + 1
        found = np.full(size[0] * size[1], -np.inf)
        for flat, value, _ in rasterize(self.place[near] - [x0, y0], self.value[near], size, cancel):
            np.maximum.at(found, flat, value)
        return self._along(found.reshape(size[1], size[0]), x0 + np.arange(size[0]), y0 + np.arange(size[1]))

    def outlined(self, window: tuple[int, int, int, int]) -> np.ndarray:
        """bool (rows, columns): pixels of the window that an outline of a surface may cross, and those beside them.

        Elsewhere distances vary continuously within a pixel.
        """
        low, high = np.array(window[:2]) - 2, np.array(window[2:]) + 2
        found = np.zeros((high - low)[::-1], bool)
        start, end = self._outlines[:, :2], self._outlines[:, 2:]
        reached = np.all((np.minimum(start, end) < high) & (np.maximum(start, end) > low), axis=1)
        start, end = start[reached], end[reached]
        # Points at every half pixel along the axis in which an outline is longer, whatever the window; and its ends.
        axis = np.abs(end - start).argmax(axis=1)[:, None]
        begin, far = (np.take_along_axis(ends, axis, 1)[:, 0] for ends in (start, end))
        limits = low[axis[:, 0]], high[axis[:, 0]]
        first, last = (np.clip(np.sort([begin, far], axis=0), *limits) * 2.0).round()
        counts = (last - first).astype(int) + 1
        number = np.repeat(np.arange(len(counts)), counts)
        at = 0.5 * (first[number] + np.arange(len(number)) - np.repeat(np.cumsum(counts) - counts, counts))
        share = (at - begin[number]) / np.where(far == begin, 1.0, far - begin)[number]
        points = start[number] + np.clip(share, 0.0, 1.0)[:, None] * (end - start)[number]
        column, row = np.floor(points).astype(int).T - low[:, None]
        inside = (column >= 0) & (column < found.shape[1]) & (row >= 0) & (row < found.shape[0])
        found[row[inside], column[inside]] = True
        for _ in range(2):
            found[1:-1] = found[:-2] | found[1:-1] | found[2:]
            found = found.T
        return found[2:-2, 2:-2]

    @functools.cached_property
    def _outlines(self) -> np.ndarray:
        """Ends (E, 4) in the image of those edges of triangles that no neighbour continues."""
        if not len(self.place):
            return np.zeros((0, 4))
        (x, y), (u, v) = ((self.place[:, k] - self.place[:, 0]).T for k in (1, 2))
        turned = x * v - y * u > 0.0
        edges = np.concatenate([self.place[:, [k, (k + 1) % 3]] for k in range(3)]).reshape(-1, 4)
        swapped = (edges[:, 0] > edges[:, 2]) | ((edges[:, 0] == edges[:, 2]) & (edges[:, 1] > edges[:, 3]))
        edges[swapped] = edges[swapped][:, [2, 3, 0, 1]]
        order = np.lexsort(edges.T)
        edges, side = edges[order], np.tile(turned, 3)[order]
        first = np.flatnonzero(np.append(True, np.any(edges[1:] != edges[:-1], axis=1)))
        # Two triangles that turn the same side to the camera continue each other.
        count, facing = np.diff(np.append(first, len(edges))), np.add.reduceat(side.astype(int), first)
        return edges[first][(count != 2) | (facing == 1)]

    def _near(self, window: tuple[int, int, int, int]) -> np.ndarray:
        """Numbers of the triangles that may reach a window."""
        x0, y0, x1, y1 = window
        return np.flatnonzero(np.all((self.low < [x1, y1]) & (self.high > [x0, y0]), axis=1))

    def _along(self, value: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Distances along rays (R, C), from the values of `_project` at columns (C,) and rows (R,) of the image."""
        if self.camera.projection == "orthographic":
            return -value
        width, height = self.camera.resolution
        u = columns / width - 0.5 + self.camera.shift[0]
        v = ((0.5 * height - rows) / width + self.camera.shift[1])[:, None]
        with np.errstate(divide="ignore"):
            depth = np.where(value > 0.0, 1.0 / value, np.inf)
        return depth * np.sqrt(1.0 + self.extent**2 * (u * u + v * v))


@dataclass(frozen=True)
class EndedRays:
    """Rays of pixels, some of which surfaces end: M of them.

    pixel: int (M,), ascending, among the pixels asked for. far: (M,), where each ends. share: (M,), fraction of the
    pixel that it stands for. free: (M,), fraction of it that no surface ends beyond the interval either.
    """

    pixel: np.ndarray
    far: np.ndarray
    share: np.ndarray
    free: np.ndarray


def end_rays_at_surfaces(
    buffer: DepthBuffer,
    pixels: tuple[np.ndarray, np.ndarray],
    interval: tuple[np.ndarray, np.ndarray],
    cancel: CancelToken = NEVER,
) -> EndedRays:
    """Rays of pixels by columns and rows, int (N,), in intervals, near and far (N,), as surfaces end them.

    Within most pixels a surface is smooth, and one ray stands for all of it; others are sampled, see
    `split_rays_at_surfaces`. A surface in front of the interval leaves no ray. Raises Cancelled.
    """
    (columns, rows), (near, far) = pixels, interval
    some = np.flatnonzero(near < far)
    if not len(some):
        return EndedRays(some, *np.empty((3, 0)))
    left, top, right, bottom = columns[some].min(), rows[some].min(), columns[some].max() + 1, rows[some].max() + 1
    window = left, top, right, bottom
    corners, x, y = buffer.corner_distances(window, cancel), columns[some] - left, rows[some] - top
    ends = np.stack([corners[y + down, x + across] for down in (0, 1) for across in (0, 1)])
    hidden, first, last = np.isinf(ends), near[some], far[some]
    clipped = np.clip(ends, first, last)
    smooth = ~buffer.outlined(window)[y, x] & (hidden.all(axis=0) | ~hidden.any(axis=0))
    smooth &= np.ptp(clipped, axis=0) * DISTANCES <= last - first
    end = np.minimum(clipped.mean(axis=0), last)
    kept = smooth & (end > first)
    whole = EndedRays(some[kept], end[kept], np.ones(kept.sum()), hidden[0, kept].astype(float))
    numbers, distances, rough = [some[:0]], [np.empty((0, SAMPLES**2))], some[~smooth]
    tile = (columns[rough] - left) // TILE + (rows[rough] - top) // TILE * (1 + (right - left) // TILE)
    order = np.argsort(tile, kind="stable")
    for part in np.split(rough[order], np.flatnonzero(np.diff(tile[order])) + 1) if len(rough) else ():
        x0, y0, x1, y1 = columns[part].min(), rows[part].min(), columns[part].max() + 1, rows[part].max() + 1
        found = buffer.distances((x0, y0, x1, y1), cancel)
        distances.append(found[(rows[part] - y0) * (x1 - x0) + columns[part] - x0])
        numbers.append(part)
    number = np.concatenate(numbers)
    pixel, *values = split_rays_at_surfaces(near[number], far[number], np.concatenate(distances))
    split = EndedRays(number[pixel], *values)
    order = np.argsort(np.concatenate([whole.pixel, split.pixel]), kind="stable")
    return EndedRays(*(np.concatenate(pair)[order] for pair in zip(vars(whole).values(), vars(split).values())))


def split_rays_at_surfaces(
    near: np.ndarray, far: np.ndarray, distances: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rays (pixel int (M,), far (M,), share (M,), free (M,)) of pixels with an interval (N,) and distances (N, K).

    pixel: ascending. share: fraction of the pixel that the ray stands for. free: fraction of the ray that no surface
    ends beyond the interval either. A surface in front of the interval leaves no ray.
    """
    # Pixels without an interval get one of length 0.
    near, far = (np.where(near < far, ends, 0.0) for ends in (near, far))
    ends = np.clip(distances, near[:, None], far[:, None])
    length = np.where(far > near, far - near, 1.0)[:, None]
    group = np.ceil((ends - near[:, None]) / length * DISTANCES - 1e-9).astype(int)
    flat = (np.arange(len(near))[:, None] * (DISTANCES + 1) + np.clip(group, 0, DISTANCES)).ravel()
    count = np.bincount(flat, minlength=len(near) * (DISTANCES + 1))
    total = np.bincount(flat, ends.ravel(), minlength=len(count))
    used = np.flatnonzero((count > 0) & (np.arange(len(count)) % (DISTANCES + 1) > 0))
    pixel, last = used // (DISTANCES + 1), used % (DISTANCES + 1) == DISTANCES
    free = np.isinf(distances).sum(axis=1)[pixel] * last / count[used]
    return pixel, total[used] / count[used], count[used] / distances.shape[1], free


def _beyond(corners: np.ndarray, closest: float) -> tuple[np.ndarray, np.ndarray]:
    """Clip triangles (T, 3, 3), seen along -z, to the half-space behind the plane z = -closest.

    Also returns of which triangle each is a part.
    """
    depth = -corners[..., 2] - closest
    ahead = (depth > 0.0).sum(axis=1)
    parts, numbers = [corners[ahead == 3]], [np.flatnonzero(ahead == 3)]
    for inside in (1, 2):
        some, d = corners[ahead == inside], depth[ahead == inside]
        numbers += [np.flatnonzero(ahead == inside)] * inside
        # Rotate the corner that is alone on its side to the front.
        first = (d > 0.0).argmax(axis=1) if inside == 1 else (d <= 0.0).argmax(axis=1)
        order = (first[:, None] + np.arange(3)) % 3
        some, d = np.take_along_axis(some, order[..., None], 1), np.take_along_axis(d, order, 1)
        a, b = (some[:, 0] + (d[:, 0] / (d[:, 0] - d[:, k]))[:, None] * (some[:, k] - some[:, 0]) for k in (1, 2))
        if inside == 1:
            parts.append(np.stack([some[:, 0], a, b], axis=1))
        else:
            parts += [np.stack([a, some[:, 1], some[:, 2]], axis=1), np.stack([a, some[:, 2], b], axis=1)]
    return np.concatenate(parts), np.concatenate(numbers)
