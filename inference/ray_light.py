"""The medium along a camera ray, as seen from points on it: optical depths, and the light ahead.

Light that scatters forward arrives from ahead of the camera ray. Marching the ray for single scattering
has already met everything that this takes.
"""

from dataclasses import dataclass

import numpy as np

from .exponential import one_minus_exp
from .ray_steps import sums_within

# Extinction is scaled by these for the light ahead: forward scattering reaches further than extinction lets light.
SCALES = (1.0, 0.578, 0.334)
# The light from ahead that has scattered before is seen through all extinction, and through the share of it that turns light.
DIFFUSED = 2
COLUMNS = 2 + len(SCALES) + DIFFUSED
# Optical depths towards the sun and ahead count up to these.
TAU_SUN_MOST, TAU_AHEAD_MOST = 60.0, 8.0
# Optical depth to which rays must be marched so that the light ahead of samples is complete.
REACH = 20.0


@dataclass
class RayLight:
    """At M points of camera rays, in each of V media alone, for each of L suns of irradiance 1.

    values: float32 (M, V, L, COLUMNS): optical depth towards the sun, optical depth ahead, and along the ray
        ahead, where tau counts from the point, for each scale a the integral of exp(-a (tau + tau_sun)) a d(tau),
        and for 1 and the share of scattering that turns light that of exp(-a tau) J a d(tau), J being what the light that
        has scattered before scatters along the ray, times 4 pi.
    """

    values: np.ndarray

    def of(self, points, medium: int, sun: int) -> np.ndarray:
        """float32 (N, COLUMNS) of some points, in one medium and for one sun."""
        return self.values[points, medium, sun]


def ray_light(blocks, sigma, shadows, scattered, turning, dt, block, step, inside, lit=None) -> RayLight:
    """Light at points of marched rays.

    blocks: `ray_steps.Blocks`, P of them; sigma: (V, P, S) extinction in each step; shadows: (V, L, P, S + 1) optical
    depth towards each sun at the steps' ends, where a step holds density; scattered: (V, L, P, S) J of each sun in each
    step; turning: (V,) shares of scattering that turn light; dt: (P, 1) steps' length; block, step: int (M,) of each point, and inside: (M,) in [0, 1], how far into its
    step it lies; lit: (L, P, S) share of each sun's light that surfaces let through, where they shade.
    """
    volumes, suns = shadows.shape[:2]
    values = np.empty((len(block), volumes, suns, COLUMNS), np.float32)
    inside = inside.astype(sigma.dtype)
    for v in range(volumes):
        through = sigma[v] * dt
        within = sums_within(through)
        before = blocks.before(within[:, -1]).astype(sigma.dtype)[:, None] + (within - through)
        rest = (1 - inside) * through[block, step]
        # Samples lie where light reaches; the limit keeps rounding in steep steps from growing below.
        at = np.clip(before[block, step] + through[block, step] - rest, 0.0, 2.0 * REACH)
        # What ends in each step for each scaled extinction, seen from where the ray begins.
        ends = {a: np.exp(-a * before) * one_minus_exp(a * through) for a in {*SCALES, 1.0, turning[v]}}
        whole = blocks.sums(within[:, -1])
        ahead = np.minimum(whole[blocks.ray[block]] - at, TAU_AHEAD_MOST)
        for l in range(suns):
            shadow = shadows[v, l]
            start, end = shadow[block, step], shadow[block, step + 1]
            values[:, v, l, 0] = np.minimum(start + inside * (end - start), TAU_SUN_MOST)
            values[:, v, l, 1] = ahead
            middle = 0.5 * (shadow[:, :-1] + shadow[:, 1:])
            single = [(a, np.exp(-a * middle)) for a in SCALES]
            if lit is not None:
                single = [(a, light * lit[l]) for a, light in single]
                dark = -np.log(np.maximum(lit[l][block, step], np.float32(1e-30)))
                values[:, v, l, 0] = np.minimum(values[:, v, l, 0] + dark, TAU_SUN_MOST)
            for i, (a, light) in enumerate(single + [(a, scattered[v, l]) for a in (1.0, turning[v])], start=2):
                values[:, v, l, i] = _gather(a, light, ends[a], blocks, block, step, rest, at)
    return RayLight(values)


def _gather(a, light, ends, blocks, block, step, rest, at):
    """(M,) integral of exp(-a tau) light a d(tau) ahead of points; light: (P, S), constant in each step.

    ends: (P, S) exp(-a tau) at each step's start less that at its end, tau from the ray's start.
    """
    # What each whole step gives where the ray begins; then all steps behind each, in its block and in those behind.
    given = light * ends
    behind = np.zeros((given.shape[0], given.shape[1] + 1), given.dtype)
    behind[:, :-1] = sums_within(given[:, ::-1])[:, ::-1]
    ahead = behind[block, step + 1] + blocks.behind(behind[:, 0])[block]
    return ahead * np.exp(a * at) + light[block, step] * -np.expm1(-a * rest)
