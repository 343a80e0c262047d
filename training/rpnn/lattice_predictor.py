# SPDX-License-Identifier: GPL-3.0-or-later
"""How networks of kind "lattice", which is RPNN, read a volume."""

import threading
from dataclasses import dataclass

import numpy as np

from inference.features.descriptors import angle_to_sun
from inference.features.mip_lattices import DENSITY_SCALE, density_pyramid
from inference.grids.working_cube import Cube, mean_density
from inference.network.conditions import LitConditions, RayPoints
from inference.network.interfaces import PointNetwork, Predictor
from inference.runtime.cancellation import NEVER, CancelToken
from inference.runtime.tasks import SERIAL, AnyTasks
from inference.scene.description import Volume

from .rpnn_lattice import SunLattice, read_lattices, refined_levels


def density_feature(sigma_hat: np.float32, density: np.ndarray) -> np.ndarray:
    """log(1 + sigma_hat * density / DENSITY_SCALE), like the density feature of the stencil's networks."""
    return np.log1p(density * np.float32(1.0 / DENSITY_SCALE) * sigma_hat)


class LatticePredictor(Predictor):
    """Density on RPNN's lattices, for a network that reads it; a `Predictor`.

    network: whose `points` are the SunLattice. cube: of the volume. anisotropy: unused, it is that of the training.
    Safe on several threads. Raises Cancelled.
    """

    respects_surfaces = respects_albedo = False

    def __init__(
        self,
        network: PointNetwork[SunLattice],
        volume: Volume,
        cube: Cube,
        anisotropy: float,
        cancel: CancelToken = NEVER,
    ):
        self.network = network
        self.density = refined_levels(density_pyramid(mean_density(volume, cube, cancel)))
        self._lock = threading.Lock()
        self._features: tuple[float, list[np.ndarray]] | None = None

    def prepare(self, conditions: LitConditions, tasks: AnyTasks = SERIAL) -> "PreparedLattice":
        """What predicts under these conditions; bounds and surfaces are not used. Raises Cancelled."""
        sigma_hat = conditions.sigma_hat
        with tasks.cancel.locked(self._lock):
            if self._features is None or self._features[0] != sigma_hat:
                features = list(tasks.each(lambda level: density_feature(np.float32(sigma_hat), level), self.density))
                self._features = sigma_hat, features
            return PreparedLattice(self.network, self._features[1], np.asarray(conditions.light.direction, np.float64))


@dataclass(frozen=True)
class PreparedLattice:
    """A LatticePredictor under certain conditions; a `PreparedPrediction`.

    features: density feature of each level. sun: (3,) in the cube's frame.
    """

    network: PointNetwork[SunLattice]
    features: list[np.ndarray]
    sun: np.ndarray
    scale = 1.0

    def predict(self, points: RayPoints, albedos: np.ndarray) -> np.ndarray:
        """As PreparedPrediction; ray features are not used."""
        lattice = read_lattices(
            self.network.points, self.features, points.positions, points.directions, self.sun, points.jitter
        )
        gamma = angle_to_sun(points.directions, self.sun)
        return self.network.run(lattice=lattice, gamma=gamma, albedo=albedos)
