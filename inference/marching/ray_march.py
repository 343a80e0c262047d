# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray marching: transmittance, exact single scattering and depths to sample along camera rays.

Within a step extinction is constant and the optical depth towards the sun linear, so that the integrals over a step are
exact. Blocks of steps, (P, STEPS), are those of `ray_steps`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..numerics.exponential import one_minus_exp
from ..numerics.small_matmul import product
from ..occluders.shadow_map import ShadowMap
from ..scene.optimizations import ALL
from ..transport.scattered_fluence import ScatteredFluence
from .depth_samples import Quadrature, gauss_legendre, sample_opacities
from .ray_features import REACH, RayFeatures, SampleSteps, gather_ray_features
from .ray_steps import (
    STEPS,
    Blocks,
    RayBatch,
    RaySteps,
    blocks_near_density,
    step_counts,
    step_thickness,
    steps_per_voxel,
    sums_within,
)

# Blocks per ray that are evaluated at a time, before rays that have become opaque are dropped.
BLOCKS_PER_ROUND = 1
# Optical depth up to which rays are marched for single scattering: a fraction of 1e-6 is transmitted.
MAX_OPTICAL_DEPTH = 14.0
# Optical thickness of a step above which the part of a ray between entry and opacity is cut again, and how often.
MAX_STEP_THICKNESS = 0.6
REFINEMENTS = 3
# Optical thickness that no step of the part cut out exceeds, and its fewest steps.
REFINED_STEP_THICKNESS, FEWEST_REFINED = 0.2, 32
# Jitter of fluence lookups, in cells: a rank-1 lattice over the steps of a ray.
JITTER = np.array([[0.8191725], [0.6710436], [0.5497005]], np.float32)
# Optical depth that counts as complete shadow.
DARK = np.float32(60.0)


@dataclass(frozen=True)
class MarchOptions:
    """What is gathered along rays.

    depth_samples: of an opaque ray. fluence: ScatteredFluence per group of volumes, None for a group without
    prediction; None altogether if no ray features are wanted. shadow_maps: of each sun, or None if no surface shadows
    volumes. groups: numbers of the volumes that the network treats as one medium, each alone if None. optimizations:
    those in use, as in Settings. quadrature: where depth samples lie in a ray's opacity.
    """

    depth_samples: int
    fluence: list[ScatteredFluence | None] | None = None
    shadow_maps: list[ShadowMap] | None = None
    groups: list[list[int]] | None = None
    optimizations: frozenset[str] = ALL
    quadrature: Quadrature = gauss_legendre


@dataclass(frozen=True)
class RaySegment:
    """What a batch of R rays gathered of V volumes and L suns.

    alpha: (R,). depth: (R,), mean scattering distance. optical_depth: (R, V) of each volume, up to where the ray is
    opaque. single: (R, V, L), single scattering for albedo 1, irradiance 1 and phase function 1. sample_ray: int (M,),
    ray of each depth sample. sample_distance: (M,). sample_weight: (M,), sums to alpha over the samples of a ray.
    sample_fraction: (M, V), share of each volume in the extinction there. sample_features: RayFeatures of the samples,
    or None. steps_evaluated: number of steps, of all rays. emission: (R, C) of the colour channels asked for, or None
    where no volume emits light.
    """

    alpha: np.ndarray
    depth: np.ndarray
    optical_depth: np.ndarray
    single: np.ndarray
    sample_ray: np.ndarray
    sample_distance: np.ndarray
    sample_weight: np.ndarray
    sample_fraction: np.ndarray
    sample_features: RayFeatures | None = None
    steps_evaluated: int = 0
    emission: np.ndarray | None = None


def mean_transmittance(start: np.ndarray | np.float32, end: np.ndarray) -> np.ndarray:
    """Mean of exp(-tau) over a step along which tau varies linearly from start to end, both >= 0."""
    x = np.maximum(np.abs(end - start), np.float32(1e-20))
    return np.exp(-np.minimum(start, end)) * one_minus_exp(x) / x


class _MarchedMedium:
    """The filled blocks of rays, with extinction and optical depth in their steps.

    sigma: float32 (V, P, STEPS), mean extinction of each step, 0 behind opaque parts. total: (P, STEPS), of all
    volumes. tau: (P, STEPS), optical thickness of each step. within: (P, STEPS), optical depth from the block's start
    to each step's end. before: float64 (P,), from the ray's start to the block's.
    """

    def __init__(
        self, media: Sequence[BoundMedium], steps: RaySteps, behind: float, always_first: bool, skip_empty: bool = True
    ):
        blocks = blocks_near_density(media, steps, always_first, skip_empty)
        sigma = extinction(media, steps, blocks, behind)
        filled = (_block_sums(sigma) > 0.0).any(axis=0) | (always_first & (blocks.number == 0)) | (not skip_empty)
        self.steps, self.blocks, self.sigma = steps, blocks.where(filled), sigma[:, filled]
        self.dt = steps.dt[self.blocks.ray][:, None]
        self.total = self.sigma[0] if len(media) == 1 else self.sigma.sum(axis=0)
        self.tau = self.total * self.dt
        self.within = sums_within(self.tau)
        self.before = self.blocks.before(self.within[:, -1])

    def edges(self) -> np.ndarray:
        """Optical depth from the ray's start to the edges of steps, float32 (P, STEPS + 1)."""
        edges = np.zeros((len(self.tau), STEPS + 1), np.float32)
        edges[:, 1:] = self.within
        edges += self.before.astype(np.float32)[:, None]
        return edges

    def dense_interval(self, behind: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances (R,) and (R,) at which rays enter density, and at which they become opaque or end; and the largest
        extinction (R,) in between.
        """
        steps, ray, number = self.steps, self.blocks.ray, self.blocks.steps()
        first, last = np.zeros_like(steps.count), steps.count.copy()
        # From the step in front of the first filled one, because the middle of a step may miss density that begins
        # behind it.
        filled = np.nonzero(self.tau > 0.0)
        first[ray[filled[0]][::-1]] = np.maximum(number[filled][::-1] - 1, 0)
        opaque = np.nonzero(self.before[:, None] + self.within > behind)
        last[ray[opaque[0]][::-1]] = number[opaque][::-1] + 1
        dt = (steps.far - steps.near) / steps.count
        densest = np.zeros(len(first), np.float32)
        np.maximum.at(densest, ray, (self.total * (number < last[ray][:, None])).max(axis=1, initial=0.0))
        far = np.where(last < steps.count, steps.near + last * dt, steps.far)
        return steps.near + first * dt, far, densest


def optical_depth_behind(options: MarchOptions) -> float:
    """Optical depth up to which rays are marched."""
    if "behind_opaque" not in options.optimizations:
        return np.inf
    return MAX_OPTICAL_DEPTH if options.fluence is None else REACH


def refinements(media: Sequence[BoundMedium]) -> int:
    """How often rays are cut again."""
    return REFINEMENTS if step_thickness(media) > MAX_STEP_THICKNESS else 0


def refined_counts(media: Sequence[BoundMedium], rays: RayBatch, count: np.ndarray, densest: np.ndarray) -> np.ndarray:
    """Number of steps int (R,) of rays whose intervals have been cut to where light reaches, at most `count`, (R,).

    densest: (R,), largest extinction in the interval.
    """
    length = rays.far - rays.near
    crossed = [
        np.linalg.norm(product(rays.directions, medium.linear.T), axis=1) * length
        for medium in media
        if medium.sigma_t > 0.0
    ]
    by_voxels, by_thickness = (
        np.max(crossed, axis=0) * steps_per_voxel(media),
        densest * length / REFINED_STEP_THICKNESS,
    )
    wanted = STEPS * np.ceil(np.maximum(by_voxels, by_thickness) / STEPS)
    return np.minimum(np.maximum(wanted, FEWEST_REFINED), count).astype(int)


def march(media: Sequence[BoundMedium], rays: RayBatch, options: MarchOptions) -> RaySegment:
    """March rays, whose intervals contain all media, through all of them."""
    behind = optical_depth_behind(options)
    medium = _cut_into_steps(media, rays, behind, skip_empty="empty_space" in options.optimizations)
    steps, blocks, total, dt = medium.steps, medium.blocks, medium.total, medium.dt
    transmitted = np.exp(-medium.before).astype(np.float32)[:, None] * np.exp(medium.tau - medium.within)
    alpha = -np.expm1(-blocks.sums(medium.within[:, -1]))
    # The middle of a step stands for the mean distance within it.
    scattered = transmitted * one_minus_exp(medium.tau)
    reached = blocks.sums(_block_sums(scattered * (blocks.steps() + np.float32(0.5)).astype(np.float32)))
    depth = steps.near + reached * steps.dt / np.maximum(alpha, 1e-30)

    sun_depths = _sun_depths(media, medium, total > 0.0)
    visibility = _visibility(options.shadow_maps, medium, rays) if options.shadow_maps else None
    single = _single(medium, sun_depths, transmitted, visibility)
    opacities = sample_opacities(
        alpha, options.depth_samples, "faint_rays" in options.optimizations, options.quadrature
    )
    block, step, inside, weight = _sample_depths(medium, *opacities)
    ray = blocks.ray[block]
    fraction = medium.sigma[:, block, step] / np.maximum(total[block, step], np.float32(1e-30))
    features = None
    if options.fluence is not None:
        sigma, depths = _group_sums(medium.sigma, options.groups), _group_sums(sun_depths, options.groups)
        source = _scattered_source(options.fluence, rays, sigma, depths.shape[1], medium)
        samples = SampleSteps(block, step, inside)
        features = gather_ray_features(
            blocks, sigma * dt, depths, source, _reduced_fractions(options.fluence), samples, visibility
        )
    return RaySegment(
        alpha,
        depth,
        np.stack([blocks.sums(_block_sums(sigma * dt)) for sigma in medium.sigma], axis=1),
        single,
        sample_ray=ray,
        sample_distance=steps.near[ray] + (blocks.number[block] * STEPS + step + inside) * steps.dt[ray],
        sample_weight=weight,
        sample_fraction=fraction.T,
        sample_features=features,
        steps_evaluated=blocks.ray.size * STEPS,
    )


def ray_features_at(
    medium: BoundMedium, positions: np.ndarray, directions: np.ndarray, fluence: ScatteredFluence
) -> RayFeatures:
    """Ray features at world positions (N, 3) for rays along unit directions (N, 3), in one medium alone."""
    _, far = medium.grid.interval(positions, directions)
    far = np.maximum(far, 1e-6 * medium.grid.voxel)
    rays = RayBatch(positions, directions, np.zeros(len(positions)), far)
    marched = _cut_into_steps([medium], rays, REACH, always_first=True, refine=False)
    blocks = marched.blocks
    start = np.flatnonzero(blocks.number == 0)
    known = marched.total > 0.0
    known[start, 0] = True
    sun_depths = _sun_depths([medium], marched, known, may_be_outside=True)
    source = _scattered_source([fluence], rays, marched.sigma, sun_depths.shape[1], marched)
    samples = SampleSteps(start, np.zeros(len(positions), int), np.zeros(len(positions)))
    return gather_ray_features(
        blocks, marched.sigma * marched.dt, sun_depths, source, _reduced_fractions([fluence]), samples
    )


def _cut_into_steps(
    media: Sequence[BoundMedium],
    rays: RayBatch,
    behind: float,
    always_first: bool = False,
    refine: bool = True,
    skip_empty: bool = True,
) -> _MarchedMedium:
    """Cut rays into steps, refined where these are too thick, and sample the medium on them.

    behind: optical depth beyond which the medium is not sampled.
    """
    count = step_counts(media, rays)
    for _ in range(refinements(media) if refine else 0):
        steps = RaySteps(media, rays, count)
        near, far, densest = _MarchedMedium(media, steps, behind, always_first).dense_interval(behind)
        rays = RayBatch(rays.origins, rays.directions, near, far)
    if refine and refinements(media):
        count = refined_counts(media, rays, count, densest)
    steps = RaySteps(media, rays, count)
    return _MarchedMedium(media, steps, behind, always_first, skip_empty)


def _block_sums(values: np.ndarray) -> np.ndarray:
    """Sums (..., P) over the steps of each block, (..., P, STEPS); as a product they take a fifth of the time."""
    return product(values, np.ones(STEPS, values.dtype))


def extinction(media: Sequence[BoundMedium], steps: RaySteps, blocks: Blocks, behind: float) -> np.ndarray:
    """Mean extinction (V, P, STEPS) of each step, 0 behind the optical depth `behind` and beyond the ray's end.

    Marches front to back, some blocks of each ray at a time, and drops rays that have become opaque.
    """
    sigma = np.zeros((len(media), len(blocks.ray), STEPS), np.float32)
    tau, rounds = np.zeros(blocks.rays), blocks.rank // BLOCKS_PER_ROUND
    for number in range(rounds.max(initial=-1) + 1):
        now = np.flatnonzero((rounds == number) & (tau[blocks.ray] < behind))
        ray, first = blocks.ray[now], blocks.number[now]
        within = first[:, None] * STEPS + np.arange(STEPS) < steps.count[ray, None]
        for v, medium in enumerate(media):
            sigma[v, now] = steps.mean(medium.grid.sample_density, v, ray, first) * within * np.float32(medium.sigma_t)
        tau += np.bincount(ray, _block_sums(sigma[:, now]).sum(axis=0), blocks.rays) * steps.dt
    return sigma


def _sample_depths(
    medium: _MarchedMedium, ray: np.ndarray, opacity: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Block, step, position in the step and weight, (M,) each, of the samples of `sample_opacities`."""
    blocks = medium.blocks
    # One search in all rays at once: the opacities of ray n lie in [2n, 2n + 1].
    starts = 2.0 * blocks.ray - np.expm1(-medium.before)
    block = np.searchsorted(starts, opacity + 2.0 * ray, side="right") - 1
    # Invert the exponential, then find the step within the block.
    wanted = -np.log1p(-np.minimum(opacity, 1.0 - 1e-12)) - medium.before[block]
    step = (medium.within[block] <= wanted[:, None]).sum(axis=1)
    last = STEPS - 1 - (medium.tau[:, ::-1] > 0.0).argmax(axis=1)
    step = np.minimum(step, last[block])
    tau = medium.tau[block, step]
    inside = (wanted - (medium.within[block, step] - tau)) / np.maximum(tau, np.float32(1e-30))
    return block, step, np.clip(inside, 0.0, 1.0), weight


def _sun_depths(
    media: Sequence[BoundMedium], medium: _MarchedMedium, filled: np.ndarray, may_be_outside: bool = False
) -> np.ndarray:
    """Optical depth (V, L, P, STEPS + 1) through each volume towards each sun, at both ends of filled steps.

    filled: bool (P, STEPS).
    """
    volumes, suns = len(media), len(media[0].sun_depths)
    ends = np.zeros((len(filled), STEPS + 1), bool)
    ends[:, :-1] |= filled
    ends[:, 1:] |= filled
    # Depths at the joint of two consecutive blocks are looked up once.
    joint = np.flatnonzero(medium.blocks.followed() & ends[:, -1])
    ends[joint + 1, 0], ends[joint, -1] = True, False
    edge = np.flatnonzero(ends)
    camera_depth = medium.edges().reshape(-1)[edge]
    ray = np.repeat(medium.blocks.ray, STEPS + 1)[edge]
    step = medium.blocks.steps(edges=True).reshape(-1)[edge]
    depths = np.full((volumes, suns, *ends.shape), DARK, np.float32)
    for v, bound in enumerate(media):
        position = medium.steps.index(v, ray, step)
        for l in range(suns):
            depths[v, l].reshape(-1)[edge] = bound.sun_optical_depth(
                position, l, may_be_outside or volumes > 1, camera_depth
            )
    depths[:, :, joint, -1] = depths[:, :, joint + 1, 0]
    return depths


def _group_sums(values: np.ndarray, groups: list[list[int]] | None) -> np.ndarray:
    """Sums (G, ...) over groups of volumes of values (V, ...)."""
    if groups is None or groups == [[v] for v in range(len(values))]:
        return values
    return np.stack([values[group].sum(axis=0) for group in groups])


def _reduced_fractions(fluence: Sequence[ScatteredFluence | None]) -> list[float]:
    """Reduced fraction of scattering of each group; arbitrary for groups without prediction."""
    return [1.0 if one is None else one.reduced_fraction for one in fluence]


def _scattered_source(
    fluence: Sequence[ScatteredFluence | None], rays: RayBatch, sigma: np.ndarray, suns: int, medium: _MarchedMedium
) -> np.ndarray:
    """4 pi times the scattered light of each sun that scatters towards the camera: (G, L, P, STEPS).

    Taken at the middle of each filled step; 0 for groups without prediction. sigma: (G, P, STEPS), extinction of each
    group.
    """
    steps = medium.steps
    # The intervals of refined rays are those of their steps.
    cut = RayBatch(rays.origins, rays.directions, steps.near, steps.far)
    frames = RaySteps([one for one in fluence if one is not None], cut, steps.count)
    source = np.zeros((len(fluence), suns, *medium.total.shape), np.float32)
    ray, step = medium.blocks.ray, medium.blocks.steps()
    known = 0
    for v, one in enumerate(fluence):
        if one is None:
            continue
        filled = np.flatnonzero(sigma[v])
        number = step.reshape(-1)[filled]
        ray_of = np.repeat(ray, STEPS)[filled]
        indices = frames.index(known, ray_of, number + np.float32(0.5))
        # Jittered from step to step, so that neighbouring rays do not enter a cell at the same step, which would be
        # visible.
        jitter = number.astype(np.float32) * JITTER
        indices += jitter - np.floor(jitter) - np.float32(0.5)
        cells, towards = one.cells(indices), one.towards(rays.directions).take(ray_of, axis=0)
        for l, values in enumerate(one.lights):
            found = np.einsum("nk,nk->n", values.reshape(-1, 4).take(cells, axis=0).astype(np.float32), towards)
            source[v, l].reshape(-1)[filled] = np.maximum(found, np.float32(0.0))
        known += 1
    return source


def _visibility(shadow_maps: Sequence[ShadowMap], medium: _MarchedMedium, rays: RayBatch) -> np.ndarray:
    """Visibility of each sun (L, P, STEPS) at the middle of each filled step."""
    steps = medium.steps
    frames = RaySteps(shadow_maps, RayBatch(rays.origins, rays.directions, steps.near, steps.far), steps.count)
    filled = np.flatnonzero(medium.total)
    ray = np.repeat(medium.blocks.ray, STEPS)[filled]
    step = medium.blocks.steps().reshape(-1)[filled] + np.float32(0.5)
    visibility = np.ones((len(shadow_maps), *medium.total.shape), np.float32)
    for l, shadow_map in enumerate(shadow_maps):
        visibility[l].reshape(-1)[filled] = shadow_map.visibility(frames.index(l, ray, step))
    return visibility


def _single(
    medium: _MarchedMedium, sun_depths: np.ndarray, transmitted: np.ndarray, visibility: np.ndarray | None
) -> np.ndarray:
    """Single scattering (R, V, L) by volume and sun, for albedo, irradiance and phase function 1."""
    volumes, suns = sun_depths.shape[:2]
    single = np.zeros((medium.blocks.rays, volumes, suns))
    # Integral over a step of exp(-tau to the camera - tau to the sun).
    for l in range(suns):
        depth = sun_depths[:, l].sum(axis=0) if volumes > 1 else sun_depths[0, l]
        light = transmitted * mean_transmittance(depth[:, :-1], depth[:, 1:] + medium.tau) * medium.dt
        if visibility is not None:
            light *= visibility[l]
        for v in range(volumes):
            single[:, v, l] = medium.blocks.sums(_block_sums(medium.sigma[v] * light))
    return single
