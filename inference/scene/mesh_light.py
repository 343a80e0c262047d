# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that shine, as lamps."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .description import Surface
from .emitters import Emitter, QuadEmitter, SphereEmitter
from .lamps import MEDIUM_SIZE, MOST, SMALL, Lamp, distance_from_box

# Sum of the vector areas of a closed mesh over its area, at most.
CLOSED = 1e-3
# Part of a mesh's first moment that tells openings, over its area and extent, at most: it is 0 in a closed mesh, 0.2 in
# a short band, and 0.14 in an open tube 1.5 times as long as wide.
OPENING = 0.13
# Least number of triangles from which patches are made.
LEAST_TRIANGLES = 512
# Number of patches up to which spheres represent a balanced mesh better than patches do.
FEW_PATCHES = 6
# Standard deviation along its longest axis, over the radius of the sphere of its area, from which on a body is not
# compact: 0.58 for a ball, 0.71 for a flat disk.
STRETCHED = 0.7
#: Moments of a patch along its axes that differ by less, relatively, are taken as equal.
ALIKE = 1e-3
# Ratio of the principal moments of a patch below which its own edges tell its orientation.
ROUND = 1.5
# Points on a mesh that tell how much of it hides behind itself, and how many of them a cell of directions holds where
# one layer of the mesh is seen from in front. Points that much deeper than the first of a cell, in widths of the cell,
# are hidden, plus so much on a slope.
SAMPLES, PER_CELL = 1 << 12, 8
DEEPER, DEEPER_ON_SLOPES = 0.5, 1.5
# Least cosine of a sample that counts: of those seen at a flat angle depth tells nothing.
FLAT = 0.05


@dataclass
class MeshLight(Lamp):
    """The light that a surface emits, as a lamp.

    surface: with emission above 0. Open meshes shine on both sides, closed meshes and long tubes outwards. What hides
    behind other parts of the mesh dims all of it alike.
    power: W, float64 (3,). area: of the mesh. centre: (3,), mean of its area. balanced: whether its vector areas add up
    to 0. closed: whether it also encloses what is on its inner side.
    """

    surface: Surface
    name: str = field(init=False)
    power: np.ndarray = field(init=False)
    receivers: frozenset[str] | None = field(init=False)
    area: float = field(init=False)
    balanced: bool = field(init=False)
    closed: bool = field(init=False)
    _shares: dict[bytes, float] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.name, self.receivers = self.surface.name, self.surface.receivers
        vectors = _vector_areas(self.surface.triangles)
        self.area = float(np.linalg.norm(vectors, axis=1).sum())
        self.balanced = bool(np.linalg.norm(vectors.sum(axis=0)) <= CLOSED * self.area)
        self.closed = self.balanced and self._opening(vectors) <= OPENING
        self.power = np.pi * self.area * self._sides * self.surface.emission

    @property
    def body(self) -> Surface:
        """As of Lamp."""
        return self.surface

    @property
    def _sides(self) -> int:
        return 1 if self.closed else 2

    @functools.cached_property
    def centre(self) -> np.ndarray:
        """(3,)."""
        triangles, vectors = self._triangles
        areas = np.linalg.norm(vectors, axis=1)
        return (areas[:, None] * triangles.mean(axis=1)).sum(axis=0) / areas.sum()

    @functools.cached_property
    def extent(self) -> float:
        """Longest edge of its box."""
        return float(np.ptp(self.surface.triangles.reshape(-1, 3), axis=0).max())

    def _opening(self, vectors: np.ndarray) -> float:
        """How far the mesh is open. vectors: (T, 3), vector areas of its triangles, which add up to 0."""
        middles = self.surface.triangles.mean(axis=1)
        # In a closed mesh these integrals of position times normal are the volume times the identity (Gauss).
        moments = (middles - middles.mean(axis=0)).T @ vectors
        open_part = moments - np.trace(moments) / 3.0 * np.eye(3)
        return float(np.linalg.norm(open_part)) / max(self.area * self.extent, 1e-300)

    @functools.cached_property
    def _triangles(self) -> tuple[np.ndarray, np.ndarray]:
        """Small triangles (T, 3, 3), and their vector areas (T, 3): outwards, where the mesh is closed."""
        triangles = self.surface.triangles
        triangles = triangles[np.linalg.norm(_vector_areas(triangles), axis=1) > 0.0]
        while len(triangles) < LEAST_TRIANGLES:
            a, b, c = triangles.swapaxes(0, 1)
            u, v, w = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
            triangles = np.concatenate([np.stack(abc, axis=1) for abc in ((a, u, w), (u, b, v), (w, v, c), (u, v, w))])
        vectors = _vector_areas(triangles)
        # Parts of slivers may have no area.
        kept = np.linalg.norm(vectors, axis=1) > 0.0
        triangles, vectors = triangles[kept], vectors[kept]
        volume = (triangles.mean(axis=1) * vectors).sum()
        return triangles, -vectors if self.closed and volume < 0.0 else vectors

    @functools.cached_property
    def _samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Points (SAMPLES, 3), each of the same area of the mesh, and their unit normals."""
        triangles, vectors = self._triangles
        areas, random = np.linalg.norm(vectors, axis=1), np.random.default_rng(0)
        shares = np.cumsum(areas) / areas.sum()
        found = np.searchsorted(shares, (np.arange(SAMPLES) + 0.5) / SAMPLES).clip(0, len(areas) - 1)
        u, v = random.random((2, SAMPLES))
        over = u + v > 1.0
        u, v = np.where(over, 1.0 - u, u)[:, None], np.where(over, 1.0 - v, v)[:, None]
        a, b, c = triangles[found].swapaxes(0, 1)
        return a + u * (b - a) + v * (c - a), vectors[found] / areas[found, None]

    def _unhidden(self, corners: np.ndarray) -> float:
        """Share of the light towards a box with these corners (8, 3) that no other part of the mesh hides."""
        key = corners.tobytes()
        if key not in self._shares:
            # Gaussian quadrature over the box.
            places = corners.mean(axis=0) + (corners - corners.mean(axis=0)) / np.sqrt(3.0)
            seen, whole = np.sum([self._seen_from(place) for place in places], axis=0)
            self._shares[key] = float(seen / whole) if whole > 0.0 else 1.0
        return self._shares[key]

    def _seen_from(self, place: np.ndarray) -> tuple[float, float]:
        """Light that a place (3,) gets of the samples before which it sees no other, and of all that face it."""
        points, normals = self._samples
        away = place - points
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9 * self.extent)
        directions = away / distance[:, None]
        cosines = (directions * normals).sum(axis=1)
        cosines = cosines if self.closed else np.abs(cosines)
        width = max(float(np.sqrt(PER_CELL * self.area / SAMPLES) / np.median(distance)), 1e-5)
        x, y, z = np.floor((1.0 + directions) / width).astype(np.int64).T
        count = int(2.0 / width) + 2
        _, cells = np.unique((x * count + y) * count + z, return_inverse=True)
        first = np.full(len(points), np.inf)
        np.minimum.at(first, cells, distance)
        facing = cosines > FLAT
        cosines, distance = cosines[facing], distance[facing]
        slope = np.sqrt(np.maximum(1.0 - cosines**2, 0.0)) / cosines
        deeper = width * distance * (DEEPER + DEEPER_ON_SLOPES * slope)
        light = cosines / distance**2
        return float(light[distance <= first[cells][facing] + deeper].sum()), float(light.sum())

    def emitters(self, low: np.ndarray, high: np.ndarray, most: int = MOST) -> Sequence[Emitter]:
        """As of PointLight. A single one is rough, and as bright as if no part of the mesh hid another."""
        corners = np.array(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij")).reshape(3, -1).T
        share = self._unhidden(corners) if most > 1 else 1.0
        return [emitter.dimmed(share) for emitter in self._all_emitters(low, high, corners, most)]

    def _all_emitters(
        self, low: np.ndarray, high: np.ndarray, corners: np.ndarray, most: int
    ) -> Sequence[SphereEmitter | QuadEmitter]:
        """As if no part of the mesh hid another."""
        apart = self.extent / max(distance_from_box(self.centre, low, high), 1e-6 * self.extent)
        count = min(1 if apart < SMALL else 4 if apart < MEDIUM_SIZE else MOST, most)
        if self.balanced and count <= FEW_PATCHES:
            return self._spheres(count)
        for patches in (count, max(count // 2, 1)):
            sided = [
                (patch, normal)
                for patch, vector in self._patches(patches)
                for normal in ((vector, -vector) if self._sides == 2 else (vector,))
                if ((corners - patch.mean(axis=0)) @ normal).max() > 0.0
            ]
            if len(sided) <= count:
                break
        if not sided:
            # No patch faces the box.
            return [SphereEmitter(self.centre, self.centre, 0.0, 0.0)]
        flat = sum(float(np.linalg.norm(vector)) for _, vector in self._patches(patches))
        radiance = 1.0 / (np.pi * flat * self._sides)
        return [QuadEmitter(patch, normal / np.linalg.norm(normal), radiance) for patch, normal in sided]

    def _spheres(self, count: int) -> list[SphereEmitter]:
        """At most `count` spheres that represent a balanced mesh: one for a compact body, more along a ring."""
        triangles, vectors = self._triangles
        middles, areas = triangles.mean(axis=1), np.linalg.norm(vectors, axis=1)
        groups = [np.arange(len(triangles))]
        spheres: list[SphereEmitter] = []
        while groups:
            group = groups.pop(0)
            moment, axis, mean = _principal_moment(middles[group], areas[group])
            area = float(areas[group].sum())
            # A convex body shines as a sphere of its area does, on the average.
            radius = float(np.sqrt(area / (4.0 * np.pi)))
            upper = middles[group] @ axis > mean @ axis
            compact = moment <= area * (STRETCHED * radius) ** 2
            if compact or upper.all() or not upper.any() or len(spheres) + len(groups) + 2 > count:
                spheres.append(SphereEmitter(mean, mean, radius, area / self.area))
            else:
                groups += [group[upper], group[~upper]]
        return spheres

    def _patches(self, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Quadrilaterals (4, 3) of at most `count` patches of the mesh, and their vector areas (3,)."""
        triangles, vectors = self._triangles
        middles, areas = triangles.mean(axis=1), np.linalg.norm(vectors, axis=1)
        # Patches are near each other and look the same way.
        points = np.concatenate([middles, 0.5 * self.extent * vectors / areas[:, None]], axis=1)
        groups = [np.arange(len(triangles))]
        while len(groups) < count:
            moments = [_principal_moment(points[group], areas[group]) for group in groups]
            widest = int(np.argmax([moment for moment, _, _ in moments]))
            _, axis, mean = moments[widest]
            group = groups[widest]
            upper = points[group] @ axis > mean @ axis
            if upper.all() or not upper.any():
                break
            groups[widest : widest + 1] = [group[upper], group[~upper]]
        patches = [(group, vectors[group].sum(axis=0)) for group in groups]
        return [
            (_quadrilateral(triangles[group], areas[group], vector), vector)
            for group, vector in patches
            if np.linalg.norm(vector) > 1e-9 * self.area
        ]


def _vector_areas(triangles: np.ndarray) -> np.ndarray:
    """Normals of triangles (T, 3, 3) times their areas, (T, 3)."""
    return 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def _principal_moment(points: np.ndarray, areas: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Second moment of points (N, D) along their principal axis, weighted by areas (N,); that axis and their mean."""
    mean = (areas[:, None] * points).sum(axis=0) / areas.sum()
    away = points - mean
    values, axes = np.linalg.eigh((away * areas[:, None]).T @ away)
    # A ball has equal moments along several axes, between which rounding must not decide.
    alike = axes[:, values > (1.0 - ALIKE) * values[-1]]
    axis = alike @ (alike.T @ 0.5 ** np.arange(len(axes)))
    size = np.linalg.norm(axis)
    return float(values[-1]), axis / size if size > 0.0 else axes[:, -1], mean


def _quadrilateral(triangles: np.ndarray, areas: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A rectangle (4, 3) across a vector area (3,), of its size, with the proportions of triangles (T, 3, 3)."""
    size = float(np.linalg.norm(vector))
    normal, weight = vector / size, areas / areas.sum()
    middle = weight @ triangles.mean(axis=1)
    corners = triangles - middle
    # Second moments of triangles: those of their corners, and nine times those of their middles.
    both = np.concatenate([corners, 3.0 * corners.mean(axis=1, keepdims=True)], axis=1)
    moment = np.einsum("t,tci,tcj->ij", weight, both, both) / 12.0
    edge = triangles[0, 1] - triangles[0, 0]
    first = edge - (edge @ normal) * normal
    first /= max(float(np.linalg.norm(first)), 1e-30)
    frame = np.stack([first, np.cross(normal, first)])
    values, axes = np.linalg.eigh(frame @ moment @ frame.T)
    if values[1] > ROUND * values[0]:
        frame = axes[:, ::-1].T @ frame
    else:
        values = np.ones(2)
    ratio = float(np.sqrt(values[1] / max(values[0], 1e-12 * values[1])))
    x, y = frame[0] * np.sqrt(size * ratio) / 2.0, frame[1] * np.sqrt(size / ratio) / 2.0
    return middle + np.array([-x - y, x - y, x + y, y - x])
