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
# Triangles, at least, of which patches are made.
PARTS = 512
# Number of patches up to which a sphere stands for a closed mesh better than they do.
FEW_PATCHES = 6
# Standard deviation along its longest axis, over the radius of the sphere of its area, from which on a body is not
# compact: 0.58 for a ball, 0.71 for a flat disk.
STRETCHED = 0.7
#: Moments of a patch along its axes that differ by less, relatively, are taken as equal.
ALIKE = 1e-3
# Ratio of the principal moments of a patch below which its own edges tell its orientation.
ROUND = 1.5


@dataclass
class MeshLight(Lamp):
    """The light that a surface emits, as a lamp.

    surface: whose emission is not 0. Open meshes shine on both sides, closed ones outwards, as if they were convex.
    power: W, float64 (3,). area: of the mesh. centre: (3,), mean of its area. closed: whether the mesh is.
    """

    surface: Surface
    name: str = field(init=False)
    power: np.ndarray = field(init=False)
    receivers: frozenset[str] | None = field(init=False)
    area: float = field(init=False)
    closed: bool = field(init=False)

    def __post_init__(self) -> None:
        self.name, self.receivers = self.surface.name, self.surface.receivers
        vectors = _vector_areas(self.surface.triangles)
        self.area = float(np.linalg.norm(vectors, axis=1).sum())
        self.closed = bool(np.linalg.norm(vectors.sum(axis=0)) <= CLOSED * self.area)
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
        parts, vectors = self._parts
        areas = np.linalg.norm(vectors, axis=1)
        return areas @ parts.mean(axis=1) / areas.sum()

    @functools.cached_property
    def extent(self) -> float:
        """Longest edge of its box."""
        return float(np.ptp(self.surface.triangles.reshape(-1, 3), axis=0).max())

    @functools.cached_property
    def _parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Small triangles (T, 3, 3), and their vector areas (T, 3): outwards, where the mesh is closed."""
        parts = self.surface.triangles
        parts = parts[np.linalg.norm(_vector_areas(parts), axis=1) > 0.0]
        while len(parts) < PARTS:
            a, b, c = parts.swapaxes(0, 1)
            u, v, w = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
            parts = np.concatenate([np.stack(one, axis=1) for one in ((a, u, w), (u, b, v), (w, v, c), (u, v, w))])
        vectors = _vector_areas(parts)
        volume = (parts.mean(axis=1) * vectors).sum()
        return parts, -vectors if self.closed and volume < 0.0 else vectors

    def emitters(self, low: np.ndarray, high: np.ndarray, most: int = MOST) -> Sequence[Emitter]:
        """As of PointLight."""
        apart = self.extent / max(distance_from_box(self.centre, low, high), 1e-6 * self.extent)
        count = min(1 if apart < SMALL else 4 if apart < MEDIUM_SIZE else MOST, most)
        if self.closed and count <= FEW_PATCHES:
            return self._spheres(count)
        corners = np.array(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij")).reshape(3, -1).T
        for parts in (count, max(count // 2, 1)):
            sided = [
                (patch, normal)
                for patch, vector in self._patches(parts)
                for normal in ((vector, -vector) if self._sides == 2 else (vector,))
                if ((corners - patch.mean(axis=0)) @ normal).max() > 0.0
            ]
            if len(sided) <= count:
                break
        flat = sum(float(np.linalg.norm(vector)) for _, vector in self._patches(parts))
        radiance = 1.0 / (np.pi * flat * self._sides)
        found = [QuadEmitter(patch, normal / np.linalg.norm(normal), radiance) for patch, normal in sided]
        # It faces nothing.
        return found or [SphereEmitter(self.centre, self.centre, 0.0, 0.0)]

    def _spheres(self, count: int) -> list[SphereEmitter]:
        """At most so many spheres that stand for a closed mesh: one for a compact body, more along a ring or a tube."""
        parts, vectors = self._parts
        middles, areas = parts.mean(axis=1), np.linalg.norm(vectors, axis=1)
        groups = [np.arange(len(parts))]
        found: list[SphereEmitter] = []
        while groups:
            group = groups.pop(0)
            spread, axis, mean = _spread(middles[group], areas[group])
            area = float(areas[group].sum())
            # A convex body shines as a sphere of its area does, on the average.
            radius = float(np.sqrt(area / (4.0 * np.pi)))
            upper = middles[group] @ axis > mean @ axis
            compact = spread <= area * (STRETCHED * radius) ** 2
            if compact or upper.all() or not upper.any() or len(found) + len(groups) + 2 > count:
                found.append(SphereEmitter(mean, mean, radius, area / self.area))
            else:
                groups += [group[upper], group[~upper]]
        return found

    def _patches(self, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Quadrilaterals (4, 3) of at most so many patches of the mesh, and their vector areas (3,)."""
        parts, vectors = self._parts
        middles, areas = parts.mean(axis=1), np.linalg.norm(vectors, axis=1)
        # Patches are near each other and look the same way.
        place = np.concatenate([middles, 0.5 * self.extent * vectors / areas[:, None]], axis=1)
        groups = [np.arange(len(parts))]
        while len(groups) < count:
            spreads = [_spread(place[group], areas[group]) for group in groups]
            widest = int(np.argmax([spread for spread, _, _ in spreads]))
            _, axis, mean = spreads[widest]
            group = groups[widest]
            upper = place[group] @ axis > mean @ axis
            if upper.all() or not upper.any():
                break
            groups[widest : widest + 1] = [group[upper], group[~upper]]
        found = [(group, vectors[group].sum(axis=0)) for group in groups]
        return [
            (_quadrilateral(parts[group], areas[group], vector), vector)
            for group, vector in found
            if np.linalg.norm(vector) > 1e-9 * self.area
        ]


def _vector_areas(triangles: np.ndarray) -> np.ndarray:
    """Normals of triangles (T, 3, 3) times their areas, (T, 3)."""
    return 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def _spread(place: np.ndarray, areas: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Moment of points (N, D) along their principal axis, that axis and their mean."""
    mean = areas @ place / areas.sum()
    away = place - mean
    values, axes = np.linalg.eigh((away * areas[:, None]).T @ away)
    # Bodies like a ball spread alike along several axes, between which rounding must not decide.
    alike = axes[:, values > (1.0 - ALIKE) * values[-1]]
    axis = alike @ (alike.T @ 0.5 ** np.arange(len(axes)))
    size = np.linalg.norm(axis)
    return float(values[-1]), axis / size if size > 0.0 else axes[:, -1], mean


def _quadrilateral(parts: np.ndarray, areas: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A rectangle (4, 3) across a vector area, of its size, and as long and wide as triangles (T, 3, 3)."""
    size = float(np.linalg.norm(vector))
    normal, weight = vector / size, areas / areas.sum()
    middle = weight @ parts.mean(axis=1)
    corners = parts - middle
    # Second moments of triangles: of their corners, and nine times of their middles.
    both = np.concatenate([corners, 3.0 * corners.mean(axis=1, keepdims=True)], axis=1)
    moment = np.einsum("t,tci,tcj->ij", weight, both, both) / 12.0
    edge = parts[0, 1] - parts[0, 0]
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
