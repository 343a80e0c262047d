# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that volumes emit, as it reaches the camera."""

import functools
from collections.abc import Sequence

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..scene.optimizations import ALL
from .ray_march import MAX_OPTICAL_DEPTH, extinction, mean_transmittance
from .ray_steps import RayBatch, RaySteps, blocks_near_density, step_counts, sums_within


def emitted_radiance(
    media: Sequence[BoundMedium], rays: RayBatch, channels: Sequence[int], optimizations: frozenset[str] = ALL
) -> np.ndarray | None:
    """Emitted radiance (R, C) along rays in C colour channels, the integral of T(t) e(x(t)) dt; None if nothing emits.

    T is the transmittance through all media and e their emission; extinction and emission are constant within a step.
    rays: with intervals that contain all media. optimizations: those in use, as in Settings.
    """
    emitting = [v for v, medium in enumerate(media) if medium.emits]
    if not emitting:
        return None
    steps = RaySteps(media, rays, step_counts(media, rays))
    blocks = blocks_near_density(media, steps, always_first=False, skip_empty="empty_space" in optimizations)
    # Transmittance to each step, averaged over the step, times the length of the step.
    behind = MAX_OPTICAL_DEPTH if "behind_opaque" in optimizations else np.inf
    tau = extinction(media, steps, blocks, behind).sum(axis=0) * steps.dt[blocks.ray][:, None]
    within = sums_within(tau)
    before = blocks.before(within[:, -1])[:, None]
    through = np.exp(-before - (within - tau)) * mean_transmittance(np.float32(0.0), tau)
    through *= steps.dt[blocks.ray][:, None] * (blocks.steps() < steps.count[blocks.ray][:, None]) * (before < behind)
    radiance = np.zeros((blocks.rays, len(channels)))
    for v in emitting:
        for number, channel in enumerate(channels):
            sample = functools.partial(media[v].grid.sample_emission, channel)
            emission = steps.mean(sample, v, blocks.ray, blocks.number)
            radiance[:, number] += media[v].medium.emission * blocks.sums((emission * through).sum(axis=1))
    return radiance
