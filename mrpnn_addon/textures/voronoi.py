# SPDX-License-Identifier: GPL-3.0-or-later
"""The Voronoi Texture: distances to points, one in each cell of a lattice (Worley, SIGGRAPH 1996).

The distance to edges is Quilez' (iquilezles.org/articles/voronoilines), the smooth distance his smooth minimum.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .hashing import cell_colour, cell_point

MAX_DETAIL = 15.0
FAR = 8.0
# Squared distance of points that are one.
SAME = 1e-4


@dataclass
class Voronoi:
    """Settings of the texture; numbers or (n, 1).

    feature, metric: as of Blender's node. detail: octaves beyond the first; a fraction fades in the last. pcg: whether
    cells are hashed as from Blender 5.0 on.
    """

    feature: str = "F1"
    metric: str = "EUCLIDEAN"
    detail: np.ndarray | float = 0.0
    roughness: np.ndarray | float = 0.5
    lacunarity: np.ndarray | float = 2.0
    smoothness: np.ndarray | float = 1.0
    exponent: np.ndarray | float = 0.5
    randomness: np.ndarray | float = 1.0
    normalize: bool = False
    pcg: bool = False

    def __post_init__(self) -> None:
        self.detail = np.clip(self.detail, 0.0, MAX_DETAIL)
        self.roughness, self.randomness = np.clip(self.roughness, 0.0, 1.0), np.clip(self.randomness, 0.0, 1.0)
        self.smoothness = np.clip(np.asarray(self.smoothness) / 2.0, 0.0, 0.5)

    def cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance (n, 1), colour (n, 3) and position (n, d) of F1, F2 or smooth F1 at points (n, d), d of 1 to 4."""
        feature = {"F1": self._nearest, "F2": self._second, "SMOOTH_F1": self._smooth}[self.feature]
        distance: Any = 0.0
        colour: Any = 0.0
        position: Any = 0.0
        most: Any = 0.0
        for points_here, scale, amplitude, share in self._octaves(points):
            near, tint, place = feature(points_here)
            distance, colour = distance + share * amplitude * near, colour + share * amplitude * tint
            position = position + share * amplitude * (place / scale - position)
            most = most + share * amplitude
        if self.normalize:
            corner = np.broadcast_to(0.5 + 0.5 * self.randomness, (1, 1)) * np.ones(points.shape[1])
            farthest = self._distance(corner) * (2.0 if self.feature == "F2" else 1.0)
            distance, colour = distance / (most * farthest), colour / most
        return distance, colour, position

    def edge(self, points: np.ndarray) -> np.ndarray:
        """Distance (n, 1) to the nearest edge between cells at points (n, d)."""
        farthest = 0.5 + 0.5 * self.randomness
        distance: Any = FAR
        most: Any = farthest
        for number, (points_here, scale, amplitude, share) in enumerate(self._octaves(points)):
            near = self._edge(points_here) / scale
            nearer = distance + amplitude * (np.minimum(distance, near) - distance)
            distance = distance + share * (np.minimum(distance, nearer) - distance) if number else near
            most = most + share * amplitude * (farthest / scale - most)
        return distance / most if self.normalize else distance

    def radius(self, points: np.ndarray) -> np.ndarray:
        """(n, 1) radius of the largest sphere around the nearest point that overlaps no other."""
        cell, local = _split(points)
        nearest = _Best(len(points), points.shape[1])
        for offset in _around(points.shape[1], 1):
            place = self._place(cell, offset)
            nearest.take(_length(place - local), offset, place)
        other = np.full((len(points), 1), np.inf)
        for offset in _around(points.shape[1], 1):
            if any(offset):
                place = self._place(cell, nearest.offset + np.array(offset, np.float32))
                other = np.minimum(other, _length(place - nearest.place))
        return 0.5 * other

    def _octaves(self, points: np.ndarray) -> Iterator[tuple[np.ndarray, Any, Any, Any]]:
        """Yield points, scale, amplitude and the share that counts of each octave."""
        scale: Any = 1.0
        amplitude: Any = 1.0
        single = (self.detail == 0.0) | (self.roughness == 0.0)
        for number in range(int(np.ceil(np.max(np.where(single, 0.0, self.detail)))) + 1):
            share = np.clip(np.where(single, 0.0, self.detail) - number + 1.0, 0.0, 1.0) if number else 1.0
            yield points * scale, scale, amplitude, share
            scale, amplitude = scale * self.lacunarity, amplitude * self.roughness

    def _place(self, cell: np.ndarray, offset: ArrayLike) -> np.ndarray:
        """The point (n, d) of a cell's neighbour, relative to the cell; offset: (d,) or (n, d)."""
        offset = np.asarray(offset, np.float32)
        at = cell + offset
        return offset + cell_point(at, self.pcg) * self.randomness

    def _distance(self, along: np.ndarray) -> np.ndarray:
        """(n, 1) length of vectors (n, d)."""
        along = np.abs(along)
        if self.metric == "EUCLIDEAN" or along.shape[1] == 1:
            return _length(along)
        if self.metric == "MANHATTAN":
            return along.sum(axis=1, keepdims=True)
        if self.metric == "CHEBYCHEV":
            return along.max(axis=1, keepdims=True)
        return (along**self.exponent).sum(axis=1, keepdims=True) ** (1.0 / np.asarray(self.exponent))

    def _nearest(self, points: np.ndarray, second: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cell, local = _split(points)
        best = _Best(len(points), points.shape[1])
        behind = _Best(len(points), points.shape[1])
        for offset in _around(points.shape[1], 1):
            place = self._place(cell, offset)
            distance = self._distance(place - local)
            if second:
                # What is no longer the nearest is the second, unless that was nearer.
                loses = distance < best.distance
                behind.take(
                    np.where(loses, best.distance, distance),
                    np.where(loses, best.offset, np.array(offset, np.float32)),
                    np.where(loses, best.place, place),
                )
            best.take(distance, offset, place)
        found = behind if second else best
        return found.distance, cell_colour(cell + found.offset, self.pcg), found.place + cell

    def _second(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self._nearest(points, second=True)

    def _smooth(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if np.all(self.smoothness == 0.0):
            return self._nearest(points)
        cell, local = _split(points)
        smoothness = np.maximum(self.smoothness, 1e-6)
        distance: Any = 0.0
        colour: Any = 0.0
        position: Any = 0.0
        for number, offset in enumerate(_around(points.shape[1], 2)):
            place = self._place(cell, offset)
            here = self._distance(place - local)
            h = np.clip(0.5 + 0.5 * (distance - here) / smoothness, 0.0, 1.0) if number else 1.0
            h = h * h * (3.0 - 2.0 * h)
            correction = smoothness * h * (1.0 - h)
            distance = distance + h * (here - distance) - correction
            correction = correction / (1.0 + 3.0 * smoothness)
            tint = cell_colour(cell + np.array(offset, np.float32), self.pcg)
            colour = colour + h * (tint - colour) - correction
            position = position + h * (place - position) - correction
        return distance, colour, position + cell

    def _edge(self, points: np.ndarray) -> np.ndarray:
        cell, local = _split(points)
        if points.shape[1] == 1:
            left, middle, right = (self._place(cell, (offset,)) for offset in (-1, 0, 1))
            return np.minimum(np.abs(0.5 * (left + middle) - local), np.abs(0.5 * (middle + right) - local))
        nearest = _Best(*points.shape)
        for offset in _around(points.shape[1], 1):
            to_point = self._place(cell, offset) - local
            nearest.take(_length(to_point), offset, to_point)
        found = np.full((len(points), 1), FAR)
        for offset in _around(points.shape[1], 1):
            to_point = self._place(cell, offset) - local
            across = to_point - nearest.place
            length = _length(across)
            middle = 0.5 * (to_point + nearest.place)
            edge = (middle * across).sum(axis=1, keepdims=True) / np.where(length > 0.0, length, 1.0)
            found = np.where(length**2 > SAME, np.minimum(found, edge), found)
        return found


class _Best:
    """The nearest of several points: distance (n, 1), offset of its cell and place (n, d)."""

    def __init__(self, n: int, d: int) -> None:
        self.distance, self.offset = np.full((n, 1), np.inf), np.zeros((n, d), np.float32)
        self.place = np.zeros((n, d))

    def take(self, distance: np.ndarray, offset: ArrayLike, place: np.ndarray) -> None:
        nearer = distance < self.distance
        self.distance = np.where(nearer, distance, self.distance)
        self.offset = np.where(nearer, np.asarray(offset, np.float32), self.offset)
        self.place = np.where(nearer, place, self.place)


def _split(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lattice cells, and positions within, float32 (n, d)."""
    points = np.asarray(points, np.float32)
    cell = np.floor(points)
    return cell, points - cell


def _around(dimensions: int, reach: int) -> Iterator[tuple[int, ...]]:
    """Offsets (d,) of neighbouring cells, the first axis fastest: the smooth distance depends on the order."""
    for offset in itertools.product(range(-reach, reach + 1), repeat=dimensions):
        yield offset[::-1]


def _length(along: np.ndarray) -> np.ndarray:
    return np.sqrt((along * along).sum(axis=1, keepdims=True))
