# SPDX-License-Identifier: GPL-3.0-or-later
"""Emitters: parts of lamps, and the light that points receive from them.

Emitters are so small that each has one direction and one shadow. An emitter's fluence at a point, W/m^2, is its
radiance times the solid angle that the point sees of it, without attenuation. Far from a lamp that is the irradiance of
a surface that faces it. Emitters are of lamps of power 1: the light of a lamp is linear in its power.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..numerics.quadrature import GOLDEN_ANGLE, even_directions
from ..numerics.small_matmul import product
from .spot_cone import SpotCone

# Distance over the longest edge of a flat emitter from which its solid angle is a quadrature of two nodes along each
# edge, with an error of up to 5e-4; nearer, it is exact.
FAR = 4.0
# Square of the smallest distance, over the largest size of a coordinate: nearer, rounding decides.
CLOSEST = 1e-12
# Radius of the disk as which a part of a sphere shines into a cone, over the sphere's; and how much nearer to its
# centre it lies than the part, so that all disks have the variance of the whole. The kernel holds the latter, too.
PART = 0.5
DRAWN_IN = np.sqrt(1.0 - PART**2)
# Angle of a spread from which on light leaves an area light as from a diffuse surface.
FULL_SPREAD = np.pi - 1e-4
# Directions in an elliptic cone whose light adds up to its power.
CONE_NODES = 4096


def light_start(along: np.ndarray, apart: float, radius: float, soft_falloff: bool) -> np.ndarray:
    """Distances (N,) before a sphere's centre, towards distant points, at which light starts.

    along: (N,), distances before the centre of the point that the light seems to come from. apart: distance of that
    point from the centre.
    """
    across = np.maximum(apart**2 - along**2, 0.0)
    return np.zeros_like(along) if soft_falloff else np.sqrt(np.maximum(radius**2 - across, 0.0))


@dataclass(frozen=True)
class LampSource:
    """Where the light of an emitter starts: at a point, which represents a sphere if it has a radius.

    position: (3,), of the point. centre: (3,), of the sphere. radius, soft_falloff: as of PointLight.
    """

    position: np.ndarray
    centre: np.ndarray
    radius: float = 0.0
    soft_falloff: bool = False


@dataclass(frozen=True)
class SphereEmitter:
    """A part of a sphere, or a point, that shines alike in all directions, or in a cone.

    centre: (3,) of the sphere. position: (3,) from which its light seems to come. radius: of the sphere. share: of the
    lamp's power. cone: into which it shines, or None. soft_falloff: as in PointLight.
    """

    centre: np.ndarray
    position: np.ndarray
    radius: float
    share: float = 1.0
    cone: SpotCone | None = None
    soft_falloff: bool = False

    @property
    def source(self) -> LampSource:
        """Where its light starts."""
        return LampSource(self.position, self.centre, self.radius, self.soft_falloff)

    @property
    def extent(self) -> float:
        """Distance below which the inverse square no longer holds."""
        return self.radius

    def dimmed(self, factor: float) -> "SphereEmitter":
        """This emitter with a factor of its light."""
        return replace(self, share=factor * self.share)

    def is_point_within(self, radius: float) -> bool:
        """Whether its light grows as the inverse square of the distance down to a radius."""
        return self.radius <= radius

    @property
    def power(self) -> float:
        """Power that it emits of a lamp of power 1: within the cone alone, if there is one."""
        if self.cone is None:
            return self.share
        if self.cone.frame is not None:
            directions = _cap(self.cone.axis, self.cone.bound, CONE_NODES)
            share = 0.5 * (1.0 - self.cone.bound)
            return self.share * share * float(self.cone.passed(directions, np.zeros(CONE_NODES)).mean())
        cosine = np.linspace(-1.0, 1.0, 2001)
        directions = cosine[:, None] * self.cone.axis + np.sqrt(1.0 - cosine**2)[:, None] * _across(self.cone.axis)
        return self.share * float(self.cone.passed(directions, np.zeros(len(cosine))).mean())

    def directions(self, count: int) -> np.ndarray:
        """Unit vectors float64 (count, 3), spread evenly over all into which it shines."""
        if self.cone is None:
            return even_directions(count)
        return _cap(self.cone.axis, self.cone.bound, count)

    def fluence(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) at world points (N, 3)."""
        return self.brightest(points) * self._within_cone(points)

    def brightest(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) at world points (N, 3) if the emitter faced each point."""
        away = points - self.centre
        square = np.maximum((away**2).sum(axis=1), CLOSEST * np.abs(self.centre).max(initial=1e-3) ** 2)
        intensity = self.share / (4.0 * np.pi)
        if self.soft_falloff:
            # 2 pi L (1 - cos a) for the disk, with tan a = radius / distance.
            slant = square + self.radius**2
            return 2.0 * intensity / (slant + np.sqrt(square * slant))
        # 2 pi L (1 - cos a) for a sphere of radiance L that appears under the angle a, and 4 pi L within it.
        sine = np.minimum(self.radius**2 / square, 1.0)
        outside = 2.0 * intensity / (square * (1.0 + np.sqrt(1.0 - sine)))
        return np.where(square > self.radius**2, outside, 4.0 * intensity / max(self.radius, 1e-30) ** 2)

    def _within_cone(self, points: np.ndarray) -> np.ndarray | float:
        """Fraction (N,) of its light at points (N, 3) that the cone lets pass."""
        if self.cone is None:
            return 1.0
        away, offset = points - self.centre, DRAWN_IN * (self.position - self.centre)
        square = np.maximum((away**2).sum(axis=1), 1e-60)
        # Cycles has no cone within a sphere.
        within = square <= (0.0 if self.soft_falloff else self.radius**2)
        distance, radius = np.sqrt(square), np.full(len(points), self.radius)
        if offset.any():
            # An emitter is a disk, which nearby points see as the whole sphere; light starts on the disk, or the side
            # of the sphere, that faces the point.
            near = square / (square + self.radius**2)
            radius = self.radius * np.sqrt(1.0 - (DRAWN_IN * near) ** 2)
            along, apart = near * (away @ offset) / distance, near * np.linalg.norm(offset)
            start = light_start(along, apart, self.radius, self.soft_falloff)
            away = away * (1.0 - (start - along) / distance)[:, None] - near[:, None] * offset
            distance = np.maximum(np.linalg.norm(away, axis=1), 1e-30)
        return np.where(within, 1.0, self.cone.passed(away / distance[:, None], radius / distance))

    def lit_between(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) between which it may light rays of origins and unit directions (N, 3)."""
        if self.cone is None:
            return _everywhere(len(origins))
        return self.cone.between(self.centre, self.radius, origins, directions)


@dataclass(frozen=True)
class QuadEmitter:
    """A flat quadrilateral that shines to one side.

    corners: (4, 3), in order around it. normal: (3,) unit vector, the side that shines. radiance: along the normal,
    W/(m^2 sr). spread: as in AreaLight.
    """

    corners: np.ndarray
    normal: np.ndarray
    radiance: float
    spread: float = np.pi
    #: It shines into no cone.
    cone: ClassVar[None] = None

    @property
    def position(self) -> np.ndarray:
        """Its centre (3,)."""
        return self.corners.mean(axis=0)

    @property
    def source(self) -> LampSource:
        """Its centre, where its light starts."""
        return LampSource(self.position, self.position)

    def dimmed(self, factor: float) -> "QuadEmitter":
        """As for SphereEmitter."""
        return replace(self, radiance=factor * self.radiance)

    def is_point_within(self, radius: float) -> bool:
        """As for SphereEmitter."""
        return False

    @property
    def power(self) -> float:
        """As for SphereEmitter, without a limited spread."""
        return float(np.pi * self.radiance * self.area)

    @property
    def area(self) -> float:
        """Of the quadrilateral."""
        first, second = self.corners[2] - self.corners[0], self.corners[3] - self.corners[1]
        return 0.5 * float(np.linalg.norm(np.cross(first, second)))

    @property
    def extent(self) -> float:
        """Distance below which the inverse square no longer holds."""
        return float(np.sqrt(self.area / np.pi))

    @property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Points (4, 3) of the quadrature over its surface, and the area (4,) that each represents."""
        a, b, c, d = self.corners
        u, v = (0.5 + np.array([[-1, 1, -1, 1], [-1, -1, 1, 1]]) / np.sqrt(12.0))[..., None]
        along, across = (1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)
        return (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c), np.cross(along, across) @ self.facing / 4.0

    @property
    def facing(self) -> np.ndarray:
        """Unit vector (3,) around which the corners turn to the left: the normal, or its opposite."""
        across = np.cross(self.corners[2] - self.corners[0], self.corners[3] - self.corners[1])
        return across / np.linalg.norm(across)

    @property
    def far(self) -> float:
        """Square of the distance from its centre from which on the quadrature is used."""
        edges = self.corners - np.roll(self.corners, 1, axis=0)
        return float(FAR**2 * (edges**2).sum(axis=1).max())

    def directions(self, count: int) -> np.ndarray:
        """As for SphereEmitter."""
        return _cap(self.normal, np.cos(0.5 * min(self.spread, np.pi)), count)

    def fluence(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) at world points (N, 3)."""
        away = points - self.position
        square, rise, angle = (away**2).sum(axis=1), product(away, self.normal), np.zeros(len(points))
        for node, area in zip(*self.nodes):
            angle += area / np.maximum(((points - node) ** 2).sum(axis=1), 1e-60) ** 1.5
        angle *= np.maximum(rise, 0.0)
        near = np.flatnonzero((rise > 0.0) & (square < self.far))
        angle[near] = _solid_angle(self.corners - points[near, None])
        return self.radiance * angle * self._spread_factor(points)

    def brightest(self, points: np.ndarray) -> np.ndarray:
        """Approximate fluence float64 (N,) at world points (N, 3) if the emitter faced each point."""
        square = ((points - self.position) ** 2).sum(axis=1)
        focus = 1.0 if self.spread >= FULL_SPREAD else float(_spread_factor(np.ones(1), self.spread)[0])
        return self.radiance * focus * self.area / (square + self.extent**2)

    def lit_between(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As for SphereEmitter."""
        return _everywhere(len(origins))

    def _spread_factor(self, points: np.ndarray) -> np.ndarray | float:
        """Mean radiance (N,) towards points over that of a light without a limited spread."""
        if self.spread >= FULL_SPREAD:
            return 1.0
        ends, total = np.array([1.0, 3.0, 5.0]) / 6.0, np.zeros(len(points))
        a, b, c, d = self.corners
        for u in ends:
            for v in ends:
                away = points - ((1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c))
                length = np.maximum(np.linalg.norm(away, axis=1), 1e-30)
                total += _spread_factor(product(away, self.normal) / length, self.spread)
        return total / 9.0


Emitter = SphereEmitter | QuadEmitter


def _across(axis: np.ndarray) -> np.ndarray:
    """A unit vector (3,) perpendicular to another."""
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    return across / np.linalg.norm(across)


def _cap(axis: np.ndarray, cosine: float, count: int) -> np.ndarray:
    """Unit vectors (count, 3), spread evenly over the directions whose cosine with a unit vector is above `cosine`."""
    number = (np.arange(count) + 0.5) / count
    rise, turn = cosine + (1.0 - cosine) * number, np.arange(count) * GOLDEN_ANGLE
    across = _across(axis)
    around = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(axis, across)
    return rise[:, None] * axis + np.sqrt(1.0 - rise**2)[:, None] * around


def _everywhere(rays: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full(rays, -np.inf), np.full(rays, np.inf)


def _solid_angle(corners: np.ndarray) -> np.ndarray:
    """Solid angles (N,) of quadrilaterals seen from the origin; corners: (N, 4, 3)."""
    return solid_angles(corners[:, :3]) + solid_angles(corners[:, [0, 2, 3]])


def solid_angles(triangles: np.ndarray) -> np.ndarray:
    """Solid angles (N,) of triangles (N, 3, 3) seen from the origin, after Van Oosterom (1983)."""
    (a, b, c), (x, y, z) = triangles.swapaxes(0, 1), np.linalg.norm(triangles, axis=2).T
    volume = np.abs((np.cross(a, b) * c).sum(axis=1))
    dots = x * y * z + (a * b).sum(axis=1) * z + (a * c).sum(axis=1) * y + (b * c).sum(axis=1) * x
    return 2.0 * np.arctan2(volume, dots)


def _spread_factor(cosine: np.ndarray, spread: float) -> np.ndarray:
    """Radiance (N,) of an area light of limited spread over that of a diffuse light; cosine: (N,) to its normal."""
    half = max(0.5 * spread, 1e-4)
    tangent = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0)) / np.maximum(cosine, 1e-9)
    return np.where(cosine > 0.0, np.maximum(np.tan(half) - tangent, 0.0) / (np.tan(half) - half), 0.0)
