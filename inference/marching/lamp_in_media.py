# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps, with the media and surfaces between them and points of volumes."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, is_dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.grid import Grid
from ..grids.lamp_optical_depth import LampOpticalDepth
from ..kernels.library import call
from ..kernels.structures import array_of
from ..numerics.small_matmul import inverse
from ..occluders.lamp_shadow_map import CELLS, LampShadowMap
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Medium, Surface, Volume
from ..scene.emitters import Emitter
from ..scene.lamps import MOST, Lamp, distance_from_box
from ..source_terms.described_lamps import describe_emitter

# Mean optical depth around a lamp inside a volume from which on multiple scattering is less accurate; measured.
ENCLOSED = 12.0
# Fraction of the directions around a lamp from which on a volume surrounds it.
SURROUNDED = 0.9
# Most emitters of a lamp in the coarse transport.
COARSE = 6
# Most doublings of the spacing of columns of lamps that give little of the light.
MOST_COARSER = 2
# Directions in which each emitter's light is followed, to tell how much of it volumes take.
CAPTURE_DIRECTIONS = 1024
# Lower bound of a lamp's light at a point, as a fraction of what the lamp would give if it faced the point; the kernel
# holds it, too.
LEAST_FACING = 0.25
# A lamp's light is interpolated between positions on a ray. Their spacing over the distance to the lamp is the first of
# SMOOTH that leaves an error of at most SMOOTH_ERROR of the phase function's value.
SMOOTH, SMOOTH_ERROR = tuple(1.0 / n for n in (16, 20, 24, 28, 32, 40, 48, 64, 96, 128)), 0.03


@dataclass(frozen=True)
class LampInMedia:
    """A lamp, and the media and surfaces between it and points of volumes.

    emitters: its parts. depths: of each emitter, the optical depth in each volume. coarse: fewer emitters, for the
    coarse transport. shadow_maps: of each emitter, or None where no surface shadows the volumes from the lamp. key:
    digest that is equal for lamps with the same light and shadows. surface_shadow_maps: as shadow_maps, for surfaces,
    which may shadow one another alone.
    """

    lamp: Lamp
    emitters: Sequence[Emitter]
    depths: list[list[LampOpticalDepth]]
    coarse: Sequence[Emitter]
    shadow_maps: list[LampShadowMap] | None = None
    key: bytes = b""
    surface_shadow_maps: list[LampShadowMap] | None = None
    #: How many lamps it stands for.
    count: ClassVar[int] = 1

    @property
    def power(self) -> np.ndarray:
        """(3,), W."""
        return self.lamp.power

    def within(self, volumes: Sequence[int]) -> "LampInMedia":
        """The lamp with some of the volumes, by number, between it and points."""
        return replace(self, depths=[[depths[v] for v in volumes] for depths in self.depths])

    def shares(self, points: np.ndarray) -> np.ndarray:
        """Fraction of the light at points (N, 3) that this lamp gives: float32 (N, 1), 1."""
        return np.ones((len(points), 1), np.float32)

    @property
    def coarse_shadow_maps(self) -> list[LampShadowMap] | None:
        """Shadow map of the nearest emitter, for each emitter of the coarse transport."""
        if self.shadow_maps is None:
            return None
        positions = np.array([emitter.position for emitter in self.emitters])
        nearest = [np.linalg.norm(positions - emitter.position, axis=1).argmin() for emitter in self.coarse]
        return [self.shadow_maps[number] for number in nearest]

    def captured(self, grids: Sequence[Grid], sigma_t: Sequence[float]) -> float:
        """Power that collides in the volumes before it meets a surface, of a lamp of power 1.

        sigma_t: extinction of each volume, per unit density.
        """
        corners = np.concatenate([grid.corners() for grid in grids])
        captured = 0.0
        for e, emitter in enumerate(self.emitters):
            beyond = 2.0 * float(np.linalg.norm(corners - emitter.position, axis=1).max()) + emitter.extent
            directions = emitter.directions(CAPTURE_DIRECTIONS)
            light = emitter.fluence(emitter.position + beyond * directions)
            distance = np.full(len(directions), beyond)
            if self.surface_shadow_maps is not None:
                distance = np.minimum(distance, self.surface_shadow_maps[e].distance(directions))
            points = emitter.position + distance[:, None] * directions
            depths = np.zeros(len(points))
            for grid, depth, extinction in zip(grids, self.depths[e], sigma_t):
                depths += depth(grid.index(points).T.astype(np.float32), extinction)
            captured += emitter.power * float((-np.expm1(-depths) * light).sum() / max(light.sum(), 1e-300))
        return captured

    @property
    def centre(self) -> np.ndarray:
        """(3,), the middle of the emitters in the world."""
        return np.mean([emitter.position for emitter in self.emitters], axis=0)

    @property
    def reach(self) -> float:
        """Radius of a sphere around the middle that holds the emitters."""
        away = [np.linalg.norm(emitter.position - self.centre) + emitter.extent for emitter in self.emitters]
        return float(max(away))

    def smooth(self, media: Sequence[BoundMedium]) -> float:
        """Largest spacing of positions on a ray, over their distance to the lamp, between which its light times the
        phase functions of media is about linear; 0 where the edge of a cone may lie between them."""
        if any(emitter.cone is not None for emitter in self.emitters):
            return 0.0
        return min(_smooth(bound.medium) for bound in media)

    def fluence(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) at world points (N, 3), for power 1, without attenuation."""
        return self._light(points)[0]

    def reference(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) that networks take as a lamp's light at points (N, 3), above 0 outside a cone, too.

        The excess over the lamp's fluence counts as shadow.
        """
        fluence, brightest = self._light(points)
        return np.maximum(fluence, LEAST_FACING * brightest)

    @cached_property
    def _described(self) -> Any:
        """The emitters as compiled kernels read them."""
        return array_of([describe_emitter(emitter) for emitter in self.emitters])

    def _light(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fluence float64 (N,) at world points (N, 3), and the fluence if each emitter faced each point."""
        fluence, brightest = np.empty((2, len(points)))
        call(
            "lamp_fluence",
            points=len(points),
            positions=np.ascontiguousarray(points, np.float64),
            lamp=len(self.emitters),
            emitters=self._described,
            fluence=fluence,
            brightest=brightest,
        )
        return fluence, brightest


def place_lamp(
    lamp: Lamp,
    grids: Sequence[Grid],
    surfaces: Sequence[Surface] = (),
    cancel: CancelToken = NEVER,
    share: float = 1.0,
) -> LampInMedia:
    """A lamp with its columns through the grids of volumes, and the shadows of surfaces. Raises Cancelled.

    share: of all light, that it gives where that is the most.
    """
    emitters, maps = _emitters(lamp, grids, share), None
    coarser = max(round(len(emitters) ** 0.5), _coarser(share))
    shading = _shading(lamp, surfaces)
    if shading:
        cells = CELLS // (1 << (coarser - 1).bit_length())
        maps = [LampShadowMap(shading, emitter.position, cells, cancel) for emitter in emitters]
        maps = None if all(shadow_map.empty for shadow_map in maps) else maps
    shaded = maps is not None and _may_shade(shading, emitters, grids)
    depths = [
        [LampOpticalDepth(grid.density, grid.linear, grid.offset, emitter.source, coarser, cancel) for grid in grids]
        for emitter in emitters
    ]
    coarse = _emitters(lamp, grids, share, COARSE)
    key = lamp_key(lamp, grids, surfaces, share)
    return LampInMedia(lamp, emitters, depths, coarse, maps if shaded else None, key, maps)


def _may_shade(surfaces: Sequence[Surface], emitters: Sequence[Emitter], grids: Sequence[Grid]) -> bool:
    """Whether any triangle may lie between emitters and the outermost voxels of grids.

    Excluded are triangles that have all of these on one side of their plane, like a floor, or that lie beside them.
    """
    ends = np.array(np.meshgrid(*[(0.0, 1.0)] * 3, indexing="ij")).reshape(3, -1).T
    voxels = [(ends * (np.array(grid.shape) - 1.0) - grid.offset) @ inverse(grid.linear).T for grid in grids]
    points = np.concatenate([*voxels, [emitter.position for emitter in emitters]])
    low, high = points.min(axis=0), points.max(axis=0)
    for surface in surfaces:
        a, b, c = surface.triangles.swapaxes(0, 1)
        near = np.all((surface.triangles.min(axis=1) < high) & (surface.triangles.max(axis=1) > low), axis=1)
        heights = np.einsum("tpk,tk->tp", points - a[near, None], np.cross(b - a, c - a)[near])
        if np.any((heights.min(axis=1) < 0.0) & (heights.max(axis=1) > 0.0)):
            return True
    return False


def _emitters(lamp: Lamp, grids: Sequence[Grid], share: float, most: int = MOST) -> Sequence[Emitter]:
    """Emitters, up to `most`, of a lamp; fewer of lamps outside of the volumes that give less than half of light."""
    corners = np.concatenate([grid.corners() for grid in grids])
    low, high = corners.min(axis=0), corners.max(axis=0)
    if distance_from_box(lamp.centre, low, high) > 0.0:
        most = int(np.clip(2.0 * share * MOST, 1, most))
    return lamp.emitters(low, high, most)


def _coarser(share: float) -> int:
    """Factor of the spacing of a lamp's columns: the shadows of many lamps blend, as those of many emitters do."""
    return 1 << round(float(np.clip(0.5 * np.log2(0.5 / max(share, 1e-9)), 0.0, MOST_COARSER)))


def lamp_key(lamp: Lamp, grids: Sequence[Grid], surfaces: Sequence[Surface] = (), share: float = 1.0) -> bytes:
    """Digest that is equal for lamps that differ in power alone and have equal shadows; share: as of `place_lamp`."""
    digest = hashlib.blake2b(bytes([_coarser(share)]), digest_size=16)
    for emitter in _emitters(lamp, grids, share):
        _add_values(digest, emitter)
    for surface in _shading(lamp, surfaces):
        digest.update(np.ascontiguousarray(surface.triangles).tobytes())
    return digest.digest()


def _add_values(digest: Any, value: Any) -> None:
    """Add the fields of an emitter, or of an object that it holds, to a digest."""
    if is_dataclass(value):
        for field in vars(value).values():
            _add_values(digest, field)
    else:
        digest.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())


def _smooth(medium: Medium) -> float:
    """Largest angle of SMOOTH, in radians, over which a medium's phase function is about linear; 0 if there is none."""
    for angle in SMOOTH:
        middle = np.arange(0.0, np.pi + angle, 0.25 * angle)
        low, centre, high = (medium.scattered(np.cos(middle + shift * angle)) for shift in (-0.5, 0.0, 0.5))
        if np.all(np.abs(0.5 * (low + high) - centre) <= SMOOTH_ERROR * centre):
            return angle
    return 0.0


def _shading(lamp: Lamp, surfaces: Sequence[Surface]) -> list[Surface]:
    """Surfaces that shade volumes from a lamp: all but the lamp's own body."""
    return [surface for surface in surfaces if surface.shades and surface is not lamp.body]


def enclosed_warnings(lamp: LampInMedia, volumes: Sequence[tuple[Volume, Medium]]) -> list[str]:
    """Warnings that name volumes so dense around a lamp that the little light that comes out is uncertain."""
    warnings = []
    for v, (volume, medium) in enumerate(volumes):
        if not lamp.depths[0][v].inside:
            continue
        depths, fractions = lamp.depths[0][v].outwards(float(medium.sigma_t.max()))
        depth = float((depths * fractions).sum())
        if depth > ENCLOSED and fractions.sum() > SURROUNDED and medium.albedo.any():
            warnings.append(
                f"{lamp.lamp.name}: it lies deep inside {volume.name}, which is very dense; what little of its light "
                "comes out may be much too bright"
            )
    return warnings


def softened(fluence: np.ndarray, radius: float) -> np.ndarray:
    """Fluence (N,) of a lamp of power 1, limited as if the lamp were no nearer than `radius`, in world units."""
    return fluence / (1.0 + fluence * (4.0 * np.pi * radius**2))
