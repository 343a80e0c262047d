# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of lamps along camera rays: single scattering, and what networks read of it.

The light of a lamp near a ray varies within a step as the inverse square of its distance. Its integral over each step
is a quadrature in the angle under which the lamp sees the step, in which the inverse square is constant (Kulla and
Fajardo, "Importance Sampling Techniques for Path Tracing in Participating Media", 2012); the transmittance varies
exponentially within a step, as for suns.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.grid import Grid
from ..grids.lamp_optical_depth import LampOpticalDepth
from ..kernels.field_structures import LampFluence
from ..kernels.library import Kernels
from ..kernels.structures import array_of
from ..numerics.quadrature import legendre_nodes
from ..occluders.lamp_shadow_map import CELLS, LampShadowMap
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Medium, Surface, Volume
from ..scene.lamps import Emitter, Lamp
from ..scene.mesh_light import MeshLight
from ..transport.described_lamps import describe_emitter
from ..transport.scattered_fluence import ScatteredFluence
from .ray_features import MAX_TAU_SUN, REACH, RayFeatures, SampleSteps, gather_ray_features
from .ray_march import (
    DARK,
    LampSegment,
    MarchedMedium,
    MarchOptions,
    block_sums,
    group_sums,
    mean_transmittance,
    optical_depth_behind,
    rays_from,
    reduced_fractions,
    scattered_source,
)
from .ray_steps import STEPS, Cutting, RayBatch

# Mean optical depth around a lamp inside a volume from which on multiple scattering is less accurate; measured.
ENCLOSED = 12.0
# Share of the directions around a lamp from which on a volume surrounds it.
SURROUNDED = 0.9
# Most emitters of a lamp in the coarse transport.
COARSE = 4
# Part of the light that a lamp would give to a point that it faced, and that stands for its light where that is less;
# the kernel holds it, too.
LEAST_FACING = 0.25
# Length of a step over its distance to a lamp from which on it takes MANY nodes, in the angle under which the lamp sees
# it, instead of FEW in its length; and up to which one in its middle is enough.
WIDE, FEW, MANY, BRIEF = 0.2, 2, 10, 0.02


@dataclass(frozen=True)
class LampInMedia:
    """A lamp, and what lies between it and points of some volumes.

    emitters: its parts. depths: of each emitter, the optical depth in each volume. coarse: the fewer parts of the
    coarse transport. shadow_maps: of each emitter, or None where no surface shadows anything from the lamp. key: digest
    that is equal for lamps with the same light and shadows. kernels: compiled ones, or None.
    """

    lamp: Lamp
    emitters: Sequence[Emitter]
    depths: list[list[LampOpticalDepth]]
    coarse: Sequence[Emitter]
    shadow_maps: list[LampShadowMap] | None = None
    key: bytes = b""
    kernels: Kernels | None = None

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
        if self.kernels is None:
            fluence = np.sum([emitter.fluence(points) for emitter in self.emitters], axis=0)
            return fluence, np.sum([emitter.brightest(points) for emitter in self.emitters], axis=0)
        fluence, brightest = np.empty((2, len(points)))
        data = LampFluence(
            points=len(points),
            positions=np.ascontiguousarray(points, np.float64),
            lamp=len(self.emitters),
            emitters=self._described,
            fluence=fluence,
            brightest=brightest,
        )
        self.kernels.prepare("lamp_fluence", data)
        return fluence, brightest


def place_lamp(
    lamp: Lamp,
    grids: Sequence[Grid],
    surfaces: Sequence[Surface] = (),
    cancel: CancelToken = NEVER,
    kernels: Kernels | None = None,
) -> LampInMedia:
    """A lamp with its columns through the grids of volumes, and the shadows of surfaces. Raises Cancelled.

    kernels: compiled ones, or None.
    """
    corners = np.concatenate([grid.corners() for grid in grids])
    emitters, maps = lamp.emitters(corners.min(axis=0), corners.max(axis=0)), None
    # The shadows of many emitters blend: each of them may be coarser.
    coarser = max(round(len(emitters) ** 0.5), 1)
    shading = _shading(lamp, surfaces)
    if shading:
        cells = CELLS // (1 << (coarser - 1).bit_length())
        maps = [LampShadowMap(shading, emitter.position, cells, cancel) for emitter in emitters]
        maps = None if all(one.empty for one in maps) else maps
    depths = [
        [
            LampOpticalDepth(grid.density, grid.linear, grid.offset, emitter.position, coarser, cancel, kernels)
            for grid in grids
        ]
        for emitter in emitters
    ]
    coarse = lamp.emitters(corners.min(axis=0), corners.max(axis=0), COARSE)
    return LampInMedia(lamp, emitters, depths, coarse, maps, lamp_key(lamp, grids, surfaces), kernels)


def lamp_key(lamp: Lamp, grids: Sequence[Grid], surfaces: Sequence[Surface] = ()) -> bytes:
    """Digest that is equal for lamps whose light differs in power alone, and whose shadows are equal."""
    corners = np.concatenate([grid.corners() for grid in grids])
    digest = hashlib.blake2b(digest_size=16)
    for emitter in lamp.emitters(corners.min(axis=0), corners.max(axis=0)):
        for value in vars(emitter).values():
            digest.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    for surface in _shading(lamp, surfaces):
        digest.update(np.ascontiguousarray(surface.triangles).tobytes())
    return digest.digest()


def _shading(lamp: Lamp, surfaces: Sequence[Surface]) -> list[Surface]:
    """Surfaces that shade volumes from a lamp: not those that are the lamp."""
    own = lamp.surface if isinstance(lamp, MeshLight) else None
    return [surface for surface in surfaces if surface.shades and surface is not own]


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


@dataclass(frozen=True)
class LampMarch:
    """Lamps whose light is gathered along camera rays.

    fluence: scattered light of the lamps in each group of volumes, None for a group without prediction; None altogether
    if no ray features are wanted. radius: by which their light is softened for these.
    """

    lamps: Sequence[LampInMedia]
    fluence: list[ScatteredFluence | None] | None
    radius: float


class _Steps:
    """Known steps of marched rays, flat: S of them, and the edges between them, E of them."""

    def __init__(self, medium: MarchedMedium, rays: RayBatch, known: np.ndarray):
        """known: bool (P, STEPS), whether light is looked up there."""
        blocks = medium.blocks
        self.medium, self.rays, self.filled = medium, rays, np.flatnonzero(known)
        self.ray = np.repeat(blocks.ray, STEPS)[self.filled]
        edges = np.zeros((len(blocks.ray), STEPS + 1), bool)
        edges[:, :-1] |= known
        edges[:, 1:] |= known
        self.edge = np.flatnonzero(edges)
        self.edge_ray, self.edge_place = np.repeat(blocks.ray, STEPS + 1)[self.edge], blocks.edges().ravel()[self.edge]
        # Where the edges of each step are in the flat array of edges.
        self.start = self.filled + self.filled // STEPS
        near, dt = medium.lines.near[self.ray], medium.lines.dt[self.ray]
        self.begin = near + blocks.steps(0.0).ravel()[self.filled] * dt
        self.end = near + blocks.steps(1.0).ravel()[self.filled] * dt
        self.middle = self.positions(0.5 * (self.begin + self.end))

    def scattered(self, values: np.ndarray, dtype=np.float64) -> np.ndarray:
        """Values (S,) as (P, STEPS), 0 elsewhere."""
        found = np.zeros(self.medium.total.shape, dtype)
        found.reshape(-1)[self.filled] = values
        return found

    def positions(self, distance: np.ndarray) -> np.ndarray:
        """World positions (S, 3) at distances (S,) along the rays."""
        return self.rays.origins[self.ray] + distance[:, None] * self.rays.directions[self.ray]

    def optical_depth(self, media: Sequence[BoundMedium], depths: Sequence[LampOpticalDepth]) -> np.ndarray:
        """Optical depth float32 (V, P, STEPS + 1) towards a lamp, at both ends of filled steps."""
        shape = len(self.medium.total), STEPS + 1
        found = np.full((len(media), *shape), DARK, np.float32)
        for v, (bound, depth) in enumerate(zip(media, depths)):
            index = self.medium.lines.index(v, self.edge_ray, self.edge_place)
            found[v].reshape(-1)[self.edge] = depth(index, bound.sigma_t) if bound.sigma_t > 0.0 else 0.0
        return found

    def integrals(self, emitter: Emitter, media: Sequence[BoundMedium]) -> np.ndarray:
        """Integrals (V, S) over the filled steps of the emitter's fluence times the phase function."""
        origin = self.rays.origins[self.ray] - emitter.position
        direction = self.rays.directions[self.ray]
        nearest = -(origin * direction).sum(axis=1)
        height = np.linalg.norm(origin + nearest[:, None] * direction, axis=1)
        begin, end = self.begin - nearest, self.end - nearest
        length, square = end - begin, height**2 + emitter.extent**2
        found = np.zeros((len(media), len(self.ray)))
        away = square + (0.5 * (begin + end)) ** 2
        wide, brief = length**2 > WIDE**2 * away, length**2 <= BRIEF**2 * away
        height = np.sqrt(square + 1e-6 * length**2)
        for bent, count, which in ((False, 1, brief), (False, FEW, ~(brief | wide)), (True, MANY, wide)):
            some = np.flatnonzero(which)
            first, last = (np.arctan2(ends[some], height[some]) for ends in (begin, end))
            nodes, weights = legendre_nodes(count)
            for node, weight in zip(0.5 + 0.5 * nodes, 0.5 * weights):
                if bent:
                    along = height[some] * np.tan(first + node * (last - first))
                    inside = weight * (last - first) * (height[some] ** 2 + along**2) / height[some]
                else:
                    along, inside = begin[some] + node * length[some], weight * length[some]
                away = origin[some] + (nearest[some] + along)[:, None] * direction[some]
                light = emitter.fluence(away + emitter.position) * inside
                cosine = -(away * direction[some]).sum(axis=1) / np.maximum(np.linalg.norm(away, axis=1), 1e-30)
                for v, bound in enumerate(media):
                    found[v, some] += light * bound.medium.scattered(cosine)
        return found


class _LitSteps:
    """One lamp in known steps: for each of its emitters optical depths (V, P, STEPS + 1) and visibility (S,)."""

    def __init__(self, steps: _Steps, media: Sequence[BoundMedium], lamp: LampInMedia):
        self.steps, self.media, self.lamp = steps, media, lamp
        self.depths = [steps.optical_depth(media, depths) for depths in lamp.depths]
        self.visible: list[np.ndarray | float] = [1.0] * len(lamp.emitters)
        if lamp.shadow_maps is not None:
            self.visible = [shadow_map.visibility(steps.middle) for shadow_map in lamp.shadow_maps]

    def single(self, transmitted: np.ndarray, scattering: Sequence[np.ndarray]) -> np.ndarray:
        """Single scattering (R, V, S) for power 1; transmitted: (P, STEPS), from the ray's start.

        scattering: scattering coefficients (V, P, STEPS) of S colour channels.
        """
        steps, medium = self.steps, self.steps.medium
        found = np.zeros((medium.blocks.rays, len(self.media), len(scattering)))
        for emitter, each, visible in zip(self.lamp.emitters, self.depths, self.visible):
            depth = each.sum(axis=0)
            passed = transmitted * mean_transmittance(depth[:, :-1], depth[:, 1:] + medium.tau)
            light = steps.integrals(emitter, self.media) * (passed.ravel()[steps.filled] * visible)
            for v in range(len(self.media)):
                inside = steps.scattered(light[v])
                for s, sigma in enumerate(scattering):
                    found[:, v, s] += medium.blocks.sums(block_sums(inside * sigma[v]))
        return found

    def beam(self, groups: list[list[int]] | None, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The lamp as one light: optical depth (G, P, STEPS + 1), softened fluence and visibility (P, STEPS)."""
        steps = self.steps
        fluence = [emitter.fluence(steps.middle) for emitter in self.lamp.emitters]
        total = np.maximum(np.sum(fluence, axis=0), 1e-30)
        reference = np.maximum(self.lamp.reference(steps.middle), 1e-30)
        visible = sum(part * lit for part, lit in zip(fluence, self.visible)) / reference
        depths = [group_sums(each, groups) for each in self.depths]
        if len(depths) == 1:
            depth = depths[0]
        else:
            passed = np.zeros(depths[0].shape)
            for part, one in zip(fluence, depths):
                share = np.full(one.shape[1:], 1.0 / len(depths))
                for ends in (steps.start + 1, steps.start):
                    share.reshape(-1)[ends] = part / total
                passed += share * np.exp(-one.astype(np.float64))
            depth = np.minimum(-np.log(np.maximum(passed, 1e-30)), DARK).astype(np.float32)
        received = steps.scattered(softened(reference, radius), np.float32)
        return depth, received, steps.scattered(visible, np.float32)


def march_lamps(
    media: Sequence[BoundMedium],
    rays: RayBatch,
    march: LampMarch,
    options: MarchOptions,
    samples: tuple[np.ndarray, np.ndarray],
) -> LampSegment:
    """What rays, whose intervals contain all media, gather of lamps; `CompiledMarch` is its twin.

    options: of the march for other light. samples: ray int (M,) and distance (M,) of samples at which ray features are
    wanted if there is a fluence.
    """
    lamps, radius, options = march.lamps, march.radius, replace(options, fluence=march.fluence)
    cutting = Cutting(optical_depth_behind(options), skip_empty="empty_space" in options.optimizations)
    medium = MarchedMedium(media, rays, cutting)
    steps = _Steps(medium, rays, medium.total > 0.0)
    transmitted = np.exp(-medium.before).astype(np.float32)[:, None] * np.exp(medium.tau - medium.within)
    scattering = [medium.scattering(media, channel) for channel in options.scattering]
    single, beams = np.zeros((len(rays.near), len(media), len(lamps), len(scattering))), []
    for k, lamp in enumerate(lamps):
        lit = _LitSteps(steps, media, lamp)
        single[:, :, k] = lit.single(transmitted, scattering)
        if options.fluence is not None:
            beams.append(lit.beam(options.groups, radius))
    if options.fluence is None or not len(samples[0]):
        return LampSegment(single)
    where = find_steps(medium, *samples)
    points = rays.origins[samples[0]] + samples[1][:, None] * rays.directions[samples[0]]
    return LampSegment(single, _features(steps, beams, lamps, options, where, points, radius))


def lamp_features_at(
    medium: BoundMedium,
    positions: np.ndarray,
    directions: np.ndarray,
    lamp: LampInMedia,
    fluence: ScatteredFluence,
    radius: float,
) -> RayFeatures:
    """Ray features at world positions (N, 3) for rays along unit directions (N, 3), of a lamp in one medium alone."""
    rays = rays_from(medium, positions, directions)
    marched = MarchedMedium([medium], rays, Cutting(REACH, keep_empty=True, always_first=True))
    start = np.flatnonzero(marched.blocks.rank == 0)
    known = marched.total > 0.0
    known[start, 0] = True
    steps = _Steps(marched, rays, known)
    beam = _LitSteps(steps, [medium], lamp).beam(None, radius)
    where = SampleSteps(start, np.zeros(len(positions), int), np.zeros(len(positions)))
    return _features(steps, [beam], [lamp], MarchOptions(1, [fluence]), where, positions, radius)


def _features(
    steps: _Steps,
    beams: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    lamps: Sequence[LampInMedia],
    options: MarchOptions,
    where: SampleSteps,
    points: np.ndarray,
    radius: float,
) -> RayFeatures:
    """Ray features at points (M, 3) of lamps, over their softened fluence there; beams: of each lamp."""
    medium, fluence = steps.medium, options.fluence
    assert fluence is not None
    depths = np.stack([depth for depth, _, _ in beams], axis=1)
    light = np.stack([received * visible for _, received, visible in beams])
    sigma = group_sums(medium.sigma, options.groups)
    source = scattered_source(fluence, steps.rays, sigma, len(lamps), medium)
    found = gather_ray_features(
        medium.blocks, sigma * medium.dt, depths, source, reduced_fractions(fluence), where, light
    ).values
    for k, (lamp, (depth, _, visible)) in enumerate(zip(lamps, beams)):
        # The optical depth is the medium's and the surfaces', without the inverse square.
        start, end = depth[:, where.block, where.step], depth[:, where.block, where.step + 1]
        dark = -np.log(np.maximum(visible[where.block, where.step], 1e-30))
        found[:, :, k, 0] = np.minimum((start + where.inside * (end - start) + dark).T, MAX_TAU_SUN)
        found[:, :, k, 2:] /= np.maximum(softened(lamp.reference(points), radius), 1e-30)[:, None, None]
    return RayFeatures(found)


def find_steps(medium: MarchedMedium, ray: np.ndarray, distance: np.ndarray) -> SampleSteps:
    """Where points of marched rays lie among the steps: the step that holds each, or the nearest one."""
    blocks, lines = medium.blocks, medium.lines
    place = (distance - lines.near[ray]) / lines.dt[ray]
    span = 2.0 * (lines.count.max(initial=1) + STEPS)
    block = np.searchsorted(blocks.ray * span + blocks.place, ray * span + np.maximum(place, 0.0), side="right") - 1
    block = np.clip(block, np.searchsorted(blocks.ray, ray), np.searchsorted(blocks.ray, ray, side="right") - 1)
    inside = (place - blocks.place[block]) / blocks.size[block]
    step = np.clip(np.floor(inside).astype(int), 0, STEPS - 1)
    return SampleSteps(block, step, np.clip(inside - step, 0.0, 1.0))
