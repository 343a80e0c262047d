"""A volume as networks of kind "lattice", which is RPNN, read it."""

import threading
from dataclasses import dataclass

import numpy as np

from ..features.descriptors import angle_to_sun
from ..features.mip_lattices import DENSITY_SCALE, density_pyramid
from ..features.rpnn_lattice import POINTS, SunLattice, read_lattices, refined_levels
from ..grids.working_cube import level0_density
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL
from .conditions import Conditions


def density_feature(sigma_hat, density):
    """log(1 + sigma_hat * density / 64), as the stencil's networks see density."""
    return np.log1p(density * np.float32(1.0 / DENSITY_SCALE) * sigma_hat)


class LatticePredictor:
    """Density at RPNN's lattices, for a network that reads it.

    network: whose `points` are the SunLattice. cube: of the volume. The anisotropy is the one that it was trained for.
    Safe on several threads. Raises Cancelled.
    """

    needs_ray_features = False
    respects_surfaces = False

    def __init__(self, network, volume, cube, anisotropy: float, cancel: CancelToken = NEVER):
        self.network = network
        self.density = refined_levels(density_pyramid(level0_density(volume, cube, cancel)))
        self._lock, self._features = threading.Lock(), (None, None)

    @staticmethod
    def read_points(values) -> SunLattice:
        """The lattice from the floats of a weights file."""
        return SunLattice(values.reshape(POINTS, 3))

    def prepare(self, conditions: Conditions, tasks=SERIAL) -> "PreparedLattice":
        """What predicts under these conditions; bounds and surfaces are not used. Raises Cancelled."""
        sigma_hat = conditions.sigma_hat
        with tasks.cancel.locked(self._lock):
            if self._features[0] != sigma_hat:
                features = list(tasks.each(lambda level: density_feature(np.float32(sigma_hat), level), self.density))
                self._features = sigma_hat, features
            return PreparedLattice(self.network, self._features[1], np.asarray(conditions.sun, np.float64))


@dataclass(frozen=True)
class PreparedLattice:
    """A LatticePredictor under certain conditions; features: of each level; sun: (3,) in the cube's frame."""

    network: object
    features: list
    sun: np.ndarray
    lattice_cells = 0

    def predict(self, positions, omega, albedos, jitter=None, ray_features=None) -> np.ndarray:
        """Radiance float32 (A, N) at points of the cube's frame, (N, 3); jitter: as for `read_lattices`."""
        lattice = read_lattices(self.network.points, self.features, positions, omega, self.sun, jitter)
        gamma = angle_to_sun(omega, self.sun)
        return self.network.run(lattice=lattice, gamma=gamma, albedo=albedos)
