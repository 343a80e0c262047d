"""A volume as networks of kind "lattice", which is RPNN, read it."""

import numpy as np

from .cube import level0_density
from .descriptors import angle_to_sun
from .fields import DENSITY_SCALE, density_pyramid
from .sun_lattice import POINTS, SunLattice, read_lattices, refined_levels


def density_feature(sigma_hat, density):
    """log(1 + sigma_hat * density / 64), as the stencil's networks see density."""
    return np.log1p(density * np.float32(1.0 / DENSITY_SCALE) * sigma_hat)


class LatticeField:
    """Density at RPNN's lattices, and the network that reads it.

    network: its `points` are the SunLattice; cube: of the volume; check: asked often. The anisotropy is the one it
    was trained for.
    """

    needs_light = False

    def __init__(self, network, volume, cube, anisotropy: float, check=lambda: None):
        self.network = network
        self.density = refined_levels(density_pyramid(level0_density(volume, cube, check)))

    @staticmethod
    def read_points(values) -> SunLattice:
        """The lattice from the floats of a weights file."""
        return SunLattice(values.reshape(POINTS, 3))

    def light(self, sigma_hat: float, sun, low, high, mapper=map):
        """Prepare one optical density and sun (3,), in the cube's frame; low and high are not needed."""
        self.sun = np.asarray(sun, np.float64)
        self.features = list(mapper(lambda level: density_feature(np.float32(sigma_hat), level), self.density))

    def predict(self, positions, omega, albedos, jitter=None, light=None) -> np.ndarray:
        """Radiance float32 (A, N) at points of the cube's frame, (N, 3); jitter: as in `read_lattices`."""
        lattice = read_lattices(self.network.points, self.features, positions, omega, self.sun, jitter)
        gamma = angle_to_sun(omega, self.sun)
        return self.network.run(lattice=lattice, gamma=gamma, albedo=albedos)
