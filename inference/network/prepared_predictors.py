# SPDX-License-Identifier: GPL-3.0-or-later
"""Predicted multiple scattering in one volume for one extinction and light, at world positions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..grids.working_cube import Cube
from ..marching.joined_lamps import PredictedLamp
from ..marching.lamp_in_media import softened
from ..transport.environment_light import Skies
from .environment_network import PreparedEnvironment
from .interfaces import PreparedPrediction
from .lamp_nearby import LampNearby
from .prepared_rays import PreparedLampRays
from .uncertainty import UncertaintyNetwork

# Of the coarse transport, which takes the network's place around a lamp near a volume or inside it; docs/method.md.
NEARBY_DEVIATION = 0.08
# Distance from a lamp within which its light that turned by small angles is not told apart, over that of the transport.
FORWARD_RADIUS = 0.25


@dataclass(frozen=True)
class PreparedPredictor:
    """A VolumePredictor for one extinction and sun. Immutable.

    used: ratio of the optical thickness within the network's range to the true one. most: upper bound of the radiance.
    outside: as of `VolumePredictor.outside`.
    """

    prediction: PreparedPrediction
    cube: Cube
    albedo_range: tuple[float, float]
    used: float
    most: np.float32
    outside: float = 0.0

    @property
    def lattice_cells(self) -> int:
        """Cells of the lookup lattices; 0 for networks without any."""
        return self.prediction.lattice_cells

    def predict(
        self,
        positions: np.ndarray,
        directions: np.ndarray,
        albedos: Sequence[float],
        jitter: np.ndarray | None = None,
        ray_features: np.ndarray | None = None,
    ) -> np.ndarray:
        """Radiance float32 (A, N) at world positions (N, 3) for camera rays along directions (N, 3).

        jitter: (N, 3) in [-1/2, 1/2), offset of the points' lookups in cells. ray_features: float32 (N, COLUMNS) of
        RayFeatures, for networks that need them.
        """
        x, omega = self.cube.positions(positions), self.cube.directions(directions)
        ray_features = _in_range(ray_features, self.used)
        scale = np.float32(min(1.0 / self.used, 1.0))
        radiance = self.prediction.predict(x, omega, np.clip(albedos, *self.albedo_range), jitter, ray_features)
        return np.minimum(radiance, self.most) * scale

    def deviation(
        self,
        network: UncertaintyNetwork,
        positions: np.ndarray,
        directions: np.ndarray,
        radiance: Mapping[float, np.ndarray],
        jitter: np.ndarray | None = None,
        ray_features: np.ndarray | None = None,
    ) -> np.ndarray:
        """Standard deviations float32 (A, N) of the errors of predicted radiance, over it.

        radiance: (N,), of each of A albedos, as `predict` gives it; the other arguments as there.
        """
        x, omega = self.cube.positions(positions), self.cube.directions(directions)
        prediction: Any = self.prediction
        found = prediction.deviation(network, x, omega, radiance, jitter, _in_range(ray_features, self.used))
        return np.hypot(found, np.float32(self.outside))


def _in_range(ray_features: np.ndarray | None, used: float) -> np.ndarray | None:
    """Ray features of the optical thickness that the network knows; used: as in PreparedPredictor.

    Depths are proportional to it, and so is the little light that a thin medium scatters.
    """
    if ray_features is None or used == 1.0:
        return ray_features
    return np.concatenate([ray_features[:, :2] * used, ray_features[:, 2:] * max(used, 1.0)], axis=1)


@dataclass(frozen=True)
class LampLight:
    """A lamp of power 1 whose light is to be predicted.

    radius: by which its light is softened. albedos: distinct ones of the medium.
    """

    lamp: PredictedLamp
    radius: float
    albedos: Sequence[float]


@dataclass(frozen=True)
class PreparedLampPredictor:
    """A VolumePredictor for one extinction and lamp, of power 1. Immutable.

    prediction: None where the network is not asked. used, most: as in PreparedPredictor, `most` for an irradiance of 1.
    radius: by which the lamp's light is softened. nearby: what replaces the network in part or altogether, or None.
    outside: as of `VolumePredictor.outside`.
    """

    prediction: PreparedLampRays | None
    cube: Cube
    albedo_range: tuple[float, float]
    used: float
    most: np.float32
    lamp: PredictedLamp
    radius: float
    nearby: LampNearby | None = None
    outside: float = 0.0

    @property
    def alone(self) -> bool:
        """Whether the coarse transport alone is the light, which varies along rays as that of a lamp close by."""
        return self.prediction is None

    @property
    def lattice_cells(self) -> int:
        """Cells of the lookup lattices; 0 where there are none."""
        return self.prediction.lattice_cells if self.prediction else 0

    def predict(
        self,
        positions: np.ndarray,
        directions: np.ndarray,
        albedos: Sequence[float],
        jitter: np.ndarray | None = None,
        ray_features: np.ndarray | None = None,
    ) -> np.ndarray:
        """As PreparedPredictor; the ray features are those of `march_lamps`."""
        x, omega, irradiance = self._lit(positions, directions)
        if self.nearby is None:
            return self._of_network(x, omega, irradiance, albedos, jitter, ray_features)
        assert ray_features is not None
        # What a spot's cone or an area light's side withholds is no optical depth: nothing scatters forwards there.
        fluence = self.lamp.fluence(positions)
        given = np.minimum(fluence / np.maximum(self.lamp.reference(positions), 1e-30), 1.0)
        depth = np.maximum(ray_features[:, 0] + np.log(np.maximum(given, 1e-30)), 0.0)
        share, received = self.nearby.share, softened(fluence, FORWARD_RADIUS * self.radius)
        centre = self.cube.positions(self.lamp.centre[None])[0]
        light = self.nearby.lit(centre, x, received, depth)
        found = np.stack([self.nearby.radiance(albedo, x, omega, light) for albedo in albedos]).astype(np.float32)
        if share < 1.0:
            found *= share
            found += (1.0 - share) * self._of_network(x, omega, irradiance, albedos, jitter, ray_features)
        return found

    def deviation(
        self,
        network: UncertaintyNetwork,
        positions: np.ndarray,
        directions: np.ndarray,
        radiance: Mapping[float, np.ndarray],
        jitter: np.ndarray | None = None,
        ray_features: np.ndarray | None = None,
    ) -> np.ndarray:
        """As PreparedPredictor."""
        share = self.nearby.share if self.nearby else 0.0
        found = np.full((len(radiance), len(positions)), share * NEARBY_DEVIATION, np.float32)
        if share < 1.0:
            assert self.prediction is not None
            x, omega, irradiance = self._lit(positions, directions)
            of_sun = {
                albedo: predicted / np.maximum(irradiance, 1e-30).astype(np.float32)
                for albedo, predicted in radiance.items()
            }
            features = _in_range(ray_features, self.used)
            found += np.float32(1.0 - share) * self.prediction.deviation(
                network, x, omega, irradiance, of_sun, jitter, features
            )
        return np.hypot(found, np.float32(self.outside))

    def _lit(self, positions: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions and camera rays (N, 3) in the cube's frame, and irradiance (N,)."""
        irradiance = softened(self.lamp.reference(positions), self.radius)
        return self.cube.positions(positions), self.cube.directions(directions), irradiance

    def _of_network(
        self,
        x: np.ndarray,
        omega: np.ndarray,
        irradiance: np.ndarray,
        albedos: Sequence[float],
        jitter: np.ndarray | None,
        ray_features: np.ndarray | None,
    ) -> np.ndarray:
        """As `predict`, by the network alone; x, omega: in the cube's frame."""
        assert self.prediction is not None
        radiance = self.prediction.predict(
            x,
            omega,
            irradiance,
            np.clip(albedos, *self.albedo_range),
            jitter,
            _in_range(ray_features, self.used),
        )
        # No point scatters more than the most that the brightest of the light can become.
        bound = self.most * np.maximum(irradiance, self.prediction.scale)
        scale = min(1.0 / self.used, 1.0)
        return np.minimum(radiance * irradiance, bound).astype(np.float32) * np.float32(scale)


@dataclass(frozen=True)
class EnvironmentPredictor:
    """A VolumePredictor for one extinction and the light of environments. Immutable."""

    prediction: PreparedEnvironment
    cube: Cube
    skies: Skies

    @property
    def channels(self) -> int:
        """Channels of the light: 1 if it is grey, else 3."""
        return self.skies.channels

    def predict(
        self,
        positions: np.ndarray,
        directions: np.ndarray,
        along: np.ndarray,
        albedos: Sequence[float],
        jitter: np.ndarray | None = None,
    ) -> np.ndarray:
        """As `PreparedEnvironment.predict`, at world positions (N, 3) for camera rays along directions (N, 3)."""
        x, omega = self.cube.positions(positions), self.cube.directions(directions)
        return self.prediction.predict(x, omega, along, self.skies.shares(positions), albedos, jitter)
