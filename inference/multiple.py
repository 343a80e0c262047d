"""Predicted multiple scattering: one volume's fields, descriptors and network together."""

import numpy as np

from .cube import fit_cube, level0_density
from .descriptors import describe
from .fields import build_lattices, density_pyramid, padded_levels, unit_optical_depths
from .network import Network, load_network
from .phase import PhaseFeatures
from .plan import distinct_albedos
from .scene import Medium, Volume

# Points a network call.
POINTS_A_TASK = 2048


class MultipleField:
    """Everything that predicts multiple scattering in one volume, for one extinction and sun.

    Outside the range of optical density that the network was trained on, the prediction is that at the
    range's end: scaled down in proportion below it, where multiple scattering is
    linear in density, and held above it.
    """

    def __init__(self, network: Network, volume: Volume, medium: Medium):
        self.network, self.volume, self.medium = network, volume, medium
        self.cube = fit_cube(volume)
        self.padded = padded_levels(density_pyramid(level0_density(volume, self.cube)), network.stencil)
        low, high = network.anisotropy_range
        self.anisotropy = float(np.clip(medium.anisotropy, low, high))
        self.phase = PhaseFeatures(network.stencil, self.anisotropy)

    def warnings(self, sigma_t: float):
        found = []
        if self.anisotropy != self.medium.anisotropy:
            found.append(
                f"{self.volume.name}: anisotropy {self.medium.anisotropy:g} is outside the network's range; "
                f"multiple scattering uses {self.anisotropy:g}"
            )
        peak = self.peak_sigma_hat(sigma_t)
        if peak > self.network.sigma_hat_range[1]:
            found.append(
                f"{self.volume.name}: optical density {peak:.3g} is beyond the network's range of "
                f"{self.network.sigma_hat_range[1]:g}; multiple scattering is less accurate"
            )
        return found

    def peak_sigma_hat(self, sigma_t: float) -> float:
        return sigma_t * self.cube.edge * float(self.volume.density.max())

    def bounds(self, positions: np.ndarray):
        """Lowest and highest coordinates (3,) in the cube's frame of world positions (N, 3)."""
        points = self.cube.positions(positions)
        return points.min(axis=0), points.max(axis=0)

    def light(self, sigma_t: float, direction: np.ndarray, low, high, mapper=map):
        """Prepare the lattices for one sun and the points between `low` and `high`, from `bounds`.

        direction: (3,) in the world; mapper: as in `build_lattices`.
        """
        self.sun = self.cube.directions(direction)
        peak = self.peak_sigma_hat(sigma_t)
        smallest, largest = self.network.sigma_hat_range
        used = min(max(peak, smallest), largest)
        self.scale = np.float32(min(peak / smallest, 1.0))
        sigma_hat = sigma_t * self.cube.edge * used / peak
        depths = unit_optical_depths(self.padded, self.sun)
        self.lattices = build_lattices(self.padded, depths, sigma_hat, self.network.stencil, low, high, mapper)

    def predict(self, positions, directions, albedos, jitter=None) -> np.ndarray:
        """float32 (A, N) at world positions (N, 3) for camera rays along directions (N, 3).

        jitter: as in `describe`.
        """
        features, gamma = describe(
            self.network.stencil,
            self.lattices,
            self.phase,
            self.cube.positions(positions),
            self.cube.directions(directions),
            self.sun,
            jitter,
        )
        return self.network.multiple(features, self.anisotropy, gamma, albedos) * self.scale


def predict_multiple(volume, medium, sun, positions, directions, model="mrpnn") -> np.ndarray:
    """Multiple-scattered in-scattered radiance at points, as the network sees it.

    positions, directions: (N, 3) world positions and unit camera-ray directions.
    Returns float32 (N, 3), W/(m^2 sr) for the sun's irradiance; the pixel's albedo factor is not included.
    Raises SceneError as `render` does.
    """
    positions = np.asarray(positions, np.float64).reshape(-1, 3)
    directions = np.asarray(directions, np.float64).reshape(-1, 3)
    result = np.zeros((len(positions), 3), np.float32)
    if not len(positions):
        return result
    field = MultipleField(load_network(model), volume, medium)
    for sigma_t in np.unique(medium.sigma_t[medium.sigma_t > 0.0]):
        members = [c for c in range(3) if medium.sigma_t[c] == sigma_t]
        albedos = distinct_albedos(medium, members)
        if not albedos:
            continue
        field.light(float(sigma_t), sun.direction, *field.bounds(positions))
        for i in range(0, len(positions), POINTS_A_TASK):
            span = slice(i, i + POINTS_A_TASK)
            radiance = field.predict(positions[span], directions[span], [value for value, _ in albedos])
            for (_, channels), row in zip(albedos, radiance):
                for c in channels:
                    result[span, c] = row * sun.irradiance[c]
    return result
