"""Along camera rays: transmittance, exact single scattering and depths to sample.

Within a step extinction is constant and the optical depth towards the sun linear, so that
the integrals over a step are exact. Blocks of steps, (P, STEPS), are those of `ray_steps`.
"""

from dataclasses import dataclass
from typing import FrozenSet, List, Optional

import numpy as np

from .depth_samples import sample_opacities
from .diffused_light import DiffusedLight
from .exponential import one_minus_exp
from .grid import Grid
from .omissions import ALL
from .products import product
from .ray_light import REACH, RayLight, ray_light
from .ray_steps import STEPS, Blocks, RaySteps, blocks_near_density, step_counts, step_thickness, sums_within
from .sun_map import SunMap

# Blocks a ray that are looked up at a time, before rays that have become opaque are left.
BLOCKS_A_ROUND = 4
# Optical depth beyond which a ray is not followed for single scattering: 1 part in 10^6 of it goes on.
BEHIND = 14.0
# Optical depth of the thickest step above which the part of a ray that light reaches is cut again, so many times.
STIFF = 0.6
REFINEMENTS = 3
# Steps look up the diffused light at places of a rank-1 lattice around their own, in cells.
SCATTER = np.array([[0.8191725], [0.6710436], [0.5497005]], np.float32)
# Optical depth that counts as no light at all.
OPAQUE = np.float32(60.0)

@dataclass
class RaySegment:
    """What a ray bundle met.

    alpha: (R,); depth: (R,) mean scattering distance; through: (R, V) optical depth of each volume, of what is not
    behind opaque parts; single: (R, V, L) single scattering
    by volume and sun for albedo 1, irradiance 1 and phase function 1.
    sample_ray: int (M,) ray of each depth sample; sample_distance: (M,); sample_weight: (M,)
    sums to alpha over a ray's samples; sample_fraction: (M, V) share of each volume in
    the extinction there. sample_light: what networks that look along the ray need, or None. steps_looked_at: of all rays.
    """

    alpha: np.ndarray
    depth: np.ndarray
    through: np.ndarray
    single: np.ndarray
    sample_ray: np.ndarray
    sample_distance: np.ndarray
    sample_weight: np.ndarray
    sample_fraction: np.ndarray
    sample_light: Optional[RayLight] = None
    steps_looked_at: int = 0


def mean_transmittance(start, end):
    """Mean of exp(-tau) over a step along which tau goes linearly from start to end, both >= 0."""
    x = np.maximum(np.abs(end - start), np.float32(1e-20))
    return np.exp(-np.minimum(start, end)) * one_minus_exp(x) / x


class _Medium:
    """What rays meet: the filled blocks of their steps, and extinction and optical depth in them.

    sigma: float32 (V, P, STEPS) mean extinction of each step, 0 behind what is opaque; total: (P, STEPS), of all
    volumes; tau: (P, STEPS) optical depth of each step; within: (P, STEPS) from the block's start to each step's end;
    before: float64 (P,) from the ray's start to the block's.
    """

    def __init__(self, grids, sigma_t, steps: RaySteps, behind: float, always_first: bool, skip_empty: bool = True):
        blocks = blocks_near_density(grids, steps, always_first, skip_empty)
        sigma = extinction(grids, sigma_t, steps, blocks, behind)
        filled = (_of_blocks(sigma) > 0.0).any(axis=0) | (always_first & (blocks.number == 0)) | (not skip_empty)
        self.steps, self.blocks, self.sigma = steps, blocks.where(filled), sigma[:, filled]
        self.dt = steps.dt[self.blocks.ray][:, None]
        self.total = self.sigma[0] if len(grids) == 1 else self.sigma.sum(axis=0)
        self.tau = self.total * self.dt
        self.within = sums_within(self.tau)
        self.before = self.blocks.before(self.within[:, -1])

    def edges(self) -> np.ndarray:
        """float32 (P, STEPS + 1): optical depth from the ray's start to the steps' ends."""
        edges = np.zeros((len(self.tau), STEPS + 1), np.float32)
        edges[:, 1:] = self.within
        edges += self.before.astype(np.float32)[:, None]
        return edges

    def lit_part(self, behind: float):
        """Where rays begin to be dimmed and where they are opaque, or else end: distances (R,) and (R,)."""
        steps, ray, number = self.steps, self.blocks.ray, self.blocks.steps()
        first, last = np.zeros_like(steps.count), steps.count.copy()
        # Of each ray the first that is filled, but a step's middle may miss what begins behind it.
        filled = np.nonzero(self.tau > 0.0)
        first[ray[filled[0]][::-1]] = np.maximum(number[filled][::-1] - 1, 0)
        opaque = np.nonzero(self.before[:, None] + self.within > behind)
        last[ray[opaque[0]][::-1]] = number[opaque][::-1] + 1
        dt = (steps.far - steps.near) / steps.count
        return steps.near + first * dt, np.where(last < steps.count, steps.near + last * dt, steps.far)


def march(
    grids: List[Grid], sigma_t, origins, directions, near, far, depth_samples: int,
    diffused: Optional[List[Optional[DiffusedLight]]] = None, sun_maps: Optional[List[SunMap]] = None, groups=None,
    leave_out: FrozenSet[str] = ALL,
) -> RaySegment:
    """March rays through all grids.

    grids: with this extinction set; sigma_t: (V,) extinction per unit density of each, one
    colour channel; origins, directions: float64 (R, 3); near, far: (R,) interval that holds all
    grids; depth_samples: of an opaque ray; diffused: of each group, for `sample_light`, or None where that is not
    wanted; a group's is None where nothing is predicted in it; sun_maps: of each sun, where surfaces shade; groups: lists
    of numbers of volumes that networks see as one, each alone where None; leave_out: as in Settings.
    """
    behind = BEHIND if diffused is None else REACH
    if "behind_opaque" not in leave_out:
        behind = np.inf
    medium = _cut(grids, sigma_t, origins, directions, near, far, behind, skip_empty="empty_space" in leave_out)
    steps, blocks, total, dt = medium.steps, medium.blocks, medium.total, medium.dt
    transmitted = np.exp(-medium.before).astype(np.float32)[:, None] * np.exp(medium.tau - medium.within)
    alpha = -np.expm1(-blocks.sums(medium.within[:, -1]))
    # Mean distance within a step is left at its middle.
    scattered = transmitted * one_minus_exp(medium.tau)
    reached = blocks.sums(_of_blocks(scattered * (blocks.steps() + np.float32(0.5)).astype(np.float32)))
    depth = steps.near + reached * steps.dt / np.maximum(alpha, 1e-30)

    shadows = _shadows(grids, medium, total > 0.0)
    lit = _lit(sun_maps, medium, origins, directions) if sun_maps else None
    single = _single(medium, shadows, transmitted, lit)
    block, step, inside, weight = _sample_depths(medium, alpha, depth_samples, "faint_rays" in leave_out)
    ray = blocks.ray[block]
    fraction = medium.sigma[:, block, step] / np.maximum(total[block, step], np.float32(1e-30))
    light = None
    if diffused is not None:
        frames = _frames(diffused, origins, directions, steps)
        sigma, shadows = _together(medium.sigma, groups), _together(shadows, groups)
        scattered = _scattered(diffused, frames, directions, sigma, shadows.shape[1], medium)
        light = ray_light(blocks, sigma, shadows, scattered, _turning(diffused), dt, block, step, inside, lit)
    return RaySegment(
        alpha,
        depth,
        np.stack([blocks.sums(_of_blocks(sigma * dt)) for sigma in medium.sigma], axis=1),
        single,
        sample_ray=ray,
        sample_distance=steps.near[ray] + (blocks.number[block] * STEPS + step + inside) * steps.dt[ray],
        sample_weight=weight,
        sample_fraction=fraction.T,
        sample_light=light,
        steps_looked_at=blocks.ray.size * STEPS,
    )


def light_at(grid: Grid, sigma_t: float, positions, directions, diffused: DiffusedLight) -> RayLight:
    """What a network sees along rays that begin at world positions (N, 3), in one grid with its extinction set."""
    _, far = grid.interval(positions, directions)
    near, nothing = np.zeros(len(positions)), np.zeros(len(positions), int)
    far = np.maximum(far, 1e-6 * grid.voxel)
    medium = _cut([grid], [sigma_t], positions, directions, near, far, REACH, always_first=True, refinements=0)
    blocks = medium.blocks
    start = np.flatnonzero(blocks.number == 0)
    known = medium.total > 0.0
    known[start, 0] = True
    shadows = _shadows([grid], medium, known, may_be_outside=True)
    frames = _frames([diffused], positions, directions, medium.steps)
    scattered = _scattered([diffused], frames, directions, medium.sigma, shadows.shape[1], medium)
    turning, inside = _turning([diffused]), np.zeros(len(positions))
    return ray_light(blocks, medium.sigma, shadows, scattered, turning, medium.dt, start, nothing, inside)


def _cut(
    grids, sigma_t, origins, directions, near, far, behind: float, always_first=False, refinements=REFINEMENTS,
    skip_empty=True,
) -> _Medium:
    """Rays cut into steps, finer where they are too thick, and the medium on them up to the optical depth `behind`."""
    count = step_counts(grids, sigma_t, directions, near, far)
    stiff = step_thickness(grids, sigma_t) > STIFF
    for _ in range(refinements if stiff else 0):
        steps = RaySteps(grids, origins, directions, near, far, count)
        near, far = _Medium(grids, sigma_t, steps, behind, always_first).lit_part(behind)
    steps = RaySteps(grids, origins, directions, near, far, count)
    return _Medium(grids, sigma_t, steps, behind, always_first, skip_empty)


def _of_blocks(values: np.ndarray) -> np.ndarray:
    """(..., P): sums over the steps of each block, (..., P, STEPS); as a product they cost a fifth."""
    return product(values, np.ones(STEPS, values.dtype))


def extinction(grids, sigma_t, steps: RaySteps, blocks: Blocks, behind: float) -> np.ndarray:
    """Mean extinction (V, P, STEPS) of each step, 0 behind what is opaque and beyond the ray's end.

    Goes front to back, some blocks of each ray at a time, with the rays that still see through.
    """
    sigma = np.zeros((len(grids), len(blocks.ray), STEPS), np.float32)
    tau, rounds = np.zeros(blocks.rays), blocks.rank // BLOCKS_A_ROUND
    for number in range(rounds.max(initial=-1) + 1):
        now = np.flatnonzero((rounds == number) & (tau[blocks.ray] < behind))
        ray, first = blocks.ray[now], blocks.number[now]
        within = first[:, None] * STEPS + np.arange(STEPS) < steps.count[ray, None]
        for v, grid in enumerate(grids):
            sigma[v, now] = steps.mean(grid.sample_density, v, ray, first) * within * np.float32(sigma_t[v])
        tau += np.bincount(ray, _of_blocks(sigma[:, now]).sum(axis=0), blocks.rays) * steps.dt
    return sigma


def _sample_depths(medium: _Medium, alpha, most: int, thin_faint: bool):
    """Depths at Gauss's places in the rays' opacity: block, step, place within the step and weight, (M,) each."""
    blocks = medium.blocks
    ray, opacity, weight = sample_opacities(alpha, most, thin_faint)
    # One search in all rays at once: the n-th ray's opacities lie in [2n, 2n + 1].
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


def _shadows(grids, medium: _Medium, filled, may_be_outside: bool = False) -> np.ndarray:
    """(V, L, P, STEPS + 1) optical depth through each volume towards each sun, at both ends of filled steps."""
    volumes, suns = len(grids), len(grids[0].sun_depths)
    ends = np.zeros((len(filled), STEPS + 1), bool)
    ends[:, :-1] |= filled
    ends[:, 1:] |= filled
    # Where a block ends and the next one begins, light is asked for once.
    joint = np.flatnonzero(medium.blocks.followed() & ends[:, -1])
    ends[joint + 1, 0], ends[joint, -1] = True, False
    edge = np.flatnonzero(ends)
    hidden = medium.edges().reshape(-1)[edge]
    ray = np.repeat(medium.blocks.ray, STEPS + 1)[edge]
    step = medium.blocks.steps(edges=True).reshape(-1)[edge]
    shadows = np.full((volumes, suns, *ends.shape), OPAQUE, np.float32)
    for v, grid in enumerate(grids):
        position = medium.steps.index(v, ray, step)
        for l in range(suns):
            depth = grid.sun_depth(position, l, may_be_outside=may_be_outside or volumes > 1, hidden=hidden)
            shadows[v, l].reshape(-1)[edge] = depth
    shadows[:, :, joint, -1] = shadows[:, :, joint + 1, 0]
    return shadows


def _frames(diffused, origins, directions, steps: RaySteps) -> RaySteps:
    """Places on the same steps in the frames of the diffused light."""
    known = [light for light in diffused if light is not None]
    return RaySteps(known, origins, directions, steps.near, steps.far, steps.count)


def _together(values, groups):
    """Sums (G, ...) over groups of volumes of values (V, ...)."""
    if groups is None or groups == [[v] for v in range(len(values))]:
        return values
    return np.stack([values[group].sum(axis=0) for group in groups])


def _turning(diffused):
    """(G,) shares of scattering that turn light; any where nothing is predicted."""
    return [1.0 if light is None else light.turning for light in diffused]


def _scattered(diffused, frames: RaySteps, directions, sigma, suns: int, medium: _Medium) -> np.ndarray:
    """(G, L, P, STEPS): what diffused light of each sun scatters towards the camera, times 4 pi, at the middle of each filled
    step, 0 where nothing is predicted.

    sigma: (G, P, STEPS) extinction of each group.
    """
    scattered = np.zeros((len(diffused), suns, *medium.total.shape), np.float32)
    ray, step = medium.blocks.ray, medium.blocks.steps()
    known = 0
    for v, light in enumerate(diffused):
        if light is None:
            continue
        filled = np.flatnonzero(sigma[v])
        number = step.reshape(-1)[filled]
        ray_of = np.repeat(ray, STEPS)[filled]
        places = frames.index(known, ray_of, number + np.float32(0.5))
        # Moved about from step to step, so that neighbouring rays do not change cells together: that would show.
        scatter = number.astype(np.float32) * SCATTER
        places += scatter - np.floor(scatter) - np.float32(0.5)
        cells, towards = light.cells(places), light.towards(directions).take(ray_of, axis=0)
        for l, values in enumerate(light.lights):
            found = np.einsum("nk,nk->n", values.reshape(-1, 4).take(cells, axis=0).astype(np.float32), towards)
            scattered[v, l].reshape(-1)[filled] = np.maximum(found, np.float32(0.0))
        known += 1
    return scattered


def _lit(sun_maps, medium: _Medium, origins, directions) -> np.ndarray:
    """(L, P, STEPS): share of each sun's light that surfaces let through to the middle of each filled step."""
    steps = medium.steps
    frames = RaySteps(sun_maps, origins, directions, steps.near, steps.far, steps.count)
    filled = np.flatnonzero(medium.total)
    ray = np.repeat(medium.blocks.ray, STEPS)[filled]
    step = medium.blocks.steps().reshape(-1)[filled] + np.float32(0.5)
    lit = np.ones((len(sun_maps), *medium.total.shape), np.float32)
    for l, sun_map in enumerate(sun_maps):
        lit[l].reshape(-1)[filled] = sun_map.lit(frames.index(l, ray, step))
    return lit


def _single(medium: _Medium, shadows, transmitted, lit):
    """(R, V, L): single scattering by volume and sun, for albedo, irradiance and phase 1; lit: see `_lit`, or None."""
    volumes, suns = shadows.shape[:2]
    single = np.zeros((medium.blocks.rays, volumes, suns))
    # Integral over a step of exp(-tau to the camera - tau to the sun).
    for l in range(suns):
        shadow = shadows[:, l].sum(axis=0) if volumes > 1 else shadows[0, l]
        light = transmitted * mean_transmittance(shadow[:, :-1], shadow[:, 1:] + medium.tau) * medium.dt
        if lit is not None:
            light *= lit[l]
        for v in range(volumes):
            single[:, v, l] = medium.blocks.sums(_of_blocks(medium.sigma[v] * light))
    return single
