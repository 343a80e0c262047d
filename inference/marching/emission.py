# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that volumes emit, as it reaches the camera."""

import functools
from collections.abc import Sequence

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..scene.optimizations import ALL
from .ray_march import MAX_OPTICAL_DEPTH, mean_transmittance
from .ray_steps import Cutting, RayBatch, cut_into_blocks, sums_within


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
    behind = MAX_OPTICAL_DEPTH if "behind_opaque" in optimizations else np.inf
    cutting = Cutting(behind, skip_empty="empty_space" in optimizations, keep_empty=True)
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
            sample = functools.partial(media[v].grid.sample_emission, channel)
            emission = lines.mean(sample, v, blocks)
            radiance[:, number] += media[v].medium.emission * blocks.sums((emission * through).sum(axis=1))
    return radiance
