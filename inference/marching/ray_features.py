"""The medium along a camera ray as seen from points on it: optical depths, and the light ahead.

Forward scattering brings light from ahead of the camera ray. Marching the ray for single scattering has already evaluated
everything that this takes.
"""

from dataclasses import dataclass

import numpy as np

from ..numerics.exponential import one_minus_exp
from .ray_steps import Blocks, sums_within

# Extinction is scaled by these for the light ahead: forward scattering reaches further than extinction lets light.
SCALES = (1.0, 0.578, 0.334)
# Integrals of light that has scattered before: through all extinction, and through the reduced fraction of it.
SCATTERED = 2
#: Features per point, medium and sun.
COLUMNS = 2 + len(SCALES) + SCATTERED
# Largest optical depths towards the sun and ahead.
TAU_SUN_MOST, TAU_AHEAD_MOST = 60.0, 8.0
#: Optical depth to which rays must be marched so that the light ahead of samples is complete.
REACH = 20.0


@dataclass(frozen=True)
class RayFeatures:
    """At M points of camera rays, in each of V media alone, for each of L suns of irradiance 1.

    values: float32 (M, V, L, COLUMNS): optical depth towards the sun; optical depth ahead; for each scale a the integral of
    exp(-a (tau + tau_sun)) a d(tau) along the ray ahead, where tau counts from the point; and for a = 1 and a = the reduced
    fraction of scattering that of exp(-a tau) J a d(tau), J being what light that has scattered before scatters along the
    ray, times 4 pi.
    """

    values: np.ndarray

    def of(self, points, medium: int, sun: int) -> np.ndarray:
        """float32 (N, COLUMNS) of some points, in one medium and for one sun."""
        return self.values[points, medium, sun]


@dataclass(frozen=True)
class SampleSteps:
    """Where M samples lie on marched rays: int (M,) block and step within it, and (M,) in [0, 1], how far into the step."""

    block: np.ndarray
    step: np.ndarray
    inside: np.ndarray


def gather_ray_features(
    blocks: Blocks, tau, sun_depths, source, reduced_fractions, samples: SampleSteps, visibility=None
) -> RayFeatures:
    """Ray features of samples on marched rays.

    blocks: P of them, of S steps. tau: float32 (V, P, S) optical depth of each step. sun_depths: (V, L, P, S + 1) optical
    depth towards each sun at the steps' ends, where a step holds density. source: (V, L, P, S) J of each sun in each step.
    reduced_fractions: (V,) of scattering. visibility: (L, P, S) share of each sun's light that surfaces let through, where
    they shade.
    """
    volumes, suns = sun_depths.shape[:2]
    block, step = samples.block, samples.step
    values = np.empty((len(block), volumes, suns, COLUMNS), np.float32)
    inside = samples.inside.astype(tau.dtype)
    for v in range(volumes):
        within = sums_within(tau[v])
        before = blocks.before(within[:, -1]).astype(tau.dtype)[:, None] + (within - tau[v])
        rest = (1 - inside) * tau[v][block, step]
        # Samples lie where light reaches; the limit keeps rounding in steep steps from growing below.
        at = np.clip(before[block, step] + tau[v][block, step] - rest, 0.0, 2.0 * REACH)
        # What ends in each step for each scaled extinction, seen from where the ray begins.
        ends = {a: np.exp(-a * before) * one_minus_exp(a * tau[v]) for a in {*SCALES, 1.0, reduced_fractions[v]}}
        whole = blocks.sums(within[:, -1])
        ahead = np.minimum(whole[blocks.ray[block]] - at, TAU_AHEAD_MOST)

        def integral(a, light):
            """(M,) integral of exp(-a tau) light a d(tau) ahead of the samples; light: (P, S), constant in each step."""
            # What each whole step gives where the ray begins; then all steps behind each, in its block and further on.
            given = light * ends[a]
            behind = np.zeros((given.shape[0], given.shape[1] + 1), given.dtype)
            behind[:, :-1] = sums_within(given[:, ::-1])[:, ::-1]
            further = behind[block, step + 1] + blocks.behind(behind[:, 0])[block]
            return further * np.exp(a * at) + light[block, step] * -np.expm1(-a * rest)

        for l in range(suns):
            depth = sun_depths[v, l]
            start, end = depth[block, step], depth[block, step + 1]
            values[:, v, l, 0] = np.minimum(start + inside * (end - start), TAU_SUN_MOST)
            values[:, v, l, 1] = ahead
            middle = 0.5 * (depth[:, :-1] + depth[:, 1:])
            single = [(a, np.exp(-a * middle)) for a in SCALES]
            if visibility is not None:
                single = [(a, light * visibility[l]) for a, light in single]
                dark = -np.log(np.maximum(visibility[l][block, step], np.float32(1e-30)))
                values[:, v, l, 0] = np.minimum(values[:, v, l, 0] + dark, TAU_SUN_MOST)
            scattered = [(a, source[v, l]) for a in (1.0, reduced_fractions[v])]
            for column, (a, light) in enumerate(single + scattered, start=2):
                values[:, v, l, column] = integral(a, light)
    return RayFeatures(values)
