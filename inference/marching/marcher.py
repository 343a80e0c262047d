# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays marched by the compiled kernel: transmittance, exact single scattering, emission and depth samples.

Within a step extinction is constant and the optical depth towards the sun linear, so that the integrals over a step are
exact (`kernels/march.c`).
"""

import copy
import ctypes
import functools
import threading
from collections.abc import Callable, Hashable, Sequence
from ctypes import addressof, c_int32, c_void_p
from dataclasses import replace
from typing import Any

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.dense_grid import DenseGrid
from ..grids.described import describe_grid, describe_occupancy
from ..grids.sun_optical_depth import SunOpticalDepth
from ..kernels import library, structures
from ..numerics.quadrature import legendre_nodes
from ..occluders.shadow_map import ShadowMap
from ..runtime.cancellation import Cancelled
from ..scene.description import Medium
from ..source_terms.described_lamps import describe_emitter, describe_shadow_map
from ..transport.scattered_fluence import ScatteredFluence
from .depth_samples import COARSE_COUNT, MIN_ALPHA, possible_counts
from .joined_lamps import PredictedLamp
from .mean_lamp_depth import MeanLampDepth
from .ray_features import COLUMNS, MAX_TAU_AHEAD, MAX_TAU_SUN, SCALES, RayFeatures
from .ray_march import (
    BRIEF,
    DARK,
    JITTER,
    MANY,
    MAX_OPTICAL_DEPTH,
    WIDE,
    LampMarch,
    LampSegment,
    MarchOptions,
    RaySegment,
    optical_depth_behind,
)
from .ray_steps import (
    FINEST,
    PEAK_GROWTH,
    PEAK_THICKNESS,
    STEP_GROWTH,
    STEP_THICKNESS,
    STEPS,
    Boxes,
    RayBatch,
    step_counts,
)

# Describes something for kernels, once.
Once = Callable[..., structures.Shared]


class Marcher:
    """Marches rays through media, with the emission in colour channels.

    Safe to use on several threads.
    """

    def __init__(
        self,
        media: Sequence[BoundMedium],
        options: MarchOptions,
        channels: Sequence[int],
        stop: c_int32,
        lamps: LampMarch | None = None,
    ):
        """channels: colour channels, by number. stop: once it is not 0, calls return soon, their result incomplete.

        lamps: whose light is gathered, too; None for none.
        """
        self._lamps = lamps
        self._kernels, self._media, self._options = library.load_kernels(), media, options
        self._indices, self._channels, self._emits = channels, len(channels), any(medium.emits for medium in media)
        #: Numbers of the media, of those that another Marcher marches through.
        self.volumes: Sequence[int] = range(len(media))
        self._varying = sum(medium.varies for medium in media)
        self._stop = stop
        self._groups = options.groups or [[v] for v in range(len(media))]
        self._suns = len(media[0].sun_depths) if media else 0
        self._scene = self._describe(list(channels))
        # Shared by those through some of the groups, since untouched memory takes time.
        self._local = threading.local()

    @property
    def has_lamps(self) -> bool:
        """Whether light of lamps is gathered."""
        return self._lamps is not None

    @property
    def media(self) -> Sequence[BoundMedium]:
        """Through which it marches."""
        return self._media

    @functools.cached_property
    def boxes(self) -> Boxes:
        """Their supports."""
        return Boxes.of(self._media)

    def through(self, groups: Sequence[int]) -> "Marcher":
        """Marches through some groups of media alone, by number, in the light of suns."""
        volumes = sorted(v for g in groups for v in self._groups[g])
        places = {v: place for place, v in enumerate(volumes)}
        found = copy.copy(self)
        found.__dict__.pop("boxes", None)
        found._media, found.volumes = [self._media[v] for v in volumes], volumes
        found._groups = [[places[v] for v in self._groups[g]] for g in groups]
        found._emits = any(medium.emits for medium in found._media)
        found._varying = sum(medium.varies for medium in found._media)
        starts, members = _listed(found._groups)
        found._scene = structures.copied(
            self._scene,
            volumes=len(volumes),
            groups=len(groups),
            varying=found._varying,
            media=structures.rows_of(self._scene.fields["media"], volumes),
            spheres=None if self._scene.fields["spheres"] is None else self._scene.fields["spheres"][volumes],
            group_starts=starts,
            group_members=members,
            fluence=structures.rows_of(self._scene.fields["fluence"], groups),
        )
        return found

    def without_features(self) -> "Marcher":
        """The same with one depth sample on a ray, of which networks read nothing."""
        options = replace(self._options, depth_samples=1, fluence=None, most_detail=1)
        lamps = self._lamps and replace(self._lamps, fluence=None)
        return Marcher(self._media, options, self._indices, self._stop, lamps)

    @functools.cached_property
    def _in_lamps_alone(self) -> "Marcher":
        """The same without features and suns."""
        dark = [replace(medium, sun_depths=[]) for medium in self._media]
        options = replace(self._options, depth_samples=1, fluence=None, shadow_maps=None, most_detail=1, suns=None)
        lamps = self._lamps and replace(self._lamps, fluence=None)
        return Marcher(dark, options, self._indices, self._stop, lamps)

    def of_lamp(self, number: int) -> "Marcher":
        """Marches in the light of one lamp alone, without features."""
        whole = self._in_lamps_alone
        assert whole._lamps is not None
        found = copy.copy(whole)
        found._lamps = replace(whole._lamps, lamps=[whole._lamps.lamps[number]], means=[whole._lamps.mean(number)])
        listed = structures.rows_of(whole._scene.fields["lamp_list"], [number])
        found._scene = structures.copied(whole._scene, lamps=1, lamp_list=listed)
        return found

    def __call__(self, rays: RayBatch) -> RaySegment:
        """March rays whose intervals contain all media. Raises Cancelled."""
        return self.march_steps(rays, step_counts(self.boxes, rays))

    def march_steps(self, rays: RayBatch, counts: np.ndarray) -> RaySegment:
        """March rays in counts, int (R,), coarse steps each. Raises Cancelled."""
        count, volumes, most = len(rays.near), len(self._media), self._options.depth_samples
        counts = np.ascontiguousarray(counts, np.int64)
        most *= self._options.most_detail
        batch = structures.Rays(
            rays=count,
            origins=_doubles(rays.origins),
            directions=_doubles(rays.directions),
            near_distance=_doubles(rays.near),
            far_distance=_doubles(rays.far),
            counts=counts,
            eyes=None if rays.eyes is None else np.ascontiguousarray(rays.eyes, np.int64),
            detail=None if rays.detail is None else np.ascontiguousarray(rays.detail, np.int64),
            max_count=int(counts.max(initial=1)),
            stop=self._stop,
        )
        scratch = self._scratch(batch)
        batch.scratch = scratch.ctypes.data
        alpha, depth = np.empty((2, count))
        scattering = len(self._options.scattering)
        optical_depth, single = np.empty((count, volumes)), np.empty((count, volumes, self._suns, scattering))
        sample_scattering = scattering_depth = None
        if self._varying:
            sample_scattering = np.empty((count * most, volumes, scattering), np.float32)
            scattering_depth = np.empty((count, volumes, scattering))
        emission = np.empty((count, self._channels)) if self._emits else None
        samples = np.zeros(count, np.int64)
        distance, weight = np.empty((2, count * most))
        fraction, features = np.empty((count * most, volumes), np.float32), None
        if self._options.fluence is not None:
            features = np.empty((count * most, len(self._groups), self._suns, COLUMNS), np.float32)
        lamps = 0 if self._lamps is None else len(self._lamps.lamps)
        single_of_lamps, lamp_features = np.empty((count, volumes, lamps, scattering)), None
        if self._lamps is not None and self._lamps.fluence is not None:
            lamp_features = np.empty((count * most, len(self._groups), lamps, COLUMNS), np.float32)
        gathered = structures.Gathered(
            alpha=alpha,
            depth=depth,
            optical_depth=optical_depth,
            single_scattering=single,
            lamp_scattering=single_of_lamps,
            scattering_depth=scattering_depth,
            emission=emission,
            sample_counts=samples,
            sample_distance=distance,
            sample_weight=weight,
            sample_fraction=fraction,
            sample_scattering=sample_scattering,
            sample_features=features,
            lamp_features=lamp_features,
        )
        if self._kernels.march(self._scene, batch, gathered) < count:
            raise Cancelled
        end = gathered.samples
        # Copies: most of the arrays may be unused.
        return RaySegment(
            alpha=alpha,
            depth=depth,
            optical_depth=optical_depth,
            single=single,
            sample_ray=np.repeat(np.arange(count), samples),
            sample_distance=distance[:end].copy(),
            sample_weight=weight[:end].copy(),
            sample_fraction=fraction[:end].copy(),
            sample_features=_copied(features, end),
            steps_evaluated=gathered.blocks * STEPS,
            emission=emission,
            lamps=None if self._lamps is None else LampSegment(single_of_lamps, _copied(lamp_features, end)),
            sample_scattering=None if sample_scattering is None else sample_scattering[:end].copy(),
            scattering_depth=scattering_depth,
        )

    def _scratch(self, batch: structures.Shared) -> np.ndarray:
        """Scratch memory of the calling thread, for a batch of rays."""
        size = self._kernels.scratch_bytes(self._scene, batch)
        if getattr(self._local, "scratch", None) is None or len(self._local.scratch) < size:
            self._local.scratch = np.empty(size, np.uint8)
        return self._local.scratch

    def _describe(self, channels: list[int]) -> structures.Shared:
        options, most, lamps = self._options, self._options.depth_samples, self._lamps
        suns = options.suns
        wide, wide_weights = legendre_nodes(MANY)
        nodes, weights = np.zeros((2, most + 1, most))
        for count in possible_counts(most):
            nodes[count, :count], weights[count, :count] = options.quadrature(count)
        starts, members = _listed(self._groups)
        return structures.Scene(
            volumes=len(self._media),
            suns=self._suns,
            groups=len(self._groups),
            channels=len(channels),
            flowing=any(medium.flows for medium in self._media),
            varying=self._varying,
            scattering=len(options.scattering),
            media=describe_media(self._media, channels, options.scattering, lamps is not None),
            spheres=None if suns is None else np.array([medium.sphere for medium in self._media]).reshape(-1, 4),
            sun_directions=None if suns is None else np.ascontiguousarray(suns, np.float64),
            group_starts=starts,
            group_members=members,
            shadow_maps=structures.array_of([_shadow_map(shadow_map) for shadow_map in options.shadow_maps or []]),
            fluence=None if options.fluence is None else _fluences(options.fluence),
            lamps=0 if lamps is None else len(lamps.lamps),
            lamp_list=structures.array_of(
                [_lamp(lamp, self._media, lamps.mean(k)) for k, lamp in enumerate(lamps.lamps)] if lamps else []
            ),
            lamp_fluence=_fluences((lamps and lamps.fluence) or []),
            lamp_radius=lamps.radius if lamps else 0.0,
            brief=BRIEF,
            wide=WIDE,
            wide_count=MANY,
            wide_nodes=0.5 + 0.5 * wide,
            wide_weights=0.5 * wide_weights,
            nodes=nodes,
            node_weights=weights,
            depth_samples=most,
            most_detail=options.most_detail,
            adaptive="faint_rays" in options.optimizations,
            coarse_count=COARSE_COUNT,
            skip_empty="empty_space" in options.optimizations,
            at_start=options.at_start,
            step_thickness=STEP_THICKNESS,
            step_growth=STEP_GROWTH,
            peak_thickness=PEAK_THICKNESS,
            peak_growth=PEAK_GROWTH,
            finest=FINEST,
            behind=optical_depth_behind(options),
            behind_emission=MAX_OPTICAL_DEPTH if "behind_opaque" in options.optimizations else np.inf,
            min_alpha=MIN_ALPHA,
            dark=float(DARK),
            max_tau_sun=MAX_TAU_SUN,
            max_tau_ahead=MAX_TAU_AHEAD,
            scales=np.array(SCALES),
            jitter=np.float64(JITTER),
        )


def _listed(groups: Sequence[Sequence[int]]) -> tuple[np.ndarray, np.ndarray]:
    """Where groups start and end in a list of their members, int64 (G + 1,), and the list."""
    starts = np.cumsum([0, *map(len, groups)]).astype(np.int64)
    return starts, np.array([v for group in groups for v in group], np.int64)


def _doubles(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float64)


def _copied(features: np.ndarray | None, count: int) -> RayFeatures | None:
    return None if features is None else RayFeatures(features[:count].copy())


def _lamp(lamp: PredictedLamp, media: Sequence[BoundMedium], mean: MeanLampDepth | None) -> structures.Shared:
    columns = [depth.described(medium.sigma_t) for depths in lamp.depths for depth, medium in zip(depths, media)]
    pointers = (c_void_p * len(columns))(*map(addressof, columns))
    shadow_maps = [describe_shadow_map(shadow_map) for shadow_map in lamp.shadow_maps or []]
    grid = None if mean is None else describe_grid(mean.grid)
    described = structures.Lamp(
        emitters=len(lamp.emitters),
        parts=structures.array_of([describe_emitter(emitter) for emitter in lamp.emitters]),
        columns=pointers,
        shadow_maps=structures.array_of(shadow_maps),
        centre=np.float64(lamp.centre),
        reach=lamp.reach,
        smooth=lamp.smooth(media),
        mean=grid,
        mean_from=0.0 if mean is None else mean.start,
    )
    described.referenced += [*columns, grid]
    return described


def _phase_table(medium: Medium) -> np.ndarray:
    """Phase function float32 (2, PHASES + 1) by the square root of 1 - |cosine|, forwards and backwards."""
    cosine = 1.0 - (np.arange(structures.PHASES + 1) / structures.PHASES) ** 2
    return np.stack([medium.scattered(cosine), medium.scattered(-cosine)]).astype(np.float32)


def describe_media(
    media: Sequence[BoundMedium], channels: Sequence[int], scattering: Sequence[int], lamps: bool
) -> ctypes.Array | None:
    """An array of media, with their emission in `channels` and their scattering in `scattering`, colour channels by
    number.

    lamps: whether their phase functions are tabulated, for the light of lamps.
    """
    known: dict[Hashable, structures.Shared] = {}

    def once(describe: Callable[..., structures.Shared], what: Any, *more: Hashable) -> structures.Shared:
        """The same for instances, which share what they hold."""
        key = id(what), *more
        if key not in known:
            known[key] = describe(what, *more)
        return known[key]

    # Instances differ in where they lie alone.
    kinds: dict[Hashable, tuple[int, structures.Shared]] = {}
    numbers = []
    for medium in media:
        grid, of = medium.grid, medium.medium
        key: Hashable = (
            (
                id(grid.voxels),
                grid.emission_power,
                medium.sigma_t,
                of.emission,
                lamps and id(of),
                *map(id, medium.sun_depths),
            )
            if medium.motion is None
            else id(medium)
        )
        if key not in kinds:
            kinds[key] = len(kinds), _describe_medium(medium, channels, scattering, lamps, once)
        numbers.append(kinds[key][0])
    return structures.instances_of(
        [described for _, described in kinds.values()],
        numbers,
        linear=np.array([medium.grid.linear for medium in media]),
        offset=np.array([medium.grid.offset for medium in media]),
    )


def _describe_medium(
    medium: BoundMedium, channels: Sequence[int], scattering: Sequence[int], lamps: bool, once: Once
) -> structures.Shared:
    grid = medium.grid
    scattered = [once(describe_grid, grid.scattering_of(channel)) for channel in scattering] if medium.varies else []
    emission = [once(describe_grid, grid.emission[channel]) for channel in channels] if medium.emits else []
    motion = medium.motion
    flow = None if motion is None else motion.flow
    density, occupancy = once(describe_grid, grid.density), once(describe_occupancy, grid.occupancy)
    described = structures.Medium(
        density=density,
        held=grid.density.filled_bits if isinstance(grid.density, DenseGrid) else None,
        occupancy=occupancy,
        suns=structures.array_of([once(_described_depth, depth, medium.sigma_t) for depth in medium.sun_depths]),
        phase=_phase_table(medium.medium) if lamps else None,
        motion=None if motion is None else np.ascontiguousarray(motion.frames, np.float64),
        flow=structures.Flow() if flow is None else flow.described,
        times=None if flow is None else np.ascontiguousarray(flow.times, np.float64),
        support=np.concatenate(medium.box),
        linear=grid.linear,
        offset=grid.offset,
        sigma_t=medium.sigma_t,
        emission=(structures.Grid * structures.CHANNELS)(*emission),
        emission_power=grid.emission_power,
        emission_factor=medium.medium.emission if medium.emits else 0.0,
        varies=medium.varies,
        scattering=(structures.Grid * structures.CHANNELS)(*scattered),
    )
    described.referenced += [density, occupancy, *emission, *scattered]
    return described


def _described_depth(depth: SunOpticalDepth, sigma_t: float) -> structures.Shared:
    return depth.described(sigma_t)


def _shadow_map(shadow_map: ShadowMap) -> structures.Shared:
    heights = np.ascontiguousarray(shadow_map.heights, np.float32)
    return structures.ShadowMap(
        heights=heights,
        rows=heights.shape[0],
        columns=heights.shape[1],
        linear=shadow_map.linear,
        offset=shadow_map.offset,
    )


def _fluences(fluences: Sequence[ScatteredFluence | None]) -> ctypes.Array | None:
    """An array of them; instances share lights."""
    kinds: dict[Hashable, tuple[int, structures.Shared]] = {}
    numbers = []
    for one in fluences:
        key = one and (*map(id, one.lights), *(one.scales or ()), one.anisotropy)
        if key not in kinds:
            kinds[key] = len(kinds), _fluence(one)
        numbers.append(kinds[key][0])
    nowhere = np.zeros((3, 3)), np.zeros(3)
    placed = [(one.linear, one.offset) if one else nowhere for one in fluences]
    return structures.instances_of(
        [described for _, described in kinds.values()],
        numbers,
        linear=np.array([linear for linear, _ in placed]),
        offset=np.array([offset for _, offset in placed]),
        flux_from_world=np.array([one.flux_from_world() if one else nowhere[0] for one in fluences]),
    )


def _fluence(fluence: ScatteredFluence | None) -> structures.Shared:
    if fluence is None:
        return structures.Fluence(reduced_fraction=1.0)
    lights = [np.ascontiguousarray(light, np.float32) for light in fluence.lights]
    cells = len(lights[0]) if lights else 0
    assert all(light.shape == (cells, cells, cells, 4) for light in lights)
    pointers = (c_void_p * len(lights))(*(light.ctypes.data for light in lights))
    described = structures.Fluence(
        lights=pointers,
        scales=None if fluence.scales is None else np.array(fluence.scales, np.float64),
        cells=cells,
        reduced_fraction=fluence.reduced_fraction,
    )
    described.referenced += lights
    return described


def ray_features_at(
    medium: BoundMedium,
    positions: np.ndarray,
    directions: np.ndarray,
    fluence: ScatteredFluence | None,
    lamps: LampMarch | None = None,
) -> RayFeatures:
    """Ray features at world positions (N, 3) for rays along unit directions (N, 3), in one medium alone.

    fluence: of the medium's suns; None where features of lamps are wanted instead.
    """
    _, far = medium.grid.interval(positions, directions)
    far = np.maximum(far, 1e-6 * medium.grid.voxel)
    march = Marcher([medium], MarchOptions(1, [fluence], at_start=True), (), c_int32(0), lamps)
    segment = march(RayBatch(positions, directions, np.zeros(len(positions)), far))
    features = segment.sample_features if segment.lamps is None else segment.lamps.features
    assert features is not None
    return features
