"""A volume as networks of kinds "stencil" and "ray" read it."""

import numpy as np

from .cube import level0_density
from .descriptors import angle_to_sun, describe, read_fields
from .diffusion import LEVEL, DiffusedLight, finer, log_fluence, read_fluence
from .fields import build_lattices, density_pyramid, padded_levels, unit_optical_depths
from .phase import PhaseFeatures
from .stencil import LOW_POINTS, POINTS, Stencil

# Suns and optical densities whose diffused light a field keeps.
MOST_FLUENCES = 64


class StencilField:
    """Density, transmittance and phase function at A.2's stencil, and the network that reads them.

    network: its `points` are the Stencil; cube: of the volume; check: asked often.
    """

    needs_light = False

    def __init__(self, network, volume, cube, anisotropy: float, check=lambda: None):
        self.network, self.cube, self.anisotropy = network, cube, anisotropy
        pyramid = density_pyramid(level0_density(volume, cube, check))
        self.padded = padded_levels(pyramid, network.points)
        self.lattices, self.built = None, None
        self.prepare(pyramid)

    def prepare(self, pyramid):
        """What does not depend on optical density and sun."""
        self.phase = PhaseFeatures(self.network.points, self.anisotropy)

    @staticmethod
    def read_points(values) -> Stencil:
        """The stencil from the floats of a weights file."""
        low = values[: 3 * LOW_POINTS].reshape(LOW_POINTS, 3)
        return Stencil(low, values[3 * LOW_POINTS :].reshape(POINTS - LOW_POINTS))

    def light(self, sigma_hat: float, sun, low, high, mapper=map):
        """Prepare one optical density and sun (3,), in the cube's frame, for points from low to high (3,)."""
        self.sun = sun
        depths = unit_optical_depths(self.padded, sun)
        built = sigma_hat, *low, *high
        earlier = self.lattices if built == self.built else None
        # Until all of it is there, nothing is: building may be cancelled.
        self.built = None
        self.lattices = build_lattices(self.padded, depths, sigma_hat, self.network.points, low, high, mapper, earlier)
        self.built = built

    def predict(self, positions, omega, albedos, jitter=None, light=None) -> np.ndarray:
        """Radiance float32 (A, N) at points of the cube's frame, (N, 3); jitter: as in `read_fields`."""
        features, gamma = describe(
            self.network.points, self.lattices, self.phase, positions, omega, self.sun, jitter
        )
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        return self.network.run(features=features, anisotropy=anisotropy, gamma=gamma, albedo=albedos)


class RayField(StencilField):
    """Density and transmittance at A.2's stencil, light along the camera ray and diffused, and the network."""

    needs_light = True

    def prepare(self, pyramid):
        self.coarse, self.fluences = pyramid[LEVEL], {}

    def light(self, sigma_hat: float, sun, low, high, mapper=map):
        super().light(sigma_hat, sun, low, high, mapper)
        self.fluence = self.log_fluence(sigma_hat, sun)

    def log_fluence(self, sigma_hat: float, sun):
        """As `diffusion.log_fluence`, solved once for each optical density and sun."""
        key = sigma_hat, *sun
        if key not in self.fluences:
            if len(self.fluences) >= MOST_FLUENCES:
                self.fluences.clear()
            self.fluences[key] = log_fluence(self.coarse, sun, sigma_hat * (1.0 - self.anisotropy))
        return self.fluences[key]

    def diffused_light(self, sigma_hat: float, suns, mapper=map) -> DiffusedLight:
        """For camera rays; suns: (3,) each, in the cube's frame."""
        logs = mapper(lambda sun: self.log_fluence(sigma_hat, sun), suns)
        return DiffusedLight.in_cube(self.cube, [finer(field) for field in logs])

    def predict(self, positions, omega, albedos, jitter=None, light=None) -> np.ndarray:
        """Radiance float32 (A, N) at points of the cube's frame, (N, 3); light: (N, COLUMNS), as RayLight gives it."""
        stencil = np.empty((len(positions), 2 * POINTS), np.float32)
        mu, transmittance = stencil[:, :POINTS], stencil[:, POINTS:]
        read_fields(self.network.points, self.lattices, positions, omega, self.sun, mu, transmittance, jitter)
        gamma = angle_to_sun(omega, self.sun)
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        ray = np.concatenate([light, read_fluence(self.fluence, positions, omega, self.sun)], axis=1)
        return self.network.run(stencil=stencil, ray=ray, anisotropy=anisotropy, gamma=gamma, albedo=albedos)
