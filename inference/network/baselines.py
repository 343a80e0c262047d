"""What a user could choose instead of a network: single scattering alone, and the multi-octave approximation.

Both are networks as `network.py` describes them, under names that no list of networks shows.
"""

import numpy as np

from ..features.descriptors import angle_to_sun
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL
from ..scene.phase_function import henyey_greenstein
from .conditions import Conditions
from .network import register_system

SINGLE, OCTAVES = "single-scattering", "multi-octave"
# Wrenninge, Kulla, Lundqvist: "Oz: The Great and Volumetric", 2013: attenuation, contribution and
# eccentricity of each octave are these times the last one's. The first octave is single scattering.
OCTAVE_COUNT = 8
ATTENUATION = CONTRIBUTION = ECCENTRICITY = 0.5


class _Baseline:
    """A system without weights, for any medium; for one volume its own predictor, and prepared for one sun, too."""

    checksum = ""
    anisotropy_range = (-1.0, 1.0)
    sigma_hat_range = (0.0, np.inf)
    albedo_range = (0.0, 1.0)
    respects_surfaces = False
    lattice_cells = 0

    def __init__(self, anisotropy: float = 0.0, sun=None):
        self.anisotropy, self.sun = anisotropy, sun

    def predictor(self, volume, cube, anisotropy: float, cancel: CancelToken = NEVER):
        return type(self)(anisotropy)

    def prepare(self, conditions: Conditions, tasks=SERIAL):
        return type(self)(self.anisotropy, conditions.sun)

    def fluence(self, suns, tasks=SERIAL):
        """None: baselines look nothing up."""


class SingleScattering(_Baseline):
    """No multiple scattering at all."""

    name, needs_ray_features = SINGLE, False

    def predict(self, positions, omega, albedos, jitter=None, ray_features=None) -> np.ndarray:
        """float32 (A, N) of zeros."""
        return np.zeros((len(albedos), len(positions)), np.float32)


class MultiOctave(_Baseline):
    """Single scattering again and again, each octave fainter, less attenuated and less directed."""

    name, needs_ray_features = OCTAVES, True

    def predict(self, positions, omega, albedos, jitter=None, ray_features=None) -> np.ndarray:
        """float32 (A, N): octaves from the second on; ray_features[:, 0] is the optical depth towards the sun."""
        cosine = np.cos(angle_to_sun(omega, self.sun))
        total = np.zeros(len(positions), np.float32)
        for octave in range(1, OCTAVE_COUNT):
            phase = henyey_greenstein(cosine, self.anisotropy * ECCENTRICITY**octave)
            total += CONTRIBUTION**octave * phase * np.exp(-(ATTENUATION**octave) * ray_features[:, 0])
        return np.repeat(total[None], len(albedos), axis=0)


def register_baselines() -> None:
    """Let Settings.model name them."""
    for system in (SingleScattering, MultiOctave):
        register_system(system.name, system, listed=False)
