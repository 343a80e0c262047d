# SPDX-License-Identifier: GPL-3.0-or-later
"""Point, spot and area lights, and the emitters into which they are divided."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from .description import MAX_IRRADIANCE, Surface, affine_matrix, rgb_triple
from .emitters import Emitter, QuadEmitter, SphereEmitter
from .errors import SceneError
from .light import Families, Light
from .spot_cone import SpotCone

#: Shapes of area lights.
SHAPES = ("square", "rectangle", "disk", "ellipse")
# Size of a lamp, over its distance to the lit box, up to which it has a single emitter; and up to which a flat lamp has
# four and nine.
SMALL, MEDIUM_SIZE, LARGE = 0.1, 0.35, 1.0
# Largest number of emitters of a lamp.
MOST = 16
#: Smallest spread of area lights, in radians: the beams of their emitters have to overlap.
LEAST_SPREAD = np.pi / 36.0
# Radius of a sphere, over the longest edge of the lit box, up to which it has a single emitter where few are asked for.
LEAST_SPHERE = 0.025
# Centres of emitters that represent a sphere, over its radius: vertices of an octahedron whose variance along any axis
# is that of the disk as which the sphere appears.
OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)]) * np.sqrt(0.75)


class Lamp(Light):
    """A light at a position in the world. power: float64 (3,), W."""

    power: np.ndarray

    @property
    def body(self) -> Surface | None:
        """The surface that is the lamp, which does not shade it, or None."""
        return None

    @property
    def centre(self) -> np.ndarray:
        """(3,)."""
        raise NotImplementedError

    def emitters(self, low: np.ndarray, high: np.ndarray, most: int = MOST) -> Sequence[Emitter]:
        """As of PointLight."""
        raise NotImplementedError

    @property
    def strength(self) -> np.ndarray:
        """Its power."""
        return self.power

    @property
    def darkness(self) -> str:
        """As of Light."""
        return "" if self.power.any() else "its power is 0"

    def add_to(self, families: Families) -> None:
        """As of Light."""
        families.lamps.append(self)

    def fluence_at(self, points: np.ndarray) -> np.ndarray:
        """As of Light."""
        emitters = self.emitters(points.min(axis=0), points.max(axis=0))
        return np.sum([emitter.fluence(points) for emitter in emitters], axis=0)[:, None] * self.power


@dataclass
class PointLight(Lamp):
    """A sphere, or a point, that shines alike in all directions.

    position: (3,) world. power: W, scalar or RGB, in [0, 1e30]; float64 (3,) once made. The radiant intensity is
    power / (4 pi), W/sr. radius: world units. name: for messages. soft_falloff: whether the light is a disk of that
    radius that faces each lit point, instead of a sphere; its light grows steadily within the radius, too. receivers:
    as of Sun.

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
        """Emitters, up to `most`, into which it is divided to light the box from low (3,) to high (3,) in the world."""
        sphere = SphereEmitter(self.position, self.position, self.radius, soft_falloff=self.soft_falloff)
        return _sphere_emitters(sphere, low, high, most)


@dataclass
class SpotLight(Lamp):
    """A sphere, or a point, that shines into a cone.

    position: (3,) world. direction: (3,), the way the light travels; normalised here. power: W, scalar or RGB, in
    [0, 1e30]; float64 (3,) once made. The radiant intensity within the cone is power / (4 pi), W/sr, however wide it
    is. angle: full angle of the cone in radians, in (0, pi]. blend: part of the cone, in [0, 1], over which the light
    fades towards its edge, as smoothstep of the cosine. radius: world units. name: for messages. soft_falloff,
    receivers: as in PointLight. frame: (3, 3), from directions in the world to those in which the cone is round, around
    +Z, and has its angle and its blend; None for a round cone. It must not be singular.

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
    frame: np.ndarray | None = None

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
        if self.frame is not None:
            self.frame = np.array(self.frame, np.float64)
            if self.frame.shape != (3, 3) or not 1e-12 < abs(np.linalg.det(self.frame)) < np.inf:
                raise SceneError(f"{self.name}: frame must be a matrix (3, 3) that is not singular")

    @property
    def centre(self) -> np.ndarray:
        """(3,)."""
        return self.position

    def emitters(self, low: np.ndarray, high: np.ndarray, most: int = MOST) -> Sequence[Emitter]:
        """As for PointLight."""
        cone = SpotCone(self.direction, float(np.cos(0.5 * self.angle)), self.blend, self.frame)
        sphere = SphereEmitter(self.position, self.position, self.radius, 1.0, cone, self.soft_falloff)
        return _sphere_emitters(sphere, low, high, most)


@dataclass
class AreaLight(Lamp):
    """A flat light that shines to one side, along its -Z.

    world_matrix: (4, 4), from the lamp's frame. shape: one of SHAPES. size: full width before the matrix, one number or
    (x, y). power: W, scalar or RGB, in [0, 1e30]; float64 (3,) once made. The radiance is power / (pi area). spread: in
    [0, pi], at least LEAST_SPREAD once made: full angle of the cone beyond which no light leaves. The radiance at the
    angle a from the axis has the factor (tan(spread / 2) - tan(a)) / (tan(spread / 2) - spread / 2). name: for
    messages. receivers: as of Sun.

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
        self.spread = min(max(_not_negative(self.spread, f"{self.name}: spread"), LEAST_SPREAD), float(np.pi))
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
        emitters, normal = [], self.normal
        for quad in quads:
            corners = self.centre + quad @ axes.T
            unit = QuadEmitter(corners, normal, 1.0, self.spread)
            # Emitters of equal power; the quadrilaterals of a disk have only about equal areas.
            emitters.append(unit.dimmed(self.area / len(quads) / unit.area / (np.pi * self.area)))
        return emitters


def _sphere_emitters(sphere: SphereEmitter, low: np.ndarray, high: np.ndarray, most: int) -> list[Emitter]:
    least = 0.5 * SMALL * distance_from_box(sphere.centre, low, high)
    if most < MOST:
        least = max(least, LEAST_SPHERE * float((high - low).max()))
    if most < len(OCTAHEDRON) or sphere.radius <= least:
        return [sphere]
    share = 1.0 / len(OCTAHEDRON)
    return [replace(sphere, position=sphere.centre + sphere.radius * offset, share=share) for offset in OCTAHEDRON]


def _square_quads(count: int) -> list[np.ndarray]:
    """The square from -1 to 1 in count x count squares, (4, 2) each."""
    ends = np.linspace(-1.0, 1.0, count + 1)
    return [
        np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        for x0, x1 in zip(ends[:-1], ends[1:])
        for y0, y1 in zip(ends[:-1], ends[1:])
    ]


def _disk_quads(count: int) -> list[np.ndarray]:
    """The unit disk in count x count sectors of equal area, up to 16, as quadrilaterals (4, 2) of about that area."""
    if count == 1:
        return [np.sqrt(np.pi / 4.0) * quad for quad in _square_quads(1)]
    inner = {2: 1.0, 3: 1.0 / np.sqrt(3.0), 4: 0.5}[count]
    rings = [(0.0, 1.0, 4)] if count == 2 else [(0.0, inner, count), (inner, 1.0, count**2 - count)]
    quads = []
    for inner, outer, sectors in rings:
        angles = np.arange(sectors + 1) * (2.0 * np.pi / sectors)
        for a, b in zip(angles[:-1], angles[1:]):
            # Wider than the chord, so that the quadrilateral has the sector's area.
            far = outer * np.sqrt((b - a) / np.sin(b - a)) if sectors > 4 else outer
            middle = 0.5 * (a + b)
            if inner == 0.0:
                reach = outer * (b - a) / (2.0 * np.sin(0.5 * (b - a)))
                points = [(0.0, a), (outer, a), (reach, middle), (outer, b)]
            else:
                near = inner * np.sqrt((b - a) / np.sin(b - a))
                points = [(near, a), (far, a), (far, b), (near, b)]
            quads.append(np.array([[r * np.cos(angle), r * np.sin(angle)] for r, angle in points]))
    return quads


def distance_from_box(point: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Distance of a point (3,) from a box."""
    return float(np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0.0)))


def _vector(value: ArrayLike, name: str) -> np.ndarray:
    vector = np.asarray(value, np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise SceneError(f"{name} must be three finite numbers")
    return vector


def _power(value: ArrayLike, name: str) -> np.ndarray:
    power = rgb_triple(value, f"{name}: power")
    if np.any(power < 0.0) or np.any(power > MAX_IRRADIANCE):
        raise SceneError(f"{name}: power must not be negative or above {MAX_IRRADIANCE:g}")
    return power


def _not_negative(value: float, name: str) -> float:
    number = float(value)
    if not 0.0 <= number < np.inf:
        raise SceneError(f"{name} must be finite and not negative, not {number:g}")
    return number
