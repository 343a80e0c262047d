# SPDX-License-Identifier: GPL-3.0-or-later
"""The medium along camera rays as seen from points on them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inference.marching.ray_features import COLUMNS, MAX_TAU_AHEAD, MAX_TAU_SUN, REACH, SCALES, RayFeatures

from .ray_steps import Blocks, sums_within


@dataclass(frozen=True)
class SampleSteps:
    """Where M samples lie on marched rays: int (M,) block and step within it, and position (M,) in the step, 0 to 1."""

    block: np.ndarray
    step: np.ndarray
    inside: np.ndarray


def gather_ray_features(
    blocks: Blocks,
    tau: np.ndarray,
    sun_depths: np.ndarray,
    source: np.ndarray,
    reduced_fractions: Sequence[float],
    samples: SampleSteps,
    visibility: np.ndarray | None = None,
) -> RayFeatures:
    """Ray features of samples on marched rays.

    blocks: P blocks of S steps. tau: float32 (V, P, S), optical thickness of each step. sun_depths: (V, L, P, S + 1),
    optical depth towards each sun at the ends of steps that hold density. source: (V, L, P, S), J of each sun in each
    step. reduced_fractions: (V,) of scattering. visibility: (L, P, S) of each sun, or None where no surface shadows it.
    """
    volumes, suns = sun_depths.shape[:2]
    block, step = samples.block, samples.step
    values = np.empty((len(block), volumes, suns, COLUMNS), np.float32)
    # Integrals of light ahead are differences of large numbers on long rays.
    tau, inside = tau.astype(np.float64), samples.inside
    for v in range(volumes):
        within = sums_within(tau[v])
        before = blocks.before(within[:, -1])[:, None] + (within - tau[v])
        rest = (1 - inside) * tau[v][block, step]
        # Samples lie where light reaches; the bound limits rounding in thick steps.
        at = np.clip(before[block, step] + tau[v][block, step] - rest, 0.0, 2.0 * REACH)
        # Light that each step absorbs, for each scaled extinction, as seen from the start of the ray.
        ends = {a: np.exp(-a * before) * -np.expm1(-a * tau[v]) for a in {*SCALES, 1.0, reduced_fractions[v]}}
        whole = blocks.sums(within[:, -1])
        ahead = np.minimum(whole[blocks.ray[block]] - at, MAX_TAU_AHEAD)

        def integral(a: float, light: np.ndarray) -> np.ndarray:
            """Integral (M,) of exp(-a tau) light a d(tau) ahead of the samples; light: (P, S), of each step."""
            # Contributions of whole steps at the start of the ray, then suffix sums: within the block, and over later
            # blocks.
            given = light * ends[a]
            behind = np.zeros((given.shape[0], given.shape[1] + 1), given.dtype)
            behind[:, :-1] = sums_within(given[:, ::-1])[:, ::-1]
            further = behind[block, step + 1] + blocks.behind(behind[:, 0])[block]
            return further * np.exp(a * at) + light[block, step] * -np.expm1(-a * rest)

        for l in range(suns):
            depth = sun_depths[v, l]
            start, end = depth[block, step], depth[block, step + 1]
            values[:, v, l, 0] = np.minimum(start + inside * (end - start), MAX_TAU_SUN)
            values[:, v, l, 1] = ahead
            middle = 0.5 * (depth[:, :-1] + depth[:, 1:])
            single = [(a, np.exp(-a * middle)) for a in SCALES]
            if visibility is not None:
                single = [(a, light * visibility[l]) for a, light in single]
                dark = -np.log(np.maximum(visibility[l][block, step], np.float32(1e-30)))
                values[:, v, l, 0] = np.minimum(values[:, v, l, 0] + dark, MAX_TAU_SUN)
            scattered = [(a, source[v, l]) for a in (1.0, reduced_fractions[v])]
            for column, (a, light) in enumerate(single + scattered, start=2):
                values[:, v, l, column] = integral(a, light)
    return RayFeatures(values)
