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
from .ray_points import RayPoints
from .uncertainty import UncertaintyNetwork

# Standard deviation of the relative error where the coarse transport takes the network's place, around lamps near a
# volume or inside it; docs/method-details.md, Compose.
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

    def predict(self, points: RayPoints, albedos: Sequence[float]) -> np.ndarray:
        """Radiance float32 (A, N) at points of the world, for A albedos."""
        scale = np.float32(min(1.0 / self.used, 1.0))
        asked = points.in_cube(self.cube).thickened(self.used)
        radiance = self.prediction.predict(asked, np.clip(albedos, *self.albedo_range))
        return np.minimum(radiance, self.most) * scale

    def deviation(
        self, network: UncertaintyNetwork, points: RayPoints, radiance: Mapping[float, np.ndarray]
    ) -> np.ndarray:
        """Standard deviations float32 (A, N) of the errors of predicted radiance, over it.

        radiance: (N,), of each of A albedos, as `predict` gives it for these points.
        """
        prediction: Any = self.prediction
        found = prediction.deviation(network, points.in_cube(self.cube).thickened(self.used), radiance)
        return np.hypot(found, np.float32(self.outside))


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

    def predict(self, points: RayPoints, albedos: Sequence[float]) -> np.ndarray:
        """As PreparedPredictor; the ray features are those of `march_lamps`."""
        asked, irradiance = points.in_cube(self.cube), self._irradiance(points)
        if self.nearby is None:
            return self._of_network(asked, irradiance, albedos)
        assert points.ray_features is not None
        # What a spot's cone or an area light's side withholds is no optical depth: nothing scatters forwards there.
        fluence = self.lamp.fluence(points.positions)
        given = np.minimum(fluence / np.maximum(self.lamp.reference(points.positions), 1e-30), 1.0)
        depth = np.maximum(points.ray_features[:, 0] + np.log(np.maximum(given, 1e-30)), 0.0)
        share, received = self.nearby.share, softened(fluence, FORWARD_RADIUS * self.radius)
        centre = self.cube.positions(self.lamp.centre[None])[0]
        light = self.nearby.lit(centre, asked.positions, received, depth)
        each = [self.nearby.radiance(albedo, asked.positions, asked.directions, light) for albedo in albedos]
        found = np.stack(each).astype(np.float32)
        if share < 1.0:
            found *= share
            found += (1.0 - share) * self._of_network(asked, irradiance, albedos)
        return found

    def deviation(
        self, network: UncertaintyNetwork, points: RayPoints, radiance: Mapping[float, np.ndarray]
    ) -> np.ndarray:
        """As PreparedPredictor."""
        share = self.nearby.share if self.nearby else 0.0
        found = np.full((len(radiance), len(points)), share * NEARBY_DEVIATION, np.float32)
        if share < 1.0:
            assert self.prediction is not None
            irradiance = self._irradiance(points)
            of_sun = {
                albedo: predicted / np.maximum(irradiance, 1e-30).astype(np.float32)
                for albedo, predicted in radiance.items()
            }
            asked = points.in_cube(self.cube).thickened(self.used)
            found += np.float32(1.0 - share) * self.prediction.deviation(network, asked, irradiance, of_sun)
        return np.hypot(found, np.float32(self.outside))

    def _irradiance(self, points: RayPoints) -> np.ndarray:
        """Irradiance (N,) at points of the world."""
        return softened(self.lamp.reference(points.positions), self.radius)

    def _of_network(self, points: RayPoints, irradiance: np.ndarray, albedos: Sequence[float]) -> np.ndarray:
        """As `predict`, by the network alone; points: in the cube's frame."""
        assert self.prediction is not None
        known = np.clip(albedos, *self.albedo_range)
        radiance = self.prediction.predict(points.thickened(self.used), irradiance, known)
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

    def predict(self, points: RayPoints, along: np.ndarray, albedos: Sequence[float]) -> np.ndarray:
        """As `PreparedEnvironment.predict`, at points of the world."""
        return self.prediction.predict(points.in_cube(self.cube), along, self.skies.shares(points.positions), albedos)
