# SPDX-License-Identifier: GPL-3.0-or-later
"""What tells the light that one group of volumes scatters, of one light in some colour channels.

Images, baked light and single points ask the same estimators. Each is prepared once, from a light and its coarse
transport, and then asked at points.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..marching.ray_features import RayFeatures
from ..transport.scattered_emission import ScatteredEmission
from .albedos import Albedos
from .conditions import RayPoints
from .environment_network import PreparedEnvironment
from .prepared_predictors import RadiancePredictor
from .uncertainty import UncertaintyNetwork

#: A quantity that is told of points: whether light has scattered there for the first time, and a colour channel.
Quantity = tuple[bool, int]
#: Gives the directions (N, 3) in which a light sees rays along directions (N, 3), by their places in the image.
Turn = Callable[[np.ndarray, tuple[np.ndarray, np.ndarray] | None], np.ndarray]


@dataclass(frozen=True)
class LitPoints:
    """N points of rays at which light is asked for, and what was gathered along these.

    positions, directions: float64 (N, 3), in the world; unit vectors along the rays. jitter: as in RayPoints.
    numbers: int (N,) or a slice, of the points in the arrays that follow; None for all of them. group: column of the
    volumes in `suns` and `lamps`, or int (N,) of each point: RayFeatures in the light of each sun and each lamp that
    rays were marched for; None where none was gathered. depths: float32 (M, 2), optical depths ahead
    of the points and behind them, or None. image: where rays of a camera are in its image, (N,) each from the left
    and from above, in pixels; None for other rays.
    """

    positions: np.ndarray
    directions: np.ndarray
    jitter: np.ndarray | None = None
    numbers: np.ndarray | slice | None = None
    group: int | np.ndarray = 0
    suns: RayFeatures | None = None
    lamps: RayFeatures | None = None
    depths: np.ndarray | None = None
    image: tuple[np.ndarray, np.ndarray] | None = None

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def places(self) -> np.ndarray | slice:
        """As `numbers`, a slice for all of them."""
        return slice(None) if self.numbers is None else self.numbers

    def joined(self, numbers: np.ndarray, weights: np.ndarray) -> "LitPoints":
        """Means over the points that have a number in common, int (N,) from 0 on, by weights (N,).

        All of these are on one ray, in one group of volumes. What rays gathered of suns and lamps is left out.
        """
        first = np.unique(numbers, return_index=True)[1]
        total = np.bincount(numbers, weights)
        weights = np.where(total[numbers] > 0.0, weights, 1.0)
        total = np.bincount(numbers, weights)

        def mean(values: np.ndarray) -> np.ndarray:
            return np.stack([np.bincount(numbers, weights * column) / total for column in values.T], axis=1)

        depths = None if self.depths is None else mean(self.depths[self.places]).astype(np.float32)
        return LitPoints(
            positions=mean(self.positions),
            directions=self.directions[first],
            jitter=None if self.jitter is None else self.jitter[first],
            group=self.group if isinstance(self.group, int) else self.group[first],
            depths=depths,
            image=None if self.image is None else (self.image[0][first], self.image[1][first]),
        )

    def take(self, points: np.ndarray | slice) -> "LitPoints":
        """Some of the points, by number, of those that have no jitter and are numbered one after another."""
        assert self.numbers is None and self.jitter is None
        return replace(self, positions=self.positions[points], directions=self.directions[points], numbers=points)


class Estimator(Protocol):
    """Tells the light of one light. Immutable and safe on several threads.

    What it tells does not depend on other points that it is asked at.
    """

    @property
    def strength(self) -> np.ndarray:
        """(3,), what its light is to be multiplied with in each colour channel."""
        return np.ones(3)

    @property
    def quantities(self) -> list[tuple[bool, list[int]]]:
        """What it tells, as of Quantity, with the channels in which it tells the same."""

    @property
    def answers(self) -> int:
        """How many predictions it makes at a point, for the report."""

    @property
    def coloured(self) -> bool:
        """Whether colours come from different directions."""

    @property
    def needs_depths(self) -> bool:
        """Whether it reads optical depths on the ray."""

    @property
    def varies_slowly(self) -> bool:
        """Whether the mean point of several on a ray tells the mean of their light, where these are close together."""

    @property
    def uncertainty(self) -> UncertaintyNetwork | None:
        """What tells the error from point to point, or None."""

    def predict(self, points: LitPoints) -> np.ndarray:
        """What is predicted at points, (A, N, ...), for `radiance` and `deviation`."""

    def radiance(self, predicted: np.ndarray, points: LitPoints) -> dict[Quantity, np.ndarray]:
        """Radiance (N,) that an albedo of 1 scatters towards the camera, for a strength of 1."""

    def deviation(self, predicted: np.ndarray, points: LitPoints) -> np.ndarray:
        """Standard deviation of the error of what was predicted, of its shape; 0 where no network tells it."""
        return np.zeros_like(predicted)

    def light_ahead(self, points: LitPoints) -> np.ndarray | None:
        """Light (N,) that has scattered and arrives from ahead on the ray; None where it is not known."""
        return None

    def unscattered(self, points: LitPoints) -> np.ndarray:
        """Light (N,) that arrives at points without scattering, about; 1 where it is not known."""
        return np.ones(len(points))


@dataclass(frozen=True, kw_only=True)
class LightEstimator:
    """Of a light that the network for suns predicts; an `Estimator`.

    strength: (3,), irradiance or power. predictor: for a strength of 1. features: what rays have gathered of the light
    at points, float32 (N, COLUMNS). irradiance: of a strength of 1 at world positions (N, 3). turn: in which directions
    it sees rays. lamp_depths: of several lamps near a volume the optical depths float32 (K, N) towards each.
    """

    strength: np.ndarray
    albedos: Albedos
    predictor: RadiancePredictor
    features: Callable[[LitPoints], np.ndarray | None]
    irradiance: Callable[[np.ndarray], np.ndarray | np.float32]
    turn: Turn
    lamp_depths: Callable[[LitPoints], np.ndarray | None] | None = None
    uncertainty: UncertaintyNetwork | None = None
    coloured = needs_depths = varies_slowly = False

    @property
    def quantities(self) -> list[tuple[bool, list[int]]]:
        """Multiple scattering."""
        return [(False, channels) for channels in self.albedos.channels]

    @property
    def answers(self) -> int:
        """One for each albedo."""
        return len(self.albedos.values)

    def predict(self, points: LitPoints) -> np.ndarray:
        """Radiance float32 (A, N) of each albedo."""
        return self.predictor.predict(self._asked(points), self.albedos.values)

    def radiance(self, predicted: np.ndarray, points: LitPoints) -> dict[Quantity, np.ndarray]:
        """As of Estimator."""
        return {
            (False, c): row
            for c, row in self.albedos.by_channel(
                predicted, points.positions, self.turn(points.directions, points.image)
            )
        }

    def deviation(self, predicted: np.ndarray, points: LitPoints) -> np.ndarray:
        """As of Estimator."""
        assert self.uncertainty is not None
        # Several channels may have one albedo.
        different = dict(zip(self.albedos.values, predicted))
        deviations = self.predictor.deviation(self.uncertainty, self._asked(points), different)
        relative: np.ndarray = deviations[[list(different).index(albedo) for albedo in self.albedos.values]]
        return relative * predicted

    def light_ahead(self, points: LitPoints) -> np.ndarray | None:
        """As of Estimator."""
        features = self.features(points)
        return None if features is None else features[:, -1]

    def unscattered(self, points: LitPoints) -> np.ndarray:
        """As of Estimator."""
        features, irradiance = self.features(points), np.broadcast_to(self.irradiance(points.positions), len(points))
        reaching = 1.0 if features is None else np.exp(-features[:, 0])
        return irradiance * reaching * float(self.strength.mean())

    def _asked(self, points: LitPoints) -> RayPoints:
        return RayPoints(
            positions=points.positions,
            directions=self.turn(points.directions, points.image),
            jitter=points.jitter,
            ray_features=None if self.lamp_depths else self.features(points),
            lamp_depths=self.lamp_depths(points) if self.lamp_depths else None,
        )


@dataclass(frozen=True)
class EnvironmentEstimator(Estimator):
    """Of environments together; an `Estimator`. channels: that are rendered together."""

    channels: Sequence[int]
    albedos: Albedos
    predictor: PreparedEnvironment
    uncertainty: UncertaintyNetwork | None = None
    needs_depths = True

    @property
    def quantities(self) -> list[tuple[bool, list[int]]]:
        """Single and multiple scattering."""
        return [(once, [c]) for once in (True, False) for c in self.channels]

    @property
    def coloured(self) -> bool:
        """As of Estimator."""
        return self.predictor.skies.channels > 1

    @property
    def varies_slowly(self) -> bool:
        """Where no direction is brighter than another."""
        return self.predictor.skies.even

    @property
    def answers(self) -> int:
        """One for each albedo."""
        return len(self.albedos.values)

    def predict(self, points: LitPoints) -> np.ndarray:
        """Radiance float32 (1 + A, N, C): single scattering, then multiple scattering of each albedo."""
        assert points.depths is not None
        asked = RayPoints(points.positions, points.directions, points.jitter)
        return self.predictor.predict(asked, points.depths[points.places], self.albedos.values)

    def radiance(self, predicted: np.ndarray, points: LitPoints) -> dict[Quantity, np.ndarray]:
        """As of Estimator."""
        told = {}
        for c, row in self.albedos.by_channel(predicted[1:], points.positions, points.directions):
            colour = c if self.coloured else 0
            told[True, c], told[False, c] = predicted[0, :, colour], row[:, colour]
        return told


@dataclass(frozen=True)
class EmissionEstimator(Estimator):
    """Of the light that volumes emit, as one of them scatters it; an `Estimator`. channels: rendered together."""

    channels: Sequence[int]
    emission: ScatteredEmission
    anisotropy: float
    uncertainty: UncertaintyNetwork | None = None
    coloured, needs_depths, varies_slowly, answers = True, False, False, 0

    @property
    def quantities(self) -> list[tuple[bool, list[int]]]:
        """What has scattered, however often."""
        return [(False, [c]) for c in self.channels]

    def predict(self, points: LitPoints) -> np.ndarray:
        """Radiance (C, N)."""
        return self.emission.scattered(self.channels, points.positions, points.directions, self.anisotropy)

    def radiance(self, predicted: np.ndarray, points: LitPoints) -> dict[Quantity, np.ndarray]:
        """As of Estimator."""
        return {(False, c): row for c, row in zip(self.channels, predicted)}
