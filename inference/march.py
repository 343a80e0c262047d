"""Along camera rays: transmittance, exact single scattering and depths to sample.

Rays are cut into steps of at most half a voxel, less where voxels are optically thick.
Within a step extinction is constant and the optical depth towards the sun linear, so that
the integrals over a step are exact.
"""

from dataclasses import dataclass
from typing import List, Optional

import numpy as np

from .diffusion import DiffusedLight
from .grid import Grid
from .ray_light import REACH, RayLight, ray_light

# Steps per voxel of the finest grid: at least, and at most where voxels are optically thick.
STEPS_A_VOXEL = (2, 8)
STEPS_A_BLOCK = 32
# Optical depth beyond which a ray is not followed for single scattering: 1 part in 10^6 of it goes on.
BEHIND = 14.0
# Optical depth of a step above which the part of a ray that light reaches is cut again, at most so many times.
STIFF = 2.0
REFINEMENTS = 3
# Optical depth that counts as no light at all.
OPAQUE = np.float32(60.0)
# Rays fainter than this are not sampled in depth.
FAINTEST_ALPHA = 1e-4


@dataclass
class RaySegment:
    """What a ray bundle met.

    alpha: (R,); depth: (R,) mean scattering distance; single: (R, V, L) single scattering
    by volume and sun for albedo 1, irradiance 1 and phase function 1.
    sample_ray: int (M,) ray of each depth sample; sample_distance: (M,); sample_weight: (M,)
    sums to alpha over a ray's samples; sample_fraction: (M, V) share of each volume in
    the extinction there. sample_light: what networks that look along the ray need, or None.
    """

    alpha: np.ndarray
    depth: np.ndarray
    single: np.ndarray
    sample_ray: np.ndarray
    sample_distance: np.ndarray
    sample_weight: np.ndarray
    sample_fraction: np.ndarray
    sample_light: Optional[RayLight] = None


def steps_a_voxel(grids: List[Grid], sigma_t) -> int:
    """Two steps for each optical depth that a voxel may hold, overlaps included, within bounds."""
    thickest = sum(grid.thickness(s) for grid, s in zip(grids, sigma_t))
    return int(np.clip(np.ceil(2 * thickest), *STEPS_A_VOXEL))


def mean_transmittance(start, end):
    """Mean of exp(-tau) over a step along which tau goes linearly from start to end, both >= 0."""
    x = np.abs(end - start)
    small = x < 1e-4
    safe = np.where(small, np.float32(1.0), x)
    return np.exp(-np.minimum(start, end)) * np.where(small, 1.0 - 0.5 * x, -np.expm1(-safe) / safe)


def step_count(grids: List[Grid], sigma_t, directions, near, far) -> int:
    """Steps that the longest of some rays is cut into, counted in voxels of the grid that needs most."""
    crossed = max(
        (np.linalg.norm(directions @ grid.linear.T, axis=1) * (far - near)).max()
        for grid, extinction in zip(grids, sigma_t) if extinction > 0.0
    )
    return max(int(np.ceil(crossed * steps_a_voxel(grids, sigma_t))), 1)


class _Steps:
    """Rays cut into steps: continuous indices into each grid, and the step's length."""

    def __init__(self, grids, origins, directions, near, far, count: int):
        self.count = count
        self.dt = ((far - near) / count).astype(np.float32)[:, None]
        # Indices at the start of each ray in double precision; from there on in single.
        start = origins + near[:, None] * directions
        self.first = [grid.index(start).astype(np.float32) for grid in grids]
        self.slope = [(directions @ grid.linear.T).astype(np.float32) for grid in grids]

    def block(self, v: int, rays, steps):
        """Indices (R, S, 3) at some steps (S,) of some rays (R,)."""
        return self.first[v][rays, None] + (steps * self.dt[rays])[..., None] * self.slope[v][rays, None]

    def points(self, v: int, rays, steps):
        """Indices (N, 3) at pairs of ray and step (N,)."""
        return self.first[v][rays] + (steps * self.dt[rays, 0])[:, None] * self.slope[v][rays]


def march(
    grids: List[Grid], sigma_t, origins, directions, near, far, offsets, depth_samples: int,
    diffused: Optional[List[Optional[DiffusedLight]]] = None,
) -> RaySegment:
    """March rays through all grids.

    grids: with this extinction set; sigma_t: (V,) extinction per unit density of each, one
    colour channel; origins, directions: float64 (R, 3); near, far: (R,) interval that holds all
    grids; offsets: (R,) in [0, 1), of each ray's strata; diffused: of each volume, for `sample_light`, or None where
    that is not wanted; a volume's is None where nothing is predicted in it.
    """
    behind = BEHIND if diffused is None else REACH
    steps, sigma = _cut(grids, sigma_t, origins, directions, near, far, behind)
    for _ in range(REFINEMENTS):
        if (sigma.sum(axis=0) * steps.dt).max() < STIFF:
            break
        near, far = _lit_part(sigma.sum(axis=0) * steps.dt, near, far, behind)
        steps, sigma = _cut(grids, sigma_t, origins, directions, near, far, behind, steps.count)
    count = steps.count
    total = sigma.sum(axis=0)
    step_tau = total * steps.dt
    tau = np.cumsum(step_tau, axis=1, dtype=np.float64)
    before = np.exp(-(tau - step_tau)).astype(np.float32)
    opacity = np.concatenate([np.zeros((len(tau), 1)), -np.expm1(-tau)], axis=1)
    alpha = opacity[:, -1]
    # Mean distance within a step is left at its middle.
    distance = near[:, None] + (np.arange(count) + 0.5) * steps.dt
    depth = (np.diff(opacity, axis=1) * distance).sum(axis=1) / np.maximum(alpha, 1e-30)

    shadows = _shadows(grids, total > 0.0, steps)
    single = _single(sigma, shadows, total, before, steps.dt)
    ray, step, inside = _sample_depths(opacity, total * steps.dt, offsets, depth_samples)
    fraction = sigma[:, ray, step] / np.maximum(total[ray, step], np.float32(1e-30))
    light = None
    if diffused is not None:
        fluence = _fluence(diffused, len(grids[0].sun_depths), sigma, origins, directions, near, steps.dt)
        light = ray_light(sigma, shadows, fluence, steps.dt, ray, step, inside)
    return RaySegment(
        alpha,
        depth,
        single,
        sample_ray=ray,
        sample_distance=near[ray] + (step + inside) * steps.dt[ray, 0],
        sample_weight=alpha[ray] / depth_samples,
        sample_fraction=fraction.T,
        sample_light=light,
    )


def light_at(grid: Grid, sigma_t: float, positions, directions, diffused: DiffusedLight) -> RayLight:
    """What a network sees along rays that begin at world positions (N, 3), in one grid with its extinction set."""
    _, far = grid.interval(positions, directions)
    near, nothing = np.zeros(len(positions)), np.zeros(len(positions), int)
    steps, sigma = _cut([grid], [sigma_t], positions, directions, near, np.maximum(far, 1e-6 * grid.voxel), REACH)
    shadows = _shadows([grid], np.ones(sigma.shape[1:], bool), steps, may_be_outside=True)
    fluence = _fluence([diffused], len(grid.sun_depths), sigma, positions, directions, near, steps.dt)
    return ray_light(sigma, shadows, fluence, steps.dt, np.arange(len(positions)), nothing, np.zeros(len(positions)))


def _lit_part(step_tau, near, far, behind: float):
    """Where rays begin to be dimmed and where they are opaque, or else end: distances (R,) and (R,)."""
    count = step_tau.shape[1]
    dt = (far - near) / count
    filled, opaque = step_tau > 0.0, np.cumsum(step_tau, axis=1, dtype=np.float64) > behind
    # A step's middle may miss what begins behind it.
    first = np.where(filled.any(axis=1), np.maximum(filled.argmax(axis=1) - 1, 0), 0)
    last = np.where(opaque.any(axis=1), opaque.argmax(axis=1) + 1, count)
    return near + first * dt, np.where(last < count, near + last * dt, far)


def _cut(grids, sigma_t, origins, directions, near, far, behind: float, count: int = None):
    """Rays cut into `count` steps, and the extinction (V, R, S) in them up to the optical depth `behind`."""
    count = count or step_count(grids, sigma_t, directions, near, far)
    steps = _Steps(grids, origins, directions, near, far, count)
    return steps, _extinction(grids, sigma_t, steps, behind)


def _extinction(grids, sigma_t, steps: _Steps, behind: float) -> np.ndarray:
    """Extinction (V, R, S) at the middle of each step, 0 behind what is opaque.

    Goes front to back, a block of steps at a time, with the rays that still see through.
    """
    rays = len(steps.dt)
    middles = np.arange(steps.count, dtype=np.float32) + np.float32(0.5)
    sigma = np.zeros((len(grids), rays, steps.count), np.float32)
    seen, tau = np.arange(rays), np.zeros(rays)
    for start in range(0, steps.count, STEPS_A_BLOCK):
        span = slice(start, min(start + STEPS_A_BLOCK, steps.count))
        for v, grid in enumerate(grids):
            density = grid.sample_density(steps.block(v, seen, middles[span]).reshape(-1, 3))
            sigma[v, seen, span] = density.reshape(len(seen), -1) * np.float32(sigma_t[v])
        tau[seen] += sigma[:, seen, span].sum(axis=(0, 2)) * steps.dt[seen, 0]
        seen = seen[tau[seen] < behind]
        if not len(seen):
            break
    return sigma


def _sample_depths(opacity, step_tau, offsets, depth_samples: int):
    """Depths stratified in the rays' opacity: ray, step and place within the step, (M,) each."""
    sampled = np.flatnonzero(opacity[:, -1] > FAINTEST_ALPHA)
    steps, order = step_tau.shape[1], np.arange(len(sampled))[:, None]
    u = (np.arange(depth_samples) + offsets[sampled, None]) / depth_samples * opacity[sampled, -1:]
    # One search in all rays at once: the n-th ray's opacities lie in [2n, 2n + 1].
    step = np.searchsorted((opacity[sampled, 1:] + 2.0 * order).ravel(), (u + 2.0 * order).ravel())
    step = np.clip(step.reshape(u.shape) - steps * order, 0, steps - 1).ravel()
    ray = np.repeat(sampled, depth_samples)
    before = opacity[ray, step]
    # Invert the exponential within the step.
    into = -np.log1p(-np.clip((u.ravel() - before) / (1.0 - before), 0.0, 1.0 - 1e-7))
    return ray, step, np.minimum(into / np.maximum(step_tau[ray, step], 1e-30), 1.0)


def _shadows(grids, filled, steps: _Steps, may_be_outside: bool = False) -> np.ndarray:
    """(V, L, R, S + 1) optical depth through each volume towards each sun, at both ends of filled steps."""
    volumes, suns = len(grids), len(grids[0].sun_depths)
    ends = np.zeros((len(filled), steps.count + 1), bool)
    ends[:, :-1] |= filled
    ends[:, 1:] |= filled
    ray, edge = np.nonzero(ends)
    shadows = np.full((volumes, suns, *ends.shape), OPAQUE, np.float32)
    for v, grid in enumerate(grids):
        position = steps.points(v, ray, edge.astype(np.float32))
        for l in range(suns):
            shadows[v, l, ray, edge] = grid.sun_depth(position, l, may_be_outside=may_be_outside or volumes > 1)
    return shadows


def _fluence(diffused, suns: int, sigma, origins, directions, near, dt) -> np.ndarray:
    """(V, L, R, S) fluence of each sun at the middle of each filled step, 0 where nothing is predicted."""
    volumes, rays, count = sigma.shape
    fluence = np.zeros((volumes, suns, rays, count), np.float32)
    for v, light in enumerate(diffused):
        if light is None:
            continue
        ray, step = np.nonzero(sigma[v])
        first = ((origins + near[:, None] * directions) @ light.linear.T + light.offset).astype(np.float32)
        slope = (directions @ light.linear.T).astype(np.float32)
        distance = (step + np.float32(0.5)).astype(np.float32) * dt[ray, 0]
        cells = light.cells(first[ray] + distance[:, None] * slope[ray])
        for l, values in enumerate(light.fluences):
            fluence[v, l, ray, step] = values.reshape(-1).take(cells)
    return fluence


def _single(sigma, shadows, total, before, dt):
    """(R, V, L): single scattering by volume and sun, for albedo, irradiance and phase 1."""
    volumes, suns, rays = shadows.shape[:3]
    single = np.zeros((rays, volumes, suns))
    filled = total > 0.0
    # Integral over a step of exp(-tau to the camera - tau to the sun).
    for l in range(suns):
        shadow = shadows[:, l].sum(axis=0) if volumes > 1 else shadows[0, l]
        light = before * filled * mean_transmittance(shadow[:, :-1], shadow[:, 1:] + total * dt) * dt
        for v in range(volumes):
            single[:, v, l] = (sigma[v] * light).sum(axis=1)
    return single
