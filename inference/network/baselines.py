# SPDX-License-Identifier: GPL-3.0-or-later
"""Alternatives to a network: single scattering alone, and the multi-octave approximation.

Both are a `System`, under names that no list of networks shows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..features.descriptors import angle_to_sun
from ..grids.working_cube import Cube
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL, AnyTasks
from ..scene.description import Volume
from ..scene.phase_function import henyey_greenstein
from ..transport.discrete_ordinates import CELLS
from ..transport.scattered_fluence import ScatteredFluence
from .conditions import LitConditions, RayPoints
from .interfaces import Predictor, PreparedPrediction
from .network import register_system

SINGLE, OCTAVES = "single-scattering", "multi-octave"
# Wrenninge, Kulla, Lundqvist: "Oz: The Great and Volumetric", 2013: attenuation, contribution and eccentricity of each
# octave are these factors times those of the last. The first octave is single scattering.
OCTAVE_COUNT = 8
ATTENUATION = CONTRIBUTION = ECCENTRICITY = 0.5


@dataclass(frozen=True)
class Baseline:
    """A System without weights, for any medium. name: SINGLE or OCTAVES."""

    name: str
    checksum = ""
    anisotropy_range = (-1.0, 1.0)
    sigma_hat_range = (0.0, np.inf)
    albedo_range = (0.0, 1.0)
    deviation = None

    def predictor(
        self,
        volume: Volume,
        cube: Cube,
        anisotropy: float,
        cancel: CancelToken = NEVER,
    ) -> "BaselinePredictor":
        """What predicts in one volume; reads nothing of it."""
        return BaselinePredictor(self.name, cube, anisotropy)


@dataclass(frozen=True)
class BaselinePredictor(Predictor):
    """Of a baseline. name: of the baseline."""

    name: str
    cube: Cube
    anisotropy: float
    respects_surfaces = respects_albedo = False

    def prepare(self, conditions: LitConditions, tasks: AnyTasks = SERIAL) -> PreparedPrediction:
        """What predicts for one sun."""
        return MultiOctave(self.anisotropy, conditions.light.direction) if self.name == OCTAVES else SingleScattering()

    def fluence(self, lights: Sequence[LitConditions], tasks: AnyTasks = SERIAL) -> ScatteredFluence | None:
        """None scattered: the octaves read the optical depth towards the sun alone."""
        dark = np.zeros((CELLS, CELLS, CELLS, 4), np.float16)
        return ScatteredFluence.in_cube(self.cube, [dark] * len(lights), 0.0) if self.name == OCTAVES else None


class SingleScattering:
    """No multiple scattering; a `PreparedPrediction`."""

    scale = 1.0

    def predict(self, points: RayPoints, albedos: np.ndarray) -> np.ndarray:
        """float32 (A, N) of zeros."""
        return np.zeros((len(albedos), len(points)), np.float32)


@dataclass(frozen=True)
class MultiOctave:
    """Octaves of single scattering, each fainter, less attenuated and less directed; a `PreparedPrediction`.

    anisotropy: of the medium. sun: (3,) in the cube's frame.
    """

    anisotropy: float
    sun: np.ndarray
    scale = 1.0

    def predict(self, points: RayPoints, albedos: np.ndarray) -> np.ndarray:
        """float32 (A, N), octaves from the second on. Raises ValueError without ray features."""
        if points.ray_features is None:
            raise ValueError("the multi-octave approximation needs ray features")
        cosine, tau_sun = np.cos(angle_to_sun(points.directions, self.sun)), points.ray_features[:, 0]
        total = np.zeros(len(points), np.float32)
        for octave in range(1, OCTAVE_COUNT):
            phase = henyey_greenstein(cosine, self.anisotropy * ECCENTRICITY**octave)
            total += CONTRIBUTION**octave * phase * np.exp(-(ATTENUATION**octave) * tau_sun)
        return np.repeat(total[None], len(albedos), axis=0)


def register_baselines() -> None:
    """Let Settings.model name the baselines."""
    register_system(SINGLE, lambda: Baseline(SINGLE), listed=False)
    register_system(OCTAVES, lambda: Baseline(OCTAVES), listed=False)
