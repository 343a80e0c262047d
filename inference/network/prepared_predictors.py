# SPDX-License-Identifier: GPL-3.0-or-later
"""Predicted multiple scattering in one volume for one extinction and light, at world positions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..grids.working_cube import Cube
from .conditions import PredictedLight, RayPoints
from .interfaces import PreparedPrediction
from .lamp_nearby import LampNearby, NearbyPoints
from .prepared_rays import PreparedRays
from .uncertainty import Predicted, UncertaintyNetwork

# Standard deviation of the relative error where the coarse transport takes the network's place, around lamps near a
# volume or inside it; docs/understand/method-details.md, Compose.
NEARBY_DEVIATION = 0.08


class RadiancePredictor(Protocol):
    """A VolumePredictor for one extinction and one light of strength 1. Immutable."""

    @property
    def alone(self) -> bool:
        """Whether the coarse transport alone is the light, which varies along rays as that of a lamp close by."""

    def predict(self, points: RayPoints, albedos: Sequence[float]) -> np.ndarray:
        """Radiance float32 (A, N) at points of the world, for A albedos."""

    def deviation(self, network: UncertaintyNetwork, points: RayPoints, radiance: Predicted) -> np.ndarray:
        """Standard deviations float32 (A, N) of the errors of predicted radiance, over it.

        radiance: (N,), of each of A albedos, as `predict` gives it for these points.
        """


@dataclass(frozen=True, kw_only=True)
class PreparedPredictor:
    """What the network predicts; a `RadiancePredictor`.

    used: ratio of the optical thickness within the network's range to the true one. most: upper bound of the radiance
    for an irradiance of 1. outside: as of `VolumePredictor.outside`.
    """

    prediction: PreparedPrediction
    light: PredictedLight
    cube: Cube
    albedo_range: tuple[float, float]
    used: float
    most: np.float32
    outside: float
    alone = False

    def predict(self, points: RayPoints, albedos: Sequence[float]) -> np.ndarray:
        """As of RadiancePredictor."""
        asked = self._asked(points)
        radiance = self.prediction.predict(asked, np.clip(albedos, *self.albedo_range))
        # No point scatters more than the most that the brightest of the light can become.
        bound = self.most * np.maximum(asked.irradiance, self.prediction.scale)
        scale = np.float32(min(1.0 / self.used, 1.0))
        return np.minimum(radiance * asked.irradiance, bound).astype(np.float32) * scale

    def deviation(self, network: UncertaintyNetwork, points: RayPoints, radiance: Predicted) -> np.ndarray:
        """As of RadiancePredictor."""
        return np.hypot(self.within(network, points, radiance), np.float32(self.outside))

    def within(self, network: UncertaintyNetwork, points: RayPoints, radiance: Predicted) -> np.ndarray:
        """As `deviation`, of a medium within the trained range."""
        # Only for these a network tells it.
        assert isinstance(self.prediction, PreparedRays)
        asked = self._asked(points)
        irradiance = np.maximum(asked.irradiance, 1e-30).astype(np.float32)
        of_sun = {albedo: predicted / irradiance for albedo, predicted in radiance.items()}
        return self.prediction.deviation(network, asked, of_sun)

    def _asked(self, points: RayPoints) -> RayPoints:
        """Points of the world, as networks are asked at them."""
        irradiance = self.light.irradiance(points.positions)
        return replace(points.in_cube(self.cube), irradiance=irradiance).thickened(self.used)


@dataclass(frozen=True, kw_only=True)
class NearbyPredictor:
    """What the coarse transport tells of lamps near a volume, in part or altogether; a `RadiancePredictor`.

    network: the other part, None without any. outside: as of `VolumePredictor.outside`.
    """

    nearby: LampNearby
    cube: Cube
    network: PreparedPredictor | None
    outside: float

    @property
    def alone(self) -> bool:
        """As of RadiancePredictor."""
        return self.network is None

    def predict(self, points: RayPoints, albedos: Sequence[float]) -> np.ndarray:
        """As of RadiancePredictor."""
        depths, asked = points.lamp_depths, points.in_cube(self.cube)
        if depths is None:
            assert points.ray_features is not None
            depths = points.ray_features[None, :, 0]
        near = NearbyPoints(points.positions, asked.positions, asked.directions, depths)
        told = np.stack([self.nearby.radiance(albedo, near) for albedo in albedos])
        if self.network is not None:
            told *= self.nearby.share
            told += (1.0 - self.nearby.share) * self.network.predict(points, albedos)
        return told

    def deviation(self, network: UncertaintyNetwork, points: RayPoints, radiance: Predicted) -> np.ndarray:
        """As of RadiancePredictor."""
        share = self.nearby.share
        deviations = np.full((len(radiance), len(points)), share * NEARBY_DEVIATION, np.float32)
        if self.network is not None:
            deviations += np.float32(1.0 - share) * self.network.within(network, points, radiance)
        return np.hypot(deviations, np.float32(self.outside))
