"""A volume as networks of kinds "stencil" and "ray" read it."""

import numpy as np

from .cube import level0_density
from .descriptors import FieldLookup, angle_to_sun, describe, distinct_rows
from .diffusion import CELLS, LEVEL, DiffusedLight, finer, log_fluence, read_fluence
from .fields import build_lattices, density_pyramid, lit_levels, padded_levels, unit_optical_depths
from .phase import PhaseFeatures
from .stencil import LOW_POINTS, POINTS, Stencil
from .walls import Walls

# Suns and optical densities whose diffused light a field keeps.
MOST_FLUENCES = 64
# Places along an edge of a cell of the diffused light at which surfaces may shade it.
LIT_CELL_PARTS = 3


class StencilField:
    """Density, transmittance and phase function at A.2's stencil, and the network that reads them.

    network: its `points` are the Stencil; cube: of the volume; check: asked often.
    """

    needs_light = False

    def __init__(self, network, volume, cube, anisotropy: float, check=lambda: None):
        self.network, self.cube, self.anisotropy = network, cube, anisotropy
        pyramid = density_pyramid(level0_density(volume, cube, check))
        self.padded = padded_levels(pyramid, network.points)
        self.lattices, self.built, self.sun_maps = None, None, {}
        self.prepare(pyramid)

    def prepare(self, pyramid):
        """What does not depend on optical density and sun."""
        self.phase = PhaseFeatures(self.network.points, self.anisotropy)

    def meet(self, sun_maps, triangles):
        """Know opaque surfaces, in the cube's frame, for what is prepared from now on.

        sun_maps: SunMaps by sun (3,), as a tuple; triangles: (T, 3, 3) of surfaces that end scattered light.
        """
        self.sun_maps = sun_maps

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
        sun_map = self.sun_maps.get(tuple(sun))
        lit = lit_levels(self.network.points, sun_map) if sun_map else None
        self.lattices = build_lattices(self.padded, depths, sigma_hat, self.network.points, low, high, mapper, earlier, lit)
        self.lookup = FieldLookup(self.network.points, self.lattices, sun)
        self.built = built

    def predict(self, positions, omega, albedos, jitter=None, light=None) -> np.ndarray:
        """Radiance float32 (A, N) at points of the cube's frame, (N, 3); jitter: as FieldLookup has it."""
        features, gamma = describe(self.lookup, self.phase, positions, omega, jitter)
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        return self.network.run(features=features, anisotropy=anisotropy, gamma=gamma, albedo=albedos)


class RayField(StencilField):
    """Density and transmittance at A.2's stencil, light along the camera ray and diffused, and the network."""

    needs_light = True

    def prepare(self, pyramid):
        self.coarse, self.fluences, self.walls = pyramid[LEVEL], {}, None

    def meet(self, sun_maps, triangles):
        super().meet(sun_maps, triangles)
        self.fluences.clear()
        walls = Walls(triangles, CELLS)
        self.walls = None if walls.empty else walls

    def light(self, sigma_hat: float, sun, low, high, mapper=map):
        super().light(sigma_hat, sun, low, high, mapper)
        self.fluence = self.log_fluence(sigma_hat, sun)

    def log_fluence(self, sigma_hat: float, sun):
        """As `diffusion.log_fluence`, solved once for each optical density and sun."""
        key = sigma_hat, *sun
        if key not in self.fluences:
            if len(self.fluences) >= MOST_FLUENCES:
                self.fluences.clear()
            sun_map = self.sun_maps.get(tuple(sun))
            lit = sun_map.lit_cells(CELLS, parts=LIT_CELL_PARTS) if sun_map else 1.0
            self.fluences[key] = log_fluence(self.coarse, sun, sigma_hat * (1.0 - self.anisotropy), lit, self.walls)
        return self.fluences[key]

    def diffused_light(self, sigma_hat: float, suns, mapper=map) -> DiffusedLight:
        """For camera rays; suns: (3,) each, in the cube's frame."""
        logs = mapper(lambda sun: self.log_fluence(sigma_hat, sun), suns)
        return DiffusedLight.in_cube(self.cube, [finer(field) for field in logs])

    def predict(self, positions, omega, albedos, jitter=None, light=None) -> np.ndarray:
        """Radiance float32 (A, N) at points of the cube's frame, (N, 3); light: (N, COLUMNS), as RayLight gives it."""
        first, view = distinct_rows(omega)
        stencil = self.lookup(positions, omega[first], view, jitter).reshape(len(positions), -1)
        gamma = angle_to_sun(omega[first], self.sun)
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        ray = np.concatenate([light, read_fluence(self.fluence, positions, omega, self.sun)], axis=1)
        return self.network.run(stencil=stencil, ray=ray, view=view, anisotropy=anisotropy, gamma=gamma, albedo=albedos)
