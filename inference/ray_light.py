"""The medium along a camera ray, as seen from points on it: optical depths and single-scattered light ahead.

Light that scatters forward arrives from ahead of the camera ray. Marching the ray for single scattering
has already met everything that this takes.
"""

from dataclasses import dataclass

import numpy as np

# Extinction is scaled by these for the light ahead: forward scattering reaches further than extinction lets light.
SCALES = (1.0, 0.578, 0.334)
# Optical depths towards the sun and ahead count up to these.
TAU_SUN_MOST, TAU_AHEAD_MOST = 60.0, 8.0
# Optical depth to which rays must be marched so that the light ahead of samples is complete.
REACH = 20.0


@dataclass
class RayLight:
    """At M points of camera rays, in each of V volumes alone, for each of L suns of irradiance 1.

    values: float32 (M, V, L, 2 + len(SCALES)): optical depth towards the sun, optical depth ahead, and
        for each scale a the integral of exp(-a (tau + tau_sun)) a d(tau) along the ray ahead, where tau counts
        from the point.
    """

    values: np.ndarray

    def of(self, points, volume: int, sun: int) -> np.ndarray:
        """float32 (N, 5) of some points, in one volume and for one sun."""
        return self.values[points, volume, sun]


def ray_light(sigma, shadows, dt, ray, step, inside) -> RayLight:
    """Light at points of marched rays.

    sigma: float32 (V, R, S) extinction in each step; shadows: (V, L, R, S + 1) optical depth towards
    each sun at the steps' ends, where a step holds density; dt: (R, 1) steps' length; ray, step: int (M,)
    of each point, and inside: (M,) in [0, 1], how far into its step it lies.
    """
    volumes, suns = shadows.shape[:2]
    values = np.empty((len(ray), volumes, suns, 2 + len(SCALES)), np.float32)
    inside = inside.astype(np.float32)
    for v in range(volumes):
        through = sigma[v] * dt
        after = np.cumsum(through, axis=1)
        rest = (1.0 - inside) * through[ray, step]
        at = after[ray, step] - rest
        ahead = np.minimum(after[ray, -1] - at, TAU_AHEAD_MOST)
        for l in range(suns):
            shadow = shadows[v, l]
            start, end = shadow[ray, step], shadow[ray, step + 1]
            values[:, v, l, 0] = np.minimum(start + inside * (end - start), TAU_SUN_MOST)
            values[:, v, l, 1] = ahead
            middle = 0.5 * (shadow[:, :-1] + shadow[:, 1:])
            for i, a in enumerate(SCALES):
                # Light of each whole step, seen from where the ray begins; then of all steps behind each.
                light = np.exp(-a * (after - through + middle)) * -np.expm1(-a * through)
                behind = np.zeros_like(light)
                behind[:, :-1] = np.cumsum(light[:, :0:-1], axis=1)[:, ::-1]
                part = np.exp(-a * middle[ray, step]) * -np.expm1(-a * rest)
                values[:, v, l, 2 + i] = behind[ray, step] * np.exp(a * at) + part
    return RayLight(values)
