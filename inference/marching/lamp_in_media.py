# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps with what lies between them and points of volumes."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from typing import Any

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
from ..scene.lamps import Lamp
from ..transport.described_lamps import describe_emitter

# Mean optical depth around a lamp inside a volume from which on multiple scattering is less accurate; measured.
ENCLOSED = 12.0
# Share of the directions around a lamp from which on a volume surrounds it.
SURROUNDED = 0.9
# Most emitters of a lamp in the coarse transport.
COARSE = 6
# Part of the light that a lamp would give to a point that it faced, and that stands for its light where that is less;
# the kernel holds it, too.
LEAST_FACING = 0.25
# Places on a ray between which a lamp's light is interpolated: their distance from each other, over that to the lamp,
# is one of SMOOTH, the first that leaves an error of up to SMOOTH_ERROR of the phase function's value.
SMOOTH, SMOOTH_ERROR = tuple(1.0 / n for n in (16, 20, 24, 28, 32, 40, 48, 64, 96, 128)), 0.03


@dataclass(frozen=True)
class LampInMedia:
    """A lamp, and what lies between it and points of some volumes.

    emitters: its parts. depths: of each emitter, the optical depth in each volume. coarse: the fewer parts of the
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

    @property
    def power(self) -> np.ndarray:
        """(3,), W."""
        return self.lamp.power

    def shares(self, points: np.ndarray) -> np.ndarray:
        """Its share in its light at points (N, 3): float32 (N, 1), 1."""
        return np.ones((len(points), 1), np.float32)

    @property
    def coarse_shadow_maps(self) -> list[LampShadowMap] | None:
        """Of each emitter of the coarse transport, that of the nearest of all emitters."""
        if self.shadow_maps is None:
            return None
        positions = np.array([emitter.position for emitter in self.emitters])
        nearest = [np.linalg.norm(positions - emitter.position, axis=1).argmin() for emitter in self.coarse]
        return [self.shadow_maps[number] for number in nearest]

    def captured(self, sigma_t: Sequence[float]) -> float:
        """Fraction of the light of a lamp that shone alike in all directions which would meet the volumes' matter.

        sigma_t: extinction of each volume, per unit density.
        """
        passed = np.ones(len(self.emitters))
        for e, each in enumerate(self.depths):
            for depth, extinction in zip(each, sigma_t):
                depths, shares = depth.outwards(extinction)
                passed[e] *= 1.0 - (shares * -np.expm1(-depths)).sum()
        return float(1.0 - passed.mean())

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
        """How far apart places on a ray may be, over their distance to the lamp, for its light in between to vary about
        linearly, with the phase function of media; 0 where the edge of a cone may lie between them."""
        if any(emitter.cone is not None for emitter in self.emitters):
            return 0.0
        return min(_smooth(bound.medium) for bound in media)

    def fluence(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) at world points (N, 3), for power 1, without what lies in between."""
        return self._light(points)[0]

    def reference(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) that networks take as a lamp's light at points (N, 3): not 0 where it shines elsewhere.

        What it is above the lamp's fluence counts as shadow.
        """
        fluence, brightest = self._light(points)
        return np.maximum(fluence, LEAST_FACING * brightest)

    @cached_property
    def _described(self) -> Any:
        """The emitters as compiled kernels read them."""
        return array_of([describe_emitter(emitter) for emitter in self.emitters])

    def _light(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fluence float64 (N,) at world points (N, 3), and what it would be if each emitter faced each of them."""
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
) -> LampInMedia:
    """A lamp with its columns through the grids of volumes, and the shadows of surfaces. Raises Cancelled."""
    corners = np.concatenate([grid.corners() for grid in grids])
    emitters, maps = lamp.emitters(corners.min(axis=0), corners.max(axis=0)), None
    # The shadows of many emitters blend: each of them may be coarser.
    coarser = max(round(len(emitters) ** 0.5), 1)
    shading = _shading(lamp, surfaces)
    if shading:
        cells = CELLS // (1 << (coarser - 1).bit_length())
        maps = [LampShadowMap(shading, emitter.position, cells, cancel) for emitter in emitters]
        maps = None if all(one.empty for one in maps) else maps
    shaded = maps is not None and _may_shade(shading, emitters, grids)
    depths = [
        [LampOpticalDepth(grid.density, grid.linear, grid.offset, emitter.source, coarser, cancel) for grid in grids]
        for emitter in emitters
    ]
    coarse = lamp.emitters(corners.min(axis=0), corners.max(axis=0), COARSE)
    key = lamp_key(lamp, grids, surfaces)
    return LampInMedia(lamp, emitters, depths, coarse, maps if shaded else None, key, maps)


def _may_shade(surfaces: Sequence[Surface], emitters: Sequence[Emitter], grids: Sequence[Grid]) -> bool:
    """Whether any triangle may lie between emitters and the outermost voxels of grids.

    None does that has all of them on one side of its plane, as a floor below them has, or that lies beside them.
    """
    ends = np.array(np.meshgrid(*[(0.0, 1.0)] * 3, indexing="ij")).reshape(3, -1).T
    voxels = [(ends * (np.array(grid.shape) - 1.0) - grid.offset) @ inverse(grid.linear).T for grid in grids]
    points = np.concatenate([*voxels, [emitter.position for emitter in emitters]])
    low, high = points.min(axis=0), points.max(axis=0)
    for surface in surfaces:
        a, b, c = surface.triangles.swapaxes(0, 1)
        some = np.all((surface.triangles.min(axis=1) < high) & (surface.triangles.max(axis=1) > low), axis=1)
        heights = np.einsum("tpk,tk->tp", points - a[some, None], np.cross(b - a, c - a)[some])
        if np.any((heights.min(axis=1) < 0.0) & (heights.max(axis=1) > 0.0)):
            return True
    return False


def lamp_key(lamp: Lamp, grids: Sequence[Grid], surfaces: Sequence[Surface] = ()) -> bytes:
    """Digest that is equal for lamps whose light differs in power alone, and whose shadows are equal."""
    corners = np.concatenate([grid.corners() for grid in grids])
    digest = hashlib.blake2b(digest_size=16)
    for emitter in lamp.emitters(corners.min(axis=0), corners.max(axis=0)):
        _add_values(digest, emitter)
    for surface in _shading(lamp, surfaces):
        digest.update(np.ascontiguousarray(surface.triangles).tobytes())
    return digest.digest()


def _add_values(digest: Any, value: Any) -> None:
    """Add what an emitter, or a part of it, is made of to a digest."""
    if is_dataclass(value):
        for one in vars(value).values():
            _add_values(digest, one)
    else:
        digest.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())


def _smooth(medium: Medium) -> float:
    """Angle in radians, of SMOOTH, between whose ends a medium's phase function is about linear; 0 where it is less."""
    for angle in SMOOTH:
        middle = np.arange(0.0, np.pi + angle, 0.25 * angle)
        low, here, high = (medium.scattered(np.cos(middle + shift * angle)) for shift in (-0.5, 0.0, 0.5))
        if np.all(np.abs(0.5 * (low + high) - here) <= SMOOTH_ERROR * here):
            return angle
    return 0.0


def _shading(lamp: Lamp, surfaces: Sequence[Surface]) -> list[Surface]:
    """Surfaces that shade volumes from a lamp: not those that are the lamp."""
    return [surface for surface in surfaces if surface.shades and surface is not lamp.body]


def enclosed_warnings(lamp: LampInMedia, volumes: Sequence[tuple[Volume, Medium]]) -> list[str]:
    """Names volumes so dense around a lamp that little of its light comes out, and what does is less certain."""
    found = []
    for v, (volume, medium) in enumerate(volumes):
        depths, shares = lamp.depths[0][v].outwards(float(medium.sigma_t.max()))
        depth = float((depths * shares).sum())
        if depth > ENCLOSED and shares.sum() > SURROUNDED and medium.albedo.any():
            found.append(
                f"{lamp.lamp.name}: it lies deep inside {volume.name}, behind an optical depth of {depth:.2g} on "
                "average; what little of its light comes out may be much too bright"
            )
    return found


def softened(fluence: np.ndarray, radius: float) -> np.ndarray:
    """Fluence of a lamp of power 1 as if it were no nearer than a distance: a lamp's light on a coarse scale."""
    return fluence / (1.0 + fluence * (4.0 * np.pi * radius**2))
