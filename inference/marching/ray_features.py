# SPDX-License-Identifier: GPL-3.0-or-later
"""The medium along a camera ray as seen from points on it: optical depths, and the light ahead.

Forward scattering brings light from ahead along the camera ray. It is integrated from values that marching the ray for
single scattering has already evaluated.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Scales of extinction for the light ahead: forward scattering reaches further than direct light.
SCALES = (1.0, 0.578, 0.334)
# Number of integrals of light that has scattered before: with all extinction, and with its reduced fraction.
SCATTERED = 2
#: Features per point, medium and sun.
COLUMNS = 2 + len(SCALES) + SCATTERED
# Upper bounds of the optical depths towards the sun and ahead.
MAX_TAU_SUN, MAX_TAU_AHEAD = 60.0, 8.0
#: Optical depth up to which rays must be marched for the light ahead of samples to be complete.
REACH = 20.0


@dataclass(frozen=True)
class RayFeatures:
    """Features at M points of camera rays, in each of V media alone, for each of L suns of irradiance 1.

    Without lamps they are 0 in media that the ray misses.

    values: float32 (M, V, L, COLUMNS): optical depth towards the sun; optical depth ahead; for each scale a the
    integral of exp(-a (tau + tau_sun)) a d(tau) along the ray ahead, where tau counts from the point; and for a = 1 and
    a = the reduced fraction of scattering the integral of exp(-a tau) J a d(tau), where J is 4 pi times the light
    scattered towards the camera that has scattered before.
    """

    values: np.ndarray

    def of(self, points: np.ndarray | slice, medium: int | np.ndarray, sun: int) -> np.ndarray:
        """float32 (N, COLUMNS) at points, by number, in one medium, or one (N,) for each, and for one sun."""
        return self.values[points, medium, sun]

    def mean(
        self, points: np.ndarray | slice, medium: int | np.ndarray, suns: Sequence[int], fractions: np.ndarray
    ) -> np.ndarray:
        """float32 (N, COLUMNS), as `of`, averaged over several suns.

        fractions: (n,), of the light that each sun gives, or (N, n) for each point. Transmittance is averaged instead
        of optical depth.
        """
        if len(suns) == 1:
            return self.of(points, medium, suns[0])
        values = self.values[points, medium][:, suns]
        weights = np.broadcast_to(fractions, values.shape[:2])
        mean = np.einsum("nsc,ns->nc", values, weights, optimize=False)
        mean[:, 0] = -np.log((np.exp(-values[..., 0]) * weights).sum(axis=1))
        return mean
