# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering of lamps inside a volume or near it, from the coarse transport alone.

Networks have learnt the light of suns, which enters a volume from outside and is as bright everywhere. That of a lamp
nearby is not: it falls with the square of the distance, comes from all around, and how much of it an albedo below 1
leaves does not follow from the transport for albedo 1 that networks read. Solved for the true albedo, the transport
itself holds the light: with its moments L_lm of the radiance, up to degree 3, what scatters towards the camera is

    sum_lm (2 l + 1) / (4 pi) G^l L_lm Y_lm(-omega)
        + E sum_l (2 l + 1) / (4 pi) P_l(omega . l) G^l (exp(-(1 - w G^2 f_l) tau) - exp(-tau)),

where the second term is the light of the lamp, of irradiance E behind an optical depth tau, that has scattered into the
phase function's forward peak, which the transport counts as unscattered. The more often it has, the further it spreads:
what the delta scaling leaves of the phase function for the peak has the Legendre moments
f_l = (G^l - (1 - G^2) G'^l) / G^2 with the G' = G / (1 + G) of the transport, and after n scatterings their n-th powers
(Goudsmit and Saunderson, "Multiple Scattering of Electrons", 1940); the last scattering, towards the camera, has the
moments G^l. Without degrees 2 and 3 what goes sideways from a beam is too bright, and what goes on too dark.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..numerics.small_matmul import product
from ..numerics.spherical_harmonics import DEGREES, spherical_harmonics
from ..transport.discrete_ordinates import reduced_anisotropy
from ..transport.scattered_fluence import FluenceLattice

# Distance from a lamp to the nearest point of a volume, over that to the farthest, up to which the transport alone is
# its multiple scattering, and from which on it is what networks predict: against photons at a mean cosine of 0.857 the
# transport is closer at 0.1, the network at 0.3.
NEAR, FAR = 0.1, 0.2
# Square of the anisotropy below which there is no forward peak.
MIN_FORWARD = 1e-3
# Terms of Legendre series are summed down to this one, but no more than so many.
MIN_TERM, MAX_TERMS = 1e-4, 160
#: Smallest albedo for which the transport is solved.
MIN_ALBEDO = 1e-3


def transport_share(lamp: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Share of the transport alone in a lamp's multiple scattering, 0 to 1.

    lamp: (3,), its place. low, high: (3,), of the box around the volume.
    """
    nearest = float(np.linalg.norm(np.maximum(np.maximum(low - lamp, lamp - high), 0.0)))
    farthest = float(np.linalg.norm(np.maximum(lamp - low, high - lamp)))
    return min(max((FAR - nearest / max(farthest, 1e-30)) / (FAR - NEAR), 0.0), 1.0)


@dataclass(frozen=True)
class LampNearby:
    """The transport of a lamp of power 1, solved for some albedos.

    share: of it in the multiple scattering. lights: of each albedo, its FluenceLattice over a factor, and the factor.
    anisotropy: G of the phase function.
    """

    share: float
    lights: Mapping[float, tuple[FluenceLattice, float]]
    anisotropy: float

    def radiance(
        self,
        albedo: float,
        positions: np.ndarray,
        omega: np.ndarray,
        towards: np.ndarray,
        irradiance: np.ndarray,
        depth: np.ndarray,
    ) -> np.ndarray:
        """Multiple scattering float64 (N,) at points, without the factor of the local albedo.

        albedo: one of those that it is solved for. positions, omega, towards: (N, 3), of points, camera rays and the
        lamp in the cube's frame. irradiance, depth: (N,), of the lamp without what lies in between, and the optical
        depth.
        """
        (light, scale), g = self.lights[albedo], self.anisotropy
        weights = (2 * DEGREES + 1) * g**DEGREES * (scale / (4.0 * np.pi))
        found = product(light.values(positions) * spherical_harmonics(-omega).T, weights).astype(np.float64)
        # At wide angles the peaks' light is less than what the transport's few moments have too much.
        return np.maximum(found + irradiance * _forward_light((omega * towards).sum(axis=1), g, albedo, depth), 0.0)


def _forward_light(cosine: np.ndarray, anisotropy: float, albedo: float, depth: np.ndarray) -> np.ndarray:
    """Light (N,), 1/sr, that has scattered into forward peaks and then towards the camera, of a beam of irradiance 1.

    cosine: (N,), of the angle between the camera ray and the direction to the lamp. depth: (N,), of the medium.
    """
    g, forward = anisotropy, anisotropy**2
    if forward < MIN_FORWARD:
        return np.zeros(len(cosine))
    count = min(int(np.log(MIN_TERM) / np.log(forward)) + 2, MAX_TERMS)
    # Legendre's polynomials by their recurrence.
    before, here = np.zeros(len(cosine)), np.ones(len(cosine))
    found, unscattered = np.zeros(len(cosine)), np.exp(-depth)
    for order in range(count):
        moment = (g**order - (1.0 - forward) * reduced_anisotropy(g) ** order) / forward
        share = np.exp(-(1.0 - albedo * forward * moment) * depth) - unscattered
        found += (2 * order + 1) / (4.0 * np.pi) * g**order * share * here
        before, here = here, ((2 * order + 1) * cosine * here - order * before) / (order + 1)
    return found
