"""Along camera rays: transmittance, exact single scattering and depths to sample.

Rays are cut into steps of at most half a voxel, less where voxels are optically thick. Within a step extinction is constant and
the optical depth towards the sun linear, so that the integrals over a step are exact and
steps may be optically thick.
"""

from dataclasses import dataclass
from typing import List

import numpy as np

from .grid import Grid

# Steps per voxel of the finest grid: at least, and at most where voxels are optically thick.
STEPS_A_VOXEL = (2, 8)
# Steps behind less transmittance than this are lit by nothing that shows.
HIDDEN = 1e-4
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
    the extinction there.
    """

    alpha: np.ndarray
    depth: np.ndarray
    single: np.ndarray
    sample_ray: np.ndarray
    sample_distance: np.ndarray
    sample_weight: np.ndarray
    sample_fraction: np.ndarray


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


def march(grids: List[Grid], sigma_t, origins, directions, near, far, offsets, depth_samples: int) -> RaySegment:
    """March rays through all grids.

    grids: with this extinction set; sigma_t: (V,) extinction per unit density of each, one
    colour channel; origins,
    directions: float64 (R, 3); near, far: (R,) interval that holds all grids; offsets:
    (R,) in [0, 1), of each ray's strata.
    """
    rays, volumes, suns = len(origins), len(grids), len(grids[0].sun_depths)
    voxel = min(grid.voxel for grid in grids)
    steps = max(int(np.ceil((far - near).max() * steps_a_voxel(grids, sigma_t) / voxel)), 1)
    dt = ((far - near) / steps).astype(np.float32)[:, None]

    # Continuous indices at the start of each ray, in double precision; steps in single.
    start = origins + near[:, None] * directions
    first = [grid.index(start).astype(np.float32) for grid in grids]
    slope = [(directions @ grid.linear.T).astype(np.float32) for grid in grids]

    def indices(v, ray, step):
        return first[v][ray] + (step * dt[ray, 0])[:, None] * slope[v][ray]

    middles = np.arange(steps, dtype=np.float32) + np.float32(0.5)
    every_ray, every_step = np.repeat(np.arange(rays), steps), np.tile(middles, rays)
    sigma = np.empty((volumes, rays, steps), np.float32)
    for v, grid in enumerate(grids):
        density = grid.sample_density(indices(v, every_ray, every_step))
        sigma[v] = density.reshape(rays, steps) * np.float32(sigma_t[v])
    total = sigma.sum(axis=0)
    step_tau = total * dt
    tau = np.cumsum(step_tau, axis=1, dtype=np.float64)
    before = np.exp(-(tau - step_tau)).astype(np.float32)
    opacity = np.concatenate([np.zeros((rays, 1)), -np.expm1(-tau)], axis=1)
    alpha = opacity[:, -1]

    # Mean distance within a step is left at its middle.
    weight = np.diff(opacity, axis=1)
    distance = near[:, None] + middles * dt
    depth = (weight * distance).sum(axis=1) / np.maximum(alpha, 1e-30)

    single = _single(grids, sigma, total, before, dt, indices, suns)

    sampled = np.flatnonzero(alpha > FAINTEST_ALPHA)
    u = (np.arange(depth_samples) + offsets[sampled, None]) / depth_samples * alpha[sampled, None]
    # One search in all rays at once: ray r's opacities lie in [2r, 2r + 1].
    keys = opacity[sampled, 1:] + 2.0 * np.arange(len(sampled))[:, None]
    step = np.searchsorted(keys.ravel(), (u + 2.0 * np.arange(len(sampled))[:, None]).ravel())
    step = np.clip(step.reshape(u.shape) - steps * np.arange(len(sampled))[:, None], 0, steps - 1)
    rows = sampled[:, None]
    into = -np.log1p(-np.clip((u - opacity[rows, step]) / (1.0 - opacity[rows, step]), 0.0, 1.0 - 1e-7))
    extinction = np.maximum(total[rows, step], 1e-30)
    inside = np.minimum(into / (extinction * dt[sampled]), 1.0)
    sample_distance = near[rows] + (step + inside) * dt[sampled]
    return RaySegment(
        alpha,
        depth,
        single,
        np.repeat(sampled, depth_samples),
        sample_distance.ravel(),
        np.repeat(alpha[sampled] / depth_samples, depth_samples),
        (sigma[:, rows, step] / extinction).reshape(volumes, -1).T,
    )


def _single(grids, sigma, total, before, dt, indices, suns):
    """(R, V, L): single scattering by volume and sun, for albedo, irradiance and phase 1."""
    volumes, rays, steps = sigma.shape
    single = np.zeros((rays, volumes, suns))
    filled = total > 0.0
    # Shadows are needed only at both ends of steps that hold density.
    ends = np.zeros((rays, steps + 1), bool)
    ends[:, :-1] |= filled
    ends[:, 1:] |= filled
    ray, edge = np.nonzero(ends)
    position = [indices(v, ray, edge.astype(np.float32)) for v in range(volumes)]
    for l in range(suns):
        tr = np.ones(len(ray), np.float32)
        for v, grid in enumerate(grids):
            tr *= grid.sample_sun_tr(position[v], l, may_be_outside=volumes > 1)
        shadow = np.full(ends.shape, OPAQUE, np.float32)
        shadow[ray, edge] = -np.log(np.maximum(tr, np.exp(-OPAQUE)))
        # Integral over a step of exp(-tau to the camera - tau to the sun).
        light = before * filled * mean_transmittance(shadow[:, :-1], shadow[:, 1:] + total * dt) * dt
        for v in range(volumes):
            single[:, v, l] = (sigma[v] * light).sum(axis=1)
    return single
