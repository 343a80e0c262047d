# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering of lamps deep inside a volume, from the coarse transport alone.

Networks have learnt the light of suns, which enters a volume from outside. That of a lamp deep inside spreads like no
sun's: how much of it an albedo below 1 leaves does not follow from the transport for albedo 1 that networks read.
Solved for the true albedo, the transport itself holds the light: with its fluence phi and flux F, what scatters towards
the camera is

    (phi - 3 G F . omega) / (4 pi) + p(omega . l) E (exp(-(1 - w G^2) tau) - exp(-tau)),

where the second term is the light of the lamp, of irradiance E behind an optical depth tau, that has scattered into the
phase function's forward peak, which the transport counts as unscattered.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..scene.phase_function import henyey_greenstein
from ..transport.scattered_fluence import MIN_SHARE, PROBES, FluenceLattice

# Optical depths around a lamp, -log(1 - captured) with `LampInMedia.captured`, up to which networks predict its
# multiple scattering alone, and from which on the transport does.
OUTSIDE, INSIDE = 2.0, 6.0
#: Added to the fluence, over that of the brightest cell, before taking its logarithm.
MIN_FLUENCE = 1e-12
#: Smallest albedo for which the transport is solved.
MIN_ALBEDO = 1e-3


def inside_share(captured: float) -> float:
    """Share of the transport alone in a lamp's multiple scattering, 0 to 1."""
    depth = -np.log(max(1.0 - captured, 1e-30))
    return float(np.clip((depth - OUTSIDE) / (INSIDE - OUTSIDE), 0.0, 1.0))


@dataclass(frozen=True)
class LampInside:
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
        read = light.read(positions, omega, towards, g)
        # The column of the flux along the ray, over the fluence.
        share = np.maximum(1.0 - 3.0 * g * read[:, PROBES + 1], MIN_SHARE)
        found = np.exp(read[:, 0].astype(np.float64)) * (scale / (4.0 * np.pi)) * share
        peak = np.exp(-(1.0 - albedo * g * g) * depth) - np.exp(-depth)
        return found + henyey_greenstein((omega * towards).sum(axis=1), g) * irradiance * peak
