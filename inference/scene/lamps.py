# SPDX-License-Identifier: GPL-3.0-or-later
"""Point, spot and area lights, and the light that points receive from them.

A lamp is divided into emitters: parts so small that one direction and one shadow stand for each. What an emitter gives
to a point is its fluence, W/m^2: its radiance times the solid angle that the point sees of it, without what stands in
between. Far from a lamp that is the irradiance of a surface that faces it. All emitters are those of power 1: the light
of a lamp is linear in its power.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .description import MAX_IRRADIANCE
from .errors import SceneError
from .spot_cone import SpotCone
from .validation import affine_matrix, rgb_triple

#: Shapes of area lights.
SHAPES = ("square", "rectangle", "disk", "ellipse")
# Size of a lamp, over its distance to what it lights, up to which it has a single emitter; and up to which a flat one
# has four and nine.
SMALL, MEDIUM_SIZE, LARGE = 0.1, 0.35, 1.0
# Largest number of emitters of a lamp.
MOST = 16
# Radius of a sphere, over the longest edge of the box that it lights, up to which it has one emitter where few serve.
TOLD_APART = 0.025
# Distance over the longest edge of a flat emitter from which its solid angle is a quadrature of two nodes along each
# edge, with an error of up to 5e-4; nearer, it is exact.
FAR = 4.0
# Square of the smallest distance, over the largest size of a coordinate: nearer, rounding decides.
CLOSEST = 1e-12
# Centres of emitters that represent a sphere, over its radius: vertices of an octahedron whose variance along any axis
# is that of the disk as which the sphere appears.
OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)]) * np.sqrt(0.75)
# Radius of the disk as which a part of a sphere shines into a cone, over the sphere's; and how much nearer to its
# centre it lies than the part, so that all disks have the variance of the whole. The kernel holds these, too.
PART = 0.5
DRAWN_IN = np.sqrt(1.0 - PART**2)
# Angle of a spread from which on light leaves an area light as from a diffuse surface.
FULL_SPREAD = np.pi - 1e-4


def light_start(along: np.ndarray, apart: float, radius: float, soft_falloff: bool) -> np.ndarray:
    """How far before a sphere's centre, towards a distant place, light starts that seems to come from some point.

    along: how far before it that point lies. apart: its distance from the centre.
    """
    across = np.maximum(apart**2 - along**2, 0.0)
    return np.zeros_like(along) if soft_falloff else np.sqrt(np.maximum(radius**2 - across, 0.0))


@dataclass(frozen=True)
class LampSource:
    """Where the light of a part of a lamp starts: at a point, which stands for a sphere if it has a radius.

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

    def fluence(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) at world points (N, 3)."""
        return self.brightest(points) * self._within_cone(points)

    def brightest(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) at world points (N, 3) if the emitter faced each of them."""
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
        """Share (N,) of its light at points (N, 3) that the cone lets pass."""
        if self.cone is None:
            return 1.0
        away, offset = points - self.centre, DRAWN_IN * (self.position - self.centre)
        square = np.maximum((away**2).sum(axis=1), 1e-60)
        # Cycles has no cone within a sphere.
        within = square <= (0.0 if self.soft_falloff else self.radius**2)
        distance, radius = np.sqrt(square), np.full(len(points), self.radius)
        if offset.any():
            # A part is a disk, of which nearby points see the whole; towards points the light starts on the disk, or
            # the side of the sphere, that faces these.
            near = square / (square + self.radius**2)
            radius = self.radius * np.sqrt(1.0 - (DRAWN_IN * near) ** 2)
            along, apart = near * (away @ offset) / distance, near * np.linalg.norm(offset)
            start = light_start(along, apart, self.radius, self.soft_falloff)
            away = away * (1.0 - (start - along) / distance)[:, None] - near[:, None] * offset
            distance = np.maximum(np.linalg.norm(away, axis=1), 1e-30)
        return np.where(within, 1.0, self.cone.passed(away / distance[:, None], radius / distance))

    def light_directions(self, points: np.ndarray) -> np.ndarray:
        """Unit vectors (N, 3) along which its light arrives at points (N, 3): within a cone, also close to a disk."""
        directions = _unit(points - self.position)
        return directions if self.cone is None else self.cone.turned(directions)

    def lit_between(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) along rays, of origins and unit directions (N, 3), between which it may light them."""
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

    @property
    def position(self) -> np.ndarray:
        """Its centre (3,)."""
        return self.corners.mean(axis=0)

    @property
    def source(self) -> LampSource:
        """Its centre, in which its light is taken to start."""
        return LampSource(self.position, self.position)

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
        """Points (4, 3) of the quadrature over its surface, and the area (4,) that each stands for."""
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

    def fluence(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) at world points (N, 3)."""
        away = points - self.position
        square, rise, angle = (away**2).sum(axis=1), away @ self.normal, np.zeros(len(points))
        for node, area in zip(*self.nodes):
            angle += area / np.maximum(((points - node) ** 2).sum(axis=1), 1e-60) ** 1.5
        angle *= np.maximum(rise, 0.0)
        near = np.flatnonzero((rise > 0.0) & (square < self.far))
        angle[near] = _solid_angle(self.corners - points[near, None])
        return self.radiance * angle * self._spread_factor(points)

    def brightest(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) at world points (N, 3) if the emitter faced each of them, about."""
        square = ((points - self.position) ** 2).sum(axis=1)
        focus = 1.0 if self.spread >= FULL_SPREAD else float(_spread_factor(np.ones(1), self.spread)[0])
        return self.radiance * focus * self.area / (square + self.extent**2)

    def light_directions(self, points: np.ndarray) -> np.ndarray:
        """As for SphereEmitter."""
        return _unit(points - self.position)

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
                total += _spread_factor(away @ self.normal / length, self.spread)
        return total / 9.0


Emitter = SphereEmitter | QuadEmitter


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-30)[:, None]


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
    """Radiance of an area light of limited spread over that of a diffuse one; cosine: (N,) to its normal."""
    half = max(0.5 * spread, 1e-4)
    tangent = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0)) / np.maximum(cosine, 1e-9)
    return np.where(cosine > 0.0, np.maximum(np.tan(half) - tangent, 0.0) / (np.tan(half) - half), 0.0)


@dataclass
class PointLight:
    """A sphere, or a point, that shines alike in all directions.

    position: (3,) world. power: W, scalar or RGB, in [0, 1e30]; float64 (3,) once made. The radiant intensity is
    power / (4 pi), W/sr. radius: world units. name: for messages. soft_falloff: whether the light is, in place of the
    sphere, a disk of that radius that faces whatever it lights, whose light grows steadily within the radius, too.
    receivers: as of Sun.

    Raises SceneError for values that are negative or not finite.
    """

    position: np.ndarray
    power: np.ndarray
    radius: float = 0.0
    name: str = "point light"
    soft_falloff: bool = False
    receivers: frozenset[str] | None = None

    def __post_init__(self) -> None:
        self.position = _vector(self.position, f"{self.name}: position")
        self.power = _power(self.power, self.name)
        self.radius = _not_negative(self.radius, f"{self.name}: radius")

    @property
    def centre(self) -> np.ndarray:
        """(3,)."""
        return self.position

    def emitters(self, low: np.ndarray, high: np.ndarray, most: int = MOST) -> Sequence[Emitter]:
        """The parts, up to `most`, into which it is divided to light the world's box from low (3,) to high (3,)."""
        whole = SphereEmitter(self.position, self.position, self.radius, soft_falloff=self.soft_falloff)
        return _sphere_emitters(whole, low, high, most)


@dataclass
class SpotLight:
    """A sphere, or a point, that shines into a cone.

    position: (3,) world. direction: (3,), the way the light travels; normalised here. power: W, scalar or RGB, in
    [0, 1e30]; float64 (3,) once made. The radiant intensity within the cone is power / (4 pi), W/sr, however wide it
    is. angle: full angle of the cone in radians, in (0, pi]. blend: part of the cone, in [0, 1], over which the light
    fades towards its edge, as smoothstep of the cosine. radius: world units. name: for messages. soft_falloff,
    receivers: as in PointLight.

    Raises SceneError outside these ranges and for values that are not finite.
    """

    position: np.ndarray
    direction: np.ndarray
    power: np.ndarray
    angle: float
    blend: float = 0.0
    radius: float = 0.0
    name: str = "spot light"
    soft_falloff: bool = False
    receivers: frozenset[str] | None = None

    def __post_init__(self) -> None:
        self.position = _vector(self.position, f"{self.name}: position")
        direction = _vector(self.direction, f"{self.name}: direction")
        if not direction.any():
            raise SceneError(f"{self.name}: direction must not be zero")
        self.direction = direction / np.linalg.norm(direction)
        self.power = _power(self.power, self.name)
        self.angle = _not_negative(self.angle, f"{self.name}: angle")
        if not 0.0 < self.angle <= np.pi + 1e-6:
            raise SceneError(f"{self.name}: angle must be above 0 and at most pi, not {self.angle:g}")
        self.blend = _not_negative(self.blend, f"{self.name}: blend")
        if self.blend > 1.0:
            raise SceneError(f"{self.name}: blend must lie between 0 and 1, not {self.blend:g}")
        self.radius = _not_negative(self.radius, f"{self.name}: radius")

    @property
    def centre(self) -> np.ndarray:
        """(3,)."""
        return self.position

    def emitters(self, low: np.ndarray, high: np.ndarray, most: int = MOST) -> Sequence[Emitter]:
        """As for PointLight."""
        cone = SpotCone(self.direction, float(np.cos(0.5 * self.angle)), self.blend)
        whole = SphereEmitter(self.position, self.position, self.radius, 1.0, cone, self.soft_falloff)
        return _sphere_emitters(whole, low, high, most)


@dataclass
class AreaLight:
    """A flat light that shines to one side, along its -Z.

    world_matrix: (4, 4), from the lamp's frame. shape: one of SHAPES. size: full width before the matrix, one number or
    (x, y). power: W, scalar or RGB, in [0, 1e30]; float64 (3,) once made. The radiance is power / (pi area). spread: in
    [0, pi], angle beyond which no light leaves, focused by which the radiance at the angle a from the axis is larger by
    (tan(spread / 2) - tan(a)) / (tan(spread / 2) - spread / 2). name: for messages. receivers: as of Sun.

    Raises SceneError outside these ranges, for values that are not finite and for a lamp without area.
    """

    world_matrix: np.ndarray
    shape: str
    size: float | tuple[float, float]
    power: np.ndarray
    spread: float = np.pi
    name: str = "area light"
    receivers: frozenset[str] | None = None
    area: float = field(init=False)

    def __post_init__(self) -> None:
        self.world_matrix = affine_matrix(self.world_matrix, f"{self.name}: transform")
        if self.shape not in SHAPES:
            raise SceneError(f"{self.name}: shape must be one of {', '.join(SHAPES)}, not {self.shape!r}")
        size = np.broadcast_to(np.asarray(self.size, np.float64), (2,))
        if not np.all(np.isfinite(size)) or np.any(size <= 0.0):
            raise SceneError(f"{self.name}: size must be finite and above 0, not {size.tolist()}")
        self.size = float(size[0]), float(size[1])
        self.power = _power(self.power, self.name)
        self.spread = min(_not_negative(self.spread, f"{self.name}: spread"), float(np.pi))
        across = [self.world_matrix[:3, axis] * size[axis] for axis in (0, 1)]
        self.area = float(np.linalg.norm(np.cross(*across))) * (np.pi / 4.0 if self._round else 1.0)

    @property
    def _round(self) -> bool:
        return self.shape in ("disk", "ellipse")

    @property
    def centre(self) -> np.ndarray:
        """(3,)."""
        return self.world_matrix[:3, 3]

    @property
    def normal(self) -> np.ndarray:
        """Unit vector (3,) of the side that shines."""
        normal = np.cross(self.world_matrix[:3, 0], self.world_matrix[:3, 1])
        normal /= np.linalg.norm(normal)
        return -normal if normal @ self.world_matrix[:3, 2] > 0.0 else normal

    def emitters(self, low: np.ndarray, high: np.ndarray, most: int = MOST) -> Sequence[Emitter]:
        """As for PointLight."""
        half = 0.5 * np.array(self.size)
        axes = self.world_matrix[:3, :2] * half
        size = float(2.0 * np.linalg.norm(axes, axis=0).max())
        apart = size / max(distance_from_box(self.centre, low, high), 1e-6 * size)
        count = 1 + sum(apart >= size for size in (SMALL, MEDIUM_SIZE, LARGE))
        count = min(count, int(most**0.5))
        quads = _disk_quads(count) if self._round else _square_quads(count)
        found, normal = [], self.normal
        for quad in quads:
            corners = self.centre + quad @ axes.T
            whole = QuadEmitter(corners, normal, 1.0, self.spread)
            # All parts have the same area, which those of a disk differ from.
            radiance = self.area / len(quads) / whole.area / (np.pi * self.area)
            found.append(QuadEmitter(corners, normal, radiance, self.spread))
        return found


class Lamp(Protocol):
    """A light that has a place. name, receivers: as of PointLight. power: float64 (3,), W."""

    name: str
    power: np.ndarray
    receivers: frozenset[str] | None

    @property
    def centre(self) -> np.ndarray:
        """(3,)."""

    def emitters(self, low: np.ndarray, high: np.ndarray, most: int = MOST) -> Sequence[Emitter]:
        """As of PointLight."""


LAMPS = (PointLight, SpotLight, AreaLight)


def _sphere_emitters(whole: SphereEmitter, low: np.ndarray, high: np.ndarray, most: int) -> list[Emitter]:
    least = 0.5 * SMALL * distance_from_box(whole.centre, low, high)
    if most < MOST:
        least = max(least, TOLD_APART * float((high - low).max()))
    if most < len(OCTAHEDRON) or whole.radius <= least:
        return [whole]
    return [
        SphereEmitter(
            whole.centre,
            whole.centre + whole.radius * offset,
            whole.radius,
            1.0 / len(OCTAHEDRON),
            whole.cone,
            whole.soft_falloff,
        )
        for offset in OCTAHEDRON
    ]


def _square_quads(count: int) -> list[np.ndarray]:
    """The square from -1 to 1 in count x count squares, (4, 2) each."""
    ends = np.linspace(-1.0, 1.0, count + 1)
    return [
        np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        for x0, x1 in zip(ends[:-1], ends[1:])
        for y0, y1 in zip(ends[:-1], ends[1:])
    ]


def _disk_quads(count: int) -> list[np.ndarray]:
    """The unit disk in count x count parts of equal area, up to 16, as quadrilaterals (4, 2) of about that area."""
    if count == 1:
        return [np.sqrt(np.pi / 4.0) * quad for quad in _square_quads(1)]
    inner = {2: 1.0, 3: 1.0 / np.sqrt(3.0), 4: 0.5}[count]
    rings = [(0.0, 1.0, 4)] if count == 2 else [(0.0, inner, count), (inner, 1.0, count**2 - count)]
    found = []
    for inner, outer, parts in rings:
        angles = np.arange(parts + 1) * (2.0 * np.pi / parts)
        for a, b in zip(angles[:-1], angles[1:]):
            # Wider than the chord, so that the quadrilateral has the sector's area.
            far = outer * np.sqrt((b - a) / np.sin(b - a)) if parts > 4 else outer
            middle = 0.5 * (a + b)
            if inner == 0.0:
                reach = outer * (b - a) / (2.0 * np.sin(0.5 * (b - a)))
                points = [(0.0, a), (outer, a), (reach, middle), (outer, b)]
            else:
                near = inner * np.sqrt((b - a) / np.sin(b - a))
                points = [(near, a), (far, a), (far, b), (near, b)]
            found.append(np.array([[r * np.cos(angle), r * np.sin(angle)] for r, angle in points]))
    return found


def distance_from_box(point: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Distance of a point (3,) from a box."""
    return float(np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0.0)))


def _vector(value, name: str) -> np.ndarray:
    vector = np.asarray(value, np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise SceneError(f"{name} must be three finite numbers")
    return vector


def _power(value, name: str) -> np.ndarray:
    power = rgb_triple(value, f"{name}: power")
    if np.any(power < 0.0) or np.any(power > MAX_IRRADIANCE):
        raise SceneError(f"{name}: power must not be negative or above {MAX_IRRADIANCE:g}")
    return power


def _not_negative(value, name: str) -> float:
    number = float(value)
    if not 0.0 <= number < np.inf:
        raise SceneError(f"{name} must be finite and not negative, not {number:g}")
    return number
