# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays through volumes, many at a time, as `kernels/march.c` marches them one after another."""

import functools
from collections.abc import Sequence

import numpy as np

from inference.grids.bound_medium import BoundMedium
from inference.grids.grid import Grid
from inference.marching.depth_samples import COARSE_COUNT, MIN_ALPHA, Quadrature, divided, gauss_legendre
from inference.marching.ray_march import DARK, JITTER, MAX_OPTICAL_DEPTH, MarchOptions, RaySegment, optical_depth_behind
from inference.marching.ray_steps import STEPS, RayBatch
from inference.numerics.exponential import one_minus_exp
from inference.numerics.small_matmul import product
from inference.occluders.shadow_map import ShadowMap
from inference.scene.optimizations import ALL
from inference.transport.discrete_ordinates import CELLS
from inference.transport.scattered_fluence import ScatteredFluence

from .ray_features import SampleSteps, gather_ray_features
from .ray_steps import Blocks, Cutting, RayLines, cut_into_blocks, mean_visibility, met_volumes, sums_within
from .sun_columns import sun_optical_depth

# Further from 0 than any number of a step, and still a whole number in single precision.
FAR_AWAY = np.float32(2.0**30)


def mean_transmittance(start: np.ndarray | np.float32, end: np.ndarray) -> np.ndarray:
    """Mean of exp(-tau) over a step along which tau varies linearly from start to end, both >= 0."""
    x = np.maximum(np.abs(end - start), np.float32(1e-20))
    return np.exp(-np.minimum(start, end)) * one_minus_exp(x) / x


class MarchedMedium:
    """The filled blocks of rays, with extinction and optical depth in their steps.

    sigma: float32 (V, P, STEPS), mean extinction of each step. dt: (P, 1), length of steps. total: (P, STEPS), of all
    volumes. tau: (P, STEPS), optical thickness of each step. within: (P, STEPS), optical depth from the block's start
    to each step's end. before: float64 (P,), from the ray's start to the block's.
    """

    def __init__(self, media: Sequence[BoundMedium], rays: RayBatch, cutting: Cutting):
        self.lines, self.blocks, self.sigma = cut_into_blocks(media, rays, cutting)
        self.dt = (self.lines.dt[self.blocks.ray] * self.blocks.size).astype(np.float32)[:, None]
        self.total = self.sigma.sum(axis=0)
        self.tau = self.total * self.dt
        self.within = sums_within(self.tau)
        self.before = self.blocks.before(self.within[:, -1])

    def scattering(self, media: Sequence[BoundMedium], channel: int) -> np.ndarray:
        """Scattering coefficient of steps in a colour channel, float32 (V, P, STEPS): the extinction, for albedo 1, in
        volumes whose albedo does not vary."""
        found = self.sigma
        inside = self.blocks.steps(0.0) < self.lines.count[self.blocks.ray, None]
        for v, medium in enumerate(media):
            if medium.varies:
                mean = self.lines.mean(medium.grid.scattering_of(channel).sample, v, self.blocks)
                found = found.copy() if found is self.sigma else found
                # Nothing scatters where interpolation in single precision leaves no density.
                found[v] = np.minimum(mean * inside * np.float32(medium.sigma_t), self.sigma[v])
        return found

    def edges(self) -> np.ndarray:
        """Optical depth from the ray's start to the edges of steps, float32 (P, STEPS + 1)."""
        edges = np.zeros((len(self.tau), STEPS + 1), np.float32)
        edges[:, 1:] = self.within
        edges += self.before.astype(np.float32)[:, None]
        return edges


def march(media: Sequence[BoundMedium], rays: RayBatch, options: MarchOptions, lamps: bool = False) -> RaySegment:
    """March rays, whose intervals contain all media, through all of them; lamps: whether there are any."""
    skip_empty = "empty_space" in options.optimizations
    cutting = Cutting(optical_depth_behind(options), skip_empty=skip_empty, everywhere=lamps)
    medium = MarchedMedium(media, rays, cutting)
    lines, blocks, total, dt = medium.lines, medium.blocks, medium.total, medium.dt
    transmitted = np.exp(-medium.before).astype(np.float32)[:, None] * np.exp(medium.tau - medium.within)
    alpha = -np.expm1(-blocks.sums(medium.within[:, -1]))
    # The middle of a step stands for the mean distance within it.
    scattered = transmitted * one_minus_exp(medium.tau)
    reached = blocks.sums(block_sums(scattered * blocks.steps(0.5).astype(np.float32)))
    depth = lines.near + reached * lines.dt / np.maximum(alpha, 1e-30)

    sun_depths = _sun_depths(media, medium, total > 0.0)
    visibility = _visibility(options.shadow_maps, medium, rays) if options.shadow_maps else None
    varies = any(bound.varies for bound in media)
    scattering = [medium.scattering(media, channel) for channel in options.scattering]
    single = _single(medium, sun_depths, transmitted, visibility, scattering)
    opacities = sample_opacities(
        alpha, options.depth_samples, "faint_rays" in options.optimizations, options.quadrature, rays.detail
    )
    block, step, inside, weight = _sample_depths(medium, *opacities)
    ray = blocks.ray[block]
    fraction = medium.sigma[:, block, step] / np.maximum(total[block, step], np.float32(1e-30))
    sample_scattering = scattering_depth = None
    if varies:
        some = np.stack([sigma[:, block, step] for sigma in scattering])
        sample_scattering = (some / np.maximum(total[block, step], np.float32(1e-30))).T
        scattering_depth = np.stack([_depths(blocks, sigma, dt) for sigma in scattering], axis=2)
    features = None
    if options.fluence is not None:
        sigma, depths = group_sums(medium.sigma, options.groups), group_sums(sun_depths, options.groups)
        source = scattered_source(options.fluence, rays, sigma, depths.shape[1], medium)
        samples = SampleSteps(block, step, inside)
        features = gather_ray_features(
            blocks, sigma * dt, depths, source, reduced_fractions(options.fluence), samples, visibility
        )
        if not lamps:
            met = met_volumes(media, rays)[ray]
            for g, group in enumerate(options.groups or [[v] for v in range(len(media))]):
                features.values[~met[:, group].any(axis=1), g] = 0.0
    return RaySegment(
        alpha,
        depth,
        _depths(blocks, medium.sigma, dt),
        single,
        sample_ray=ray,
        sample_distance=lines.near[ray] + (blocks.place[block] + (step + inside) * blocks.size[block]) * lines.dt[ray],
        sample_weight=weight,
        sample_fraction=fraction.T,
        sample_features=features,
        steps_evaluated=blocks.looked_at * STEPS,
        sample_scattering=sample_scattering,
        scattering_depth=scattering_depth,
    )


def _depths(blocks: Blocks, sigma: np.ndarray, dt: np.ndarray) -> np.ndarray:
    """Optical depth (R, V) of rays; sigma: (V, P, STEPS), dt: (P, 1)."""
    return np.stack([blocks.sums(block_sums(one * dt)) for one in sigma], axis=1)


def block_sums(values: np.ndarray) -> np.ndarray:
    """Sums (..., P) over the steps of each block, (..., P, STEPS); as a product they take a fifth of the time."""
    return product(values, np.ones(STEPS, values.dtype))


def _sample_depths(
    medium: MarchedMedium, ray: np.ndarray, opacity: np.ndarray, weight: np.ndarray
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
    media: Sequence[BoundMedium], medium: MarchedMedium, filled: np.ndarray, may_be_outside: bool = False
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
    place = medium.blocks.edges().reshape(-1)[edge]
    depths = np.full((volumes, suns, *ends.shape), DARK, np.float32)
    for v, bound in enumerate(media):
        position = medium.lines.index(v, ray, place)
        for l in range(suns):
            depths[v, l].reshape(-1)[edge] = sun_optical_depth(
                bound, position, l, may_be_outside or volumes > 1, camera_depth
            )
    depths[:, :, joint, -1] = depths[:, :, joint + 1, 0]
    return depths


def group_sums(values: np.ndarray, groups: list[list[int]] | None) -> np.ndarray:
    """Sums (G, ...) over groups of volumes of values (V, ...)."""
    if groups is None or groups == [[v] for v in range(len(values))]:
        return values
    return np.stack([values[group].sum(axis=0) for group in groups])


def reduced_fractions(fluence: Sequence[ScatteredFluence | None]) -> list[float]:
    """Reduced fraction of scattering of each group; arbitrary for groups without prediction."""
    return [1.0 if one is None else one.reduced_fraction for one in fluence]


def weights_towards(fluence: ScatteredFluence, directions: np.ndarray) -> np.ndarray:
    """Weights float32 (R, 4) of fluence and flux in the light scattered against rays, phi - 3 G' F . omega.

    directions: (R, 3) of the rays in the world.
    """
    flux = directions @ fluence.flux_from_world().T
    return np.concatenate([np.ones((len(flux), 1)), flux], axis=1).astype(np.float32)


def cells_at(fluence: ScatteredFluence, index: np.ndarray) -> np.ndarray:
    """Flat cell numbers (N,) in the lights, at indices float32 (3, N)."""
    n = len(fluence.lights[0]) if fluence.lights else CELLS
    x, y, z = np.clip(index, np.float32(0.0), np.float32(n - 1)).astype(np.int32)
    return (x * np.intp(n) + y) * np.intp(n) + z


def scattered_source(
    fluence: Sequence[ScatteredFluence | None], rays: RayBatch, sigma: np.ndarray, suns: int, medium: MarchedMedium
) -> np.ndarray:
    """4 pi times the scattered light of each sun that scatters towards the camera: (G, L, P, STEPS).

    Taken at the middle of each filled step; 0 for groups without prediction. sigma: (G, P, STEPS), extinction of each
    group.
    """
    lines = RayLines([one for one in fluence if one is not None], rays, medium.lines.count)
    source = np.zeros((len(fluence), suns, *medium.total.shape), np.float32)
    ray, blocks, known = medium.blocks.ray, medium.blocks, 0
    for v, one in enumerate(fluence):
        if one is None:
            continue
        filled = np.flatnonzero(sigma[v])
        # Number of each step on a ray that consists of such steps alone.
        number = (blocks.steps(0.0) / blocks.size[:, None]).reshape(-1)[filled]
        ray_of = np.repeat(ray, STEPS)[filled]
        indices = lines.index(known, ray_of, blocks.steps(0.5).reshape(-1)[filled])
        # Jittered from step to step, so that neighbouring rays do not enter a cell at the same step, which would be
        # visible.
        jitter = np.clip(number.astype(np.float32) * JITTER, 0.0, FAR_AWAY)
        indices += jitter - np.floor(jitter) - np.float32(0.5)
        cells, towards = cells_at(one, indices), weights_towards(one, rays.directions).take(ray_of, axis=0)
        for l, values in enumerate(one.lights):
            found = np.einsum("nk,nk->n", values.reshape(-1, 4).take(cells, axis=0).astype(np.float32), towards)
            scale = np.float32(1.0 if one.scales is None else one.scales[l])
            source[v, l].reshape(-1)[filled] = np.maximum(found, np.float32(0.0)) * scale
        known += 1
    return source


def _visibility(shadow_maps: Sequence[ShadowMap], medium: MarchedMedium, rays: RayBatch) -> np.ndarray:
    """Visibility of each sun (L, P, STEPS) in each filled step."""
    lines, blocks = RayLines(shadow_maps, rays, medium.lines.count), medium.blocks
    filled = medium.total > 0.0
    ray, steps = np.repeat(blocks.ray, STEPS)[filled.ravel()], np.flatnonzero(filled)
    visibility = np.ones((len(shadow_maps), *medium.total.shape), np.float32)
    for l, shadow_map in enumerate(shadow_maps):

        def visible_at(some: np.ndarray, part: float) -> np.ndarray:
            return shadow_map.visibility(lines.index(l, ray[some], blocks.steps(part).ravel()[steps[some]]))

        visibility[l][filled] = mean_visibility(visible_at, blocks, filled)
    return visibility


def _single(
    medium: MarchedMedium,
    sun_depths: np.ndarray,
    transmitted: np.ndarray,
    visibility: np.ndarray | None,
    scattering: Sequence[np.ndarray],
) -> np.ndarray:
    """Single scattering (R, V, L, S) by volume, sun and colour channel, for irradiance and phase function 1.

    scattering: scattering coefficients (V, P, STEPS) of S colour channels.
    """
    volumes, suns = sun_depths.shape[:2]
    single = np.zeros((medium.blocks.rays, volumes, suns, len(scattering)))
    # Integral over a step of exp(-tau to the camera - tau to the sun).
    for l in range(suns):
        depth = sun_depths[:, l].sum(axis=0) if volumes > 1 else sun_depths[0, l]
        light = transmitted * mean_transmittance(depth[:, :-1], depth[:, 1:] + medium.tau) * medium.dt
        if visibility is not None:
            light *= visibility[l]
        for s, sigma in enumerate(scattering):
            for v in range(volumes):
                single[:, v, l, s] = medium.blocks.sums(block_sums(sigma[v] * light))
    return single


def sample_counts(alpha: np.ndarray, most: int, adaptive: bool = True) -> np.ndarray:
    """Number of depths int (R,) of rays of opacity alpha (R,): `most`, or fewer for faint rays if `adaptive`."""
    if not adaptive:
        return np.where(alpha > 0.0, most, 0)
    counts = np.ceil(most * np.sqrt(alpha)).astype(int)
    counts = np.where(counts > COARSE_COUNT, -(-counts // COARSE_COUNT) * COARSE_COUNT, counts)
    # The error cannot be estimated from a single sample.
    return np.where(alpha > MIN_ALPHA, np.clip(counts, min(2, most), most), 0)


def sample_opacities(
    alpha: np.ndarray,
    most: int,
    adaptive: bool = True,
    quadrature: Quadrature = gauss_legendre,
    detail: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions of depth samples: ray int (M,), opacity between the ray's start and the sample (M,), and weight (M,).

    alpha: (R,), opacity of each ray, to which the weights of its samples sum. most, adaptive: as for `sample_counts`.
    detail: int (R,), as of RayBatch.
    """
    if detail is not None:
        return _detailed_opacities(alpha, sample_counts(alpha, most, adaptive), quadrature, detail)
    counts = sample_counts(alpha, most, adaptive)
    ray = np.repeat(np.arange(len(alpha)), counts)
    number = np.arange(len(ray)) - np.repeat(np.cumsum(counts) - counts, counts)
    nodes, weights = np.zeros((2, most + 1, most))
    for count in np.unique(counts[counts > 0]):
        nodes[count, :count], weights[count, :count] = quadrature(count)
    count = counts[ray]
    return ray, nodes[count, number] * alpha[ray], weights[count, number] * alpha[ray]


def _detailed_opacities(
    alpha: np.ndarray, counts: np.ndarray, quadrature: Quadrature, detail: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `sample_opacities`; counts: int (R,), of samples without detail."""
    ray = np.repeat(np.arange(len(alpha)), counts * detail)
    starts, (opacity, weight) = np.cumsum(counts * detail) - counts * detail, np.zeros((2, len(ray)))
    for count, parts in np.unique(np.stack([counts, detail], axis=1)[counts > 0], axis=0):
        nodes, weights, _ = divided(quadrature(int(count)), int(parts))
        rays = np.flatnonzero((counts == count) & (detail == parts))
        samples = starts[rays, None] + np.arange(len(nodes))
        opacity[samples], weight[samples] = alpha[rays, None] * nodes, alpha[rays, None] * weights
    return ray, opacity, weight


def emitted_radiance(
    media: Sequence[BoundMedium],
    rays: RayBatch,
    channels: Sequence[int],
    optimizations: frozenset[str] = ALL,
    lamps: bool = False,
) -> np.ndarray | None:
    """Emitted radiance (R, C) along rays in C colour channels, the integral of T(t) e(x(t)) dt; None if nothing emits.

    T is the transmittance through all media and e their emission; extinction and emission are constant within a step.
    rays: with intervals that contain all media. optimizations: those in use, as in Settings.
    lamps: whether there are any.
    """
    emitting = [v for v, medium in enumerate(media) if medium.emits]
    if not emitting:
        return None
    behind = MAX_OPTICAL_DEPTH if "behind_opaque" in optimizations else np.inf
    cutting = Cutting(behind, skip_empty="empty_space" in optimizations, keep_empty=True, everywhere=lamps)
    lines, blocks, sigma = cut_into_blocks(media, rays, cutting)
    # Transmittance to each step, averaged over the step, times the length of the step.
    dt = (lines.dt[blocks.ray] * blocks.size).astype(np.float32)[:, None]
    tau = sigma.sum(axis=0) * dt
    within = sums_within(tau)
    before = blocks.before(within[:, -1])[:, None]
    through = np.exp(-before - (within - tau)) * mean_transmittance(np.float32(0.0), tau) * dt
    through *= blocks.steps(0.0) < lines.count[blocks.ray][:, None]
    radiance = np.zeros((blocks.rays, len(channels)))
    for v in emitting:
        for number, channel in enumerate(channels):
            sample = functools.partial(sample_emission, media[v].grid, channel)
            emission = lines.mean(sample, v, blocks)
            radiance[:, number] += media[v].medium.emission * blocks.sums((emission * through).sum(axis=1))
    return radiance


def sample_emission(grid: Grid, channel: int, index: np.ndarray) -> np.ndarray:
    """Emission (N,) of a colour channel at continuous indices float32 (3, N)."""
    values = grid.emission[channel].sample(index)
    return values if grid.emission_power == 1 else values * np.abs(values) ** (grid.emission_power - 1)
