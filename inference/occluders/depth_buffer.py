# SPDX-License-Identifier: GPL-3.0-or-later
"""Where opaque surfaces end camera rays.

Triangles are rasterized at several sample points per pixel; the nearest wins. A pixel crossed by the edge of a surface
is rendered as several rays, each ending at another distance.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..blur.eyes import Eyes
from ..blur.shutter import corners_at
from ..numerics.intersection import barycentric
from ..numerics.small_matmul import inverse, product
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.camera import Camera
from ..scene.camera_rays import pixel_rays
from ..scene.description import Surface
from .rasterization import batches, rasterize_nearest

#: Sample points per axis and pixel.
SAMPLES = 4
# Distances that are distinguished within one pixel, as fractions of the interval of the ray within volumes.
DISTANCES = 16
# Pixels along the edges of the squares in which pixels are sampled.
TILE = 64
# Triangles are clipped at least at this fraction of the distance of the farthest triangle.
CLOSEST = 1e-6


class DepthBuffer:
    """Surfaces as a perspective or orthographic camera sees them."""

    def __init__(self, surfaces: Sequence[Surface], camera: Camera, cancel: CancelToken = NEVER):
        """Raises Cancelled."""
        self.camera = camera
        # Every camera shows only what lies beyond its near clipping plane.
        eye, farthest = camera.world_matrix[:3, 3], 0.0
        joined = list(batches([surface.triangles for surface in surfaces]))
        for triangles in joined:
            cancel.check()
            farthest = max(farthest, np.abs(triangles - eye).max(initial=0.0))
        closest = max(camera.clip[0], CLOSEST * farthest)
        self.extent = 2.0 * np.tan(0.5 * camera.fov)
        projected = [self._project(triangles - eye, closest, cancel) for triangles in joined]
        self.corners, self.value, number = (np.concatenate(arrays) for arrays in zip(*projected))
        # Number of each triangle among those of all surfaces.
        begin = np.cumsum([0, *map(len, joined[:-1])])
        self.number = number + np.repeat(begin, [len(arrays[2]) for arrays in projected])
        # Pixels that each triangle may reach, so that small windows skip most triangles.
        self.low, self.high = self.corners.min(axis=1) - 1.0, self.corners.max(axis=1) + 1.0

    def _project(
        self, corners: np.ndarray, closest: float, cancel: CancelToken
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Project triangles to pixel coordinates (T, 3, 2), with values (T, 3) that grow towards the camera.

        The values interpolate linearly in the image: depth for orthographic cameras, 1 / depth for perspective cameras.
        Also returns the number of the triangle that each was clipped from, int (T,).
        """
        cancel.check()
        camera = self.camera
        rotation = camera.world_matrix[:3, :3] / np.linalg.norm(camera.world_matrix[:3, :3], axis=0)
        # A camera that sees through one point of a lens has oblique axes.
        corners, number = _beyond(product(corners, inverse(rotation).T), closest)
        cancel.check()
        if camera.projection == "orthographic":
            plane, value = corners[..., :2] / camera.ortho_scale, corners[..., 2]
        else:
            value = -1.0 / corners[..., 2]
            plane = corners[..., :2] * value[..., None] / self.extent
        return np.stack(camera.in_image(plane[..., 0], plane[..., 1]), axis=-1), value, number

    def triangles(self, window: tuple[int, int, int, int], cancel: CancelToken = NEVER) -> np.ndarray:
        """Numbers int (rows, columns) of the nearest triangles at the sample points of the window's pixels.

        -1 where there is no triangle. Raises Cancelled.
        """
        size, near, corners = self._raster(window)
        number = rasterize_nearest(corners, self.value[near], size, cancel)[1]
        return np.append(self.number[near], -1)[number]

    def _raster(self, window: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns and rows of a window's sample points, and which triangles may reach them, with their corners."""
        x0, y0, x1, y1 = window
        near = self._near(window)
        return np.array([x1 - x0, y1 - y0]) * SAMPLES, near, (self.corners[near] - [x0, y0]) * SAMPLES - 0.5

    def distances(self, window: tuple[int, int, int, int], cancel: CancelToken = NEVER) -> np.ndarray:
        """Distances float64 (N, SAMPLES^2) along rays through the window's pixels, row by row.

        Infinity where there is no surface. Raises Cancelled.
        """
        x0, y0, x1, y1 = window
        size, near, corners = self._raster(window)
        largest, _ = rasterize_nearest(corners, self.value[near], size, cancel)
        columns, rows = (first + (np.arange(n) + 0.5) / SAMPLES for first, n in zip((x0, y0), size))
        distance = self._along(largest, columns, rows)
        samples = distance.reshape(y1 - y0, SAMPLES, x1 - x0, SAMPLES).transpose(0, 2, 1, 3)
        return samples.reshape(-1, SAMPLES**2)

    def nearest(self, x: np.ndarray, y: np.ndarray, cancel: CancelToken = NEVER) -> tuple[np.ndarray, np.ndarray]:
        """Distances float64 (R, C) along rays through points of the image in columns at x (C,) and rows at y (R,), each
        evenly spaced, and the numbers int (R, C) of the triangles there: infinity and -1 where there is none.

        Raises Cancelled.
        """
        size = np.array([len(x), len(y)])
        near = self._near((x[0], y[0], x[-1], y[-1]))
        steps = [values[1] - values[0] if len(values) > 1 else 1.0 for values in (x, y)]
        corners = (self.corners[near] - [x[0], y[0]]) / steps
        largest, number = rasterize_nearest(corners, self.value[near], size, cancel)
        return self._along(largest, x, y), np.append(self.number[near], -1)[number]

    def outlined(self, window: tuple[int, int, int, int]) -> np.ndarray:
        """bool (rows, columns): pixels of the window that an outline of a surface may cross, and those beside them.

        Elsewhere distances vary continuously within a pixel.
        """
        low, high = np.array(window[:2]) - 2, np.array(window[2:]) + 2
        crossed = np.zeros((high - low)[::-1], bool)
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
        fraction = (at - begin[number]) / np.where(far == begin, 1.0, far - begin)[number]
        points = start[number] + np.clip(fraction, 0.0, 1.0)[:, None] * (end - start)[number]
        column, row = np.floor(points).astype(int).T - low[:, None]
        inside = (column >= 0) & (column < crossed.shape[1]) & (row >= 0) & (row < crossed.shape[0])
        crossed[row[inside], column[inside]] = True
        for _ in range(2):
            crossed[1:-1] = crossed[:-2] | crossed[1:-1] | crossed[2:]
            crossed = crossed.T
        return crossed[2:-2, 2:-2]

    @functools.cached_property
    def _outlines(self) -> np.ndarray:
        """Ends (E, 4) in the image of those edges of triangles that no neighbour continues."""
        if not len(self.corners):
            return np.zeros((0, 4))
        (x, y), (u, v) = ((self.corners[:, k] - self.corners[:, 0]).T for k in (1, 2))
        turned = x * v - y * u > 0.0
        edges = np.concatenate([self.corners[:, [k, (k + 1) % 3]] for k in range(3)]).reshape(-1, 4)
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
        u, v = self.camera.on_plane(columns, rows[:, None])
        with np.errstate(divide="ignore"):
            depth = np.where(value > 0.0, 1.0 / value, np.inf)
        return depth * np.sqrt(1.0 + self.extent**2 * (u * u + v * v))


@dataclass(frozen=True)
class EyeDistances:
    """Where surfaces end the rays of eyes through the pixels of a window.

    distances: float32 (rows, columns, rays) along the rays; infinity where there is no surface. moving: int32 of the
    same shape, the row of `velocities` of a surface that moves; -1 of others. velocities: float32 (M, 3), by how much
    the place moves that a ray meets while the shutter is open, world units.
    """

    distances: np.ndarray
    moving: np.ndarray
    velocities: np.ndarray


def eye_distances(
    surfaces: Sequence[Surface], eyes: Eyes, window: tuple[int, int, int, int], cancel: CancelToken = NEVER
) -> EyeDistances:
    """Where surfaces end the rays of eyes through a window's pixels, each at the time at which it sees.

    Raises Cancelled.
    """
    x0, y0, x1, y1 = window
    distances = np.full((y1 - y0, x1 - x0, eyes.rays), np.inf, np.float32)
    rows_of_moving, velocities = np.full(distances.shape, -1, np.int32), [np.zeros((0, 3), np.float32)]
    moving, still = ([one for one in surfaces if one.moves is moves] for moves in (True, False))
    opening, closing = (_corners([corners_at(one, time) for one in moving]) for time in (0.0, 1.0))
    met = 0
    for number, eye in enumerate(eyes.cameras):
        columns, rows = eyes.pixels_of(number, window)
        if len(columns) and len(rows):
            then = [replace(one, triangles=corners_at(one, eyes.times[number]), deformed=None) for one in moving]
            buffer = DepthBuffer([*then, *still], eye, cancel)
            found, triangle = buffer.nearest(columns + 0.5, rows + 0.5, cancel)
            place = rows[:, None] - y0, columns - x0, number % eyes.rays
            distances[place] = found
            row, column = np.nonzero((triangle >= 0) & (triangle < len(opening)))
            if len(row):
                origins, directions, *_ = pixel_rays(eye, columns[column], rows[row])
                points, of = origins + found[row, column, None] * directions, triangle[row, column]
                shares = barycentric(points, _corners([one.triangles for one in then])[of])
                velocities.append(np.einsum("nk,nkc->nc", shares, closing[of] - opening[of]).astype(np.float32))
                rows_of_moving[rows[row] - y0, columns[column] - x0, number % eyes.rays] = met + np.arange(len(row))
                met += len(row)
    return EyeDistances(distances, rows_of_moving, np.concatenate(velocities))


def _corners(triangles: Sequence[np.ndarray]) -> np.ndarray:
    """All of some triangles, (T, 3, 3) each."""
    return np.concatenate([np.zeros((0, 3, 3)), *triangles])


@dataclass(frozen=True)
class EndedRays:
    """M rays of pixels, ended by surfaces or by their intervals.

    pixel: int (M,), ascending, index into the pixels of the call. far: (M,), where the ray ends. share: (M,), fraction
    of the pixel that the ray stands for. free: (M,), fraction of the ray that no surface ends beyond the interval
    either.
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
    """Rays of pixels, ended by surfaces.

    pixels: columns and rows, int (N,). interval: near and far (N,). A pixel in which the surface is smooth has one ray;
    others are sampled, see `split_rays_at_surfaces`. A surface in front of the interval leaves no ray. Raises
    Cancelled.
    """
    (columns, rows), (near, far) = pixels, interval
    hit = np.flatnonzero(near < far)
    if not len(hit):
        return EndedRays(hit, *np.empty((3, 0)))
    left, top, right, bottom = columns[hit].min(), rows[hit].min(), columns[hit].max() + 1, rows[hit].max() + 1
    window = left, top, right, bottom
    # At the corners of pixels.
    corners, _ = buffer.nearest(np.arange(left, right + 1), np.arange(top, bottom + 1), cancel)
    x, y = columns[hit] - left, rows[hit] - top
    ends = np.stack([corners[y + down, x + across] for down in (0, 1) for across in (0, 1)])
    hidden, first, last = np.isinf(ends), near[hit], far[hit]
    clipped = np.clip(ends, first, last)
    smooth = ~buffer.outlined(window)[y, x] & (hidden.all(axis=0) | ~hidden.any(axis=0))
    smooth &= np.ptp(clipped, axis=0) * DISTANCES <= last - first
    end = np.minimum(clipped.mean(axis=0), last)
    visible = smooth & (end > first)
    unsplit = EndedRays(hit[visible], end[visible], np.ones(visible.sum()), hidden[0, visible].astype(float))
    numbers, distances, rough = [hit[:0]], [np.empty((0, SAMPLES**2))], hit[~smooth]
    tile = (columns[rough] - left) // TILE + (rows[rough] - top) // TILE * (1 + (right - left) // TILE)
    order = np.argsort(tile, kind="stable")
    for group in np.split(rough[order], np.flatnonzero(np.diff(tile[order])) + 1) if len(rough) else ():
        x0, y0, x1, y1 = columns[group].min(), rows[group].min(), columns[group].max() + 1, rows[group].max() + 1
        sampled = buffer.distances((x0, y0, x1, y1), cancel)
        distances.append(sampled[(rows[group] - y0) * (x1 - x0) + columns[group] - x0])
        numbers.append(group)
    number = np.concatenate(numbers)
    pixel, *values = split_rays_at_surfaces(near[number], far[number], np.concatenate(distances))
    split = EndedRays(number[pixel], *values)
    order = np.argsort(np.concatenate([unsplit.pixel, split.pixel]), kind="stable")
    return EndedRays(*(np.concatenate(pair)[order] for pair in zip(vars(unsplit).values(), vars(split).values())))


def split_rays_at_surfaces(
    near: np.ndarray, far: np.ndarray, distances: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rays (pixel int (M,), far (M,), share (M,), free (M,)) of pixels with an interval (N,) and distances (N, K).

    pixel: ascending. share: fraction of the pixel that the ray stands for. free: fraction of the ray that no surface
    ends beyond the interval either. A surface in front of the interval leaves no ray.
    """
    # Pixels without an interval get an empty interval.
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

    Also returns the number of the triangle that each was clipped from.
    """
    depth = -corners[..., 2] - closest
    ahead = (depth > 0.0).sum(axis=1)
    clipped, numbers = [corners[ahead == 3]], [np.flatnonzero(ahead == 3)]
    for inside in (1, 2):
        cut, d = corners[ahead == inside], depth[ahead == inside]
        numbers += [np.flatnonzero(ahead == inside)] * inside
        # Rotate the corner that is alone on its side to the front.
        first = (d > 0.0).argmax(axis=1) if inside == 1 else (d <= 0.0).argmax(axis=1)
        order = (first[:, None] + np.arange(3)) % 3
        cut, d = np.take_along_axis(cut, order[..., None], 1), np.take_along_axis(d, order, 1)
        a, b = (cut[:, 0] + (d[:, 0] / (d[:, 0] - d[:, k]))[:, None] * (cut[:, k] - cut[:, 0]) for k in (1, 2))
        if inside == 1:
            clipped.append(np.stack([cut[:, 0], a, b], axis=1))
        else:
            clipped += [np.stack([a, cut[:, 1], cut[:, 2]], axis=1), np.stack([a, cut[:, 2], b], axis=1)]
    return np.concatenate(clipped), np.concatenate(numbers)
