"""A volume as networks of kinds "stencil" and "ray" read it."""

import numpy as np

from .cube import level0_density
from .descriptors import FieldLookup, angle_to_sun, describe, distinct_rows
from .diffused_light import DiffusedLight, light_cells, light_of, read_light
from .fields import build_lattices, density_pyramid, lit_levels, padded_levels, unit_optical_depths
from .ordinates import CELLS, LEVEL, Ordinates
from .phase import PhaseFeatures
from .stencil import SPARSE, Stencil

# Suns and optical densities whose diffused light a field keeps.
MOST_LIGHTS = 64
# Places along an edge of a cell of the diffused light at which surfaces may shade it.
LIT_CELL_PARTS = 3


class StencilField:
    """Density, transmittance and phase function at A.2's stencil, and the network that reads them.

    network: its `points` are the Stencil; cube: of the volume; check: asked often.
    """

    needs_light = False

    def __init__(self, network, volume, cube, anisotropy: float, check=lambda: None):
        self.network, self.cube, self.anisotropy, self.check = network, cube, anisotropy, check
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
        return Stencil.read(values)

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
    """Density at a sparse stencil, light along the camera ray and diffused, and the network that reads them."""

    needs_light = True

    @staticmethod
    def read_points(values) -> Stencil:
        return Stencil.read(values, SPARSE)

    def prepare(self, pyramid):
        self.coarse, self.lights, self.triangles, self.ordinates = pyramid[LEVEL], {}, None, (None, None)

    def meet(self, sun_maps, triangles):
        super().meet(sun_maps, triangles)
        self.lights.clear()
        self.triangles, self.ordinates = triangles, (None, None)

    def light(self, sigma_hat: float, sun, low, high, mapper=map):
        self.sun = sun
        built = sigma_hat, *low, *high
        if built != self.built:
            self.built = None
            self.lattices = build_lattices(self.padded, None, sigma_hat, self.network.points, low, high, mapper)
            self.built = built
        self.lookup = FieldLookup(self.network.points, self.lattices, sun)
        self.cells = self.diffused_cells(sigma_hat, sun).astype(np.float32)

    def diffused_cells(self, sigma_hat: float, sun):
        """As `diffused_light.light_cells`, solved once for each optical density and sun."""
        key = sigma_hat, *sun
        if key not in self.lights:
            if len(self.lights) >= MOST_LIGHTS:
                self.lights.clear()
            ordinates = self._ordinates(sigma_hat)
            sun_map = self.sun_maps.get(tuple(sun))
            lit = sun_map.lit_cells(CELLS, parts=LIT_CELL_PARTS) if sun_map else 1.0
            self.lights[key] = light_cells(ordinates.light(sun, lit), ordinates.walls)
        return self.lights[key]

    def _ordinates(self, sigma_hat: float) -> Ordinates:
        """For the optical density of the last call, which the suns of a render share."""
        if self.ordinates[0] != sigma_hat:
            self.ordinates = sigma_hat, Ordinates(self.coarse, sigma_hat, self.anisotropy, self.triangles, self.check)
        return self.ordinates[1]

    def diffused_light(self, sigma_hat: float, suns, mapper=map) -> DiffusedLight:
        """For camera rays; suns: (3,) each, in the cube's frame."""
        self._ordinates(sigma_hat)
        # One after the other: side by side they take longer, since threads wait for Python's lock between short operations.
        cells = [found for sun in suns for found in mapper(lambda sun: self.diffused_cells(sigma_hat, sun), [sun])]
        return DiffusedLight.in_cube(self.cube, [light_of(values) for values in cells], self.anisotropy)

    def predict(self, positions, omega, albedos, jitter=None, light=None) -> np.ndarray:
        """Radiance float32 (A, N) at points of the cube's frame, (N, 3); light: (N, COLUMNS), as RayLight gives it."""
        first, view = distinct_rows(omega)
        stencil = self.lookup(positions, omega[first], view, jitter).reshape(len(positions), -1)
        gamma = angle_to_sun(omega[first], self.sun)
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        ray = np.concatenate([light, read_light(self.cells, positions, omega, self.sun, self.anisotropy)], axis=1)
        return self.network.run(stencil=stencil, ray=ray, view=view, anisotropy=anisotropy, gamma=gamma, albedo=albedos)
