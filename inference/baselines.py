"""What a user could pick instead of a network: single scattering alone, and the multi-octave approximation.

Both are systems as `network.py` describes them, under names that no list of networks shows.
"""

import numpy as np

from .descriptors import angle_to_sun
from .network import register_system
from .phase import henyey_greenstein

SINGLE, OCTAVES = "single-scattering", "multi-octave"
# Wrenninge, Kulla, Lundqvist: "Oz: The Great and Volumetric", 2013: attenuation, contribution and
# eccentricity of each octave are these times the last one's. The first octave is single scattering.
OCTAVE_COUNT = 8
ATTENUATION = CONTRIBUTION = ECCENTRICITY = 0.5


class _Baseline:
    """A system without weights, for any medium."""

    checksum = ""
    anisotropy_range = (-1.0, 1.0)
    sigma_hat_range = (0.0, np.inf)
    albedo_range = (0.0, 1.0)

    def field(self, volume, cube, anisotropy: float, check=lambda: None):
        made = type(self)()
        made.anisotropy = anisotropy
        return made

    def light(self, sigma_hat, sun, low, high, mapper=map):
        self.sun = sun

    def diffused_light(self, sigma_hat, suns, mapper=map):
        """None: baselines read none."""


class SingleScattering(_Baseline):
    """No multiple scattering at all."""

    name, needs_light = SINGLE, False

    def predict(self, positions, omega, albedos, jitter=None, light=None) -> np.ndarray:
        """float32 (A, N) of zeros."""
        return np.zeros((len(albedos), len(positions)), np.float32)


class MultiOctave(_Baseline):
    """Single scattering again and again, each octave fainter, less attenuated and less directed."""

    name, needs_light = OCTAVES, True

    def predict(self, positions, omega, albedos, jitter=None, light=None) -> np.ndarray:
        """float32 (A, N): octaves from the second on; light[:, 0] is the optical depth towards the sun."""
        cosine = np.cos(angle_to_sun(omega, self.sun))
        total = np.zeros(len(positions), np.float32)
        for octave in range(1, OCTAVE_COUNT):
            phase = henyey_greenstein(cosine, self.anisotropy * ECCENTRICITY**octave)
            total += CONTRIBUTION**octave * phase * np.exp(-(ATTENUATION**octave) * light[:, 0])
        return np.repeat(total[None], len(albedos), axis=0)


def register_baselines() -> None:
    """Let Settings.model name them."""
    for system in (SingleScattering, MultiOctave):
        register_system(system.name, system, listed=False)
