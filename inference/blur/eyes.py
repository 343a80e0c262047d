# SPDX-License-Identifier: GPL-3.0-or-later
"""Pinhole cameras that sample the lens and the shutter of another camera.

A camera that sees through one point of a thin lens at one time is a pinhole camera whose window is shifted. Each
pixel has rays of a few such eyes, and the pixels of a block have different ones, so that all eyes together sample lens
and shutter densely. Pixels that show what is blurred are joined afterwards (`reconstruction`).
"""

from dataclasses import dataclass, replace

import numpy as np

from ..scene.camera import Camera, Lens
from .shutter import camera_at, shutter_times

#: Edge in pixels of the block within which all pixels have different eyes: a power of two.
BLOCK = 4
#: Where in its rays' intervals of time each pixel of a block looks, in sixteenths, by row and column. Each row, each
#: column and each square of 2 x 2 has one of each quarter, since what moves along a row is joined along it alone.
SHIFTS = np.array([[0, 6, 11, 13], [9, 15, 2, 4], [14, 8, 5, 3], [7, 1, 12, 10]])


@dataclass(frozen=True)
class Eyes:
    """cameras: E of them, without lens and shutter, those of each pixel of a block after another. rays: per pixel.
    times: (E,) of the shutter at which they see, from 0 to 1.
    """

    cameras: list[Camera]
    rays: int
    times: np.ndarray

    def of_pixels(self, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Numbers int (N, rays) of the eyes of pixels by column and row, int (N,)."""
        return _places(columns, rows)[:, None] * self.rays + np.arange(self.rays)

    def pixels_of(self, number: int, window: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Columns int (C,) and rows (R,) of a window's pixels that an eye has rays through."""
        place, (x0, y0, x1, y1) = number // self.rays, window
        column, row = (
            sum(place >> (2 * k + down) & 1 and 1 << k for k in range(BLOCK.bit_length())) for down in (0, 1)
        )
        return x0 + np.arange((column - x0) % BLOCK, x1 - x0, BLOCK), y0 + np.arange((row - y0) % BLOCK, y1 - y0, BLOCK)


def find_eyes(camera: Camera, rays: int) -> Eyes | None:
    """The eyes of a camera with so many rays per pixel; None for one without lens and shutter."""
    if camera.lens is None and camera.shutter is None:
        return None
    count = BLOCK**2 * rays
    u, v, w = _spread(count)
    number = np.arange(count) % rays
    # Within the pixel: the rays of a pixel spread over its area.
    beside = np.stack([(number + 0.5) / rays - 0.5, _reversed_bits(number, rays) - 0.5], axis=1)
    times = np.full(count, 0.5) if camera.shutter is None else shutter_times(camera.shutter, _evenly(w, rays))
    points = np.zeros((count, 2)) if camera.lens is None else aperture_points(camera.lens, u, v)
    return Eyes([_eye(camera_at(camera, times[n]), points[n], beside[n]) for n in range(count)], rays, times)


def aperture_points(lens: Lens, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Points (N, 2) of the aperture, world units, evenly spread where (u, v), (N,) each, are in the unit square."""
    if lens.blades < 3:
        # Shirley and Chiu 1997: squares around the centre become circles.
        x, y = 2.0 * u - 1.0, 2.0 * v - 1.0
        wide = np.abs(x) > np.abs(y)
        radius = np.where(wide, x, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            angle = np.where(wide, 0.25 * np.pi * y / x, 0.5 * np.pi - 0.25 * np.pi * x / y)
        angle = np.where(radius == 0.0, 0.0, angle)
        points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    else:
        # Triangles from the centre to each side; the middle of the first side lies at the rotation.
        part = np.minimum((u * lens.blades).astype(int), lens.blades - 1)
        away, along = np.sqrt(u * lens.blades - part), v
        angles = lens.rotation + 2.0 * np.pi * (part[:, None] + [-0.5, 0.5]) / lens.blades
        first, last = (np.stack([np.cos(a), np.sin(a)], axis=1) for a in angles.T)
        points = away[:, None] * ((1.0 - along[:, None]) * first + along[:, None] * last)
    return lens.radius * points / [lens.ratio, 1.0]


def _eye(camera: Camera, point: np.ndarray, beside: np.ndarray) -> Camera:
    """A camera through a point (2,) of its lens, if any. beside: (2,) pixels, of rays from centres of pixels."""
    lens = camera.lens
    if camera.projection == "equirectangular":
        return replace(camera, lens=None if lens is None else replace(lens, point=tuple(point)))
    shift = np.array(camera.shift) + beside * [1.0, -camera.pixel_aspect] / camera.resolution[0]
    matrix = camera.world_matrix.copy()
    axes = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
    matrix[:3, :3] = axes
    matrix[:3, 3] += axes[:, :2] @ point
    if lens is None:
        return replace(camera, world_matrix=matrix, shift=(float(shift[0]), float(shift[1])))
    if camera.projection == "perspective":
        shift = shift - point / (lens.focus * 2.0 * np.tan(0.5 * camera.fov))
    else:
        # Rays are parallel for each point, and meet where they are sharp.
        oblique = lens.focus * axes[:, 2] + axes[:, :2] @ point
        matrix[:3, 2] = oblique / np.linalg.norm(oblique)
    return replace(camera, world_matrix=matrix, shift=(float(shift[0]), float(shift[1])), lens=None)


def _evenly(w: np.ndarray, rays: int) -> np.ndarray:
    """Numbers (E,) in (0, 1) in the order of w (E,) among the rays of each pixel, one in each of as many intervals."""
    rows, columns = np.indices(SHIFTS.shape).reshape(2, -1)
    shift = np.empty(BLOCK**2)
    shift[_places(columns, rows)] = (SHIFTS.ravel() + 0.5) / BLOCK**2
    ranks = w.reshape(-1, rays).argsort(axis=1).argsort(axis=1)
    return ((ranks + shift[:, None]) / rays).ravel()


def _places(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Places int (N,) of pixels in the order of their block: squares of 2 x 2 pixels follow each other."""
    places, bit = np.zeros_like(columns), 1
    while bit < BLOCK:
        places += bit * ((columns & bit) + 2 * (rows & bit))
        bit *= 2
    return places


def _spread(count: int) -> np.ndarray:
    """Points (3, count) in the unit cube: Sobol's sequence, whose runs of 4, 16 and 64 points are evenly spread."""
    bits, number = 30, np.arange(count)
    first = [1] * bits
    second, third = [1], [1, 3]
    for _ in range(bits):
        second.append(second[-1] ^ (second[-1] << 1))
        third.append(third[-2] ^ (third[-2] << 2) ^ (third[-1] << 1))
    points = np.zeros((3, count), np.int64)
    for axis, odd in enumerate((first, second, third)):
        for k in range(count.bit_length()):
            points[axis] ^= np.where(number >> k & 1, odd[k] << (bits - 1 - k), 0)
    # In the middle of the intervals.
    return np.asarray(points / 2.0**bits + 0.5 / (1 << (count - 1).bit_length()))


def _reversed_bits(numbers: np.ndarray, count: int) -> np.ndarray:
    """Numbers (N,) below a count, evenly spread in (0, 1) such that neighbours lie apart."""
    bits = max((count - 1).bit_length(), 1)
    mirrored = np.sum([((numbers >> k) & 1) << (bits - 1 - k) for k in range(bits)], axis=0)
    return (mirrored + 0.5) / (1 << bits)
