"""A volume as networks of kinds "stencil" and "ray" read it."""

import threading
from dataclasses import dataclass

import numpy as np

from ..features.descriptors import FieldLookup, angle_to_sun, describe, distinct_rows
from ..features.mip_lattices import (
    SunLevels,
    build_lattices,
    density_pyramid,
    padded_levels,
    unit_optical_depths,
    visibility_levels,
)
from ..features.phase_features import PhaseFeatures
from ..features.stencil import SPARSE, Stencil
from ..grids.working_cube import level0_density
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL
from ..transport.discrete_ordinates import CELLS, LEVEL, DiscreteOrdinates
from ..transport.scattered_fluence import ScatteredFluence, fluence_and_flux, fluence_lattice, read_fluence
from .conditions import Conditions

# Fluence lattices, of suns and optical thicknesses, that a volume keeps.
MOST_LATTICES = 64
# Points along an edge of a cell of the coarse transport at which surfaces may shade it.
CELL_POINTS = 3


class StencilPredictor:
    """Density, transmittance and phase function at A.2's stencil, for a network that reads them.

    network: whose `points` are the Stencil. cube: of the volume. Safe on several threads. Raises Cancelled.
    """

    needs_ray_features = False
    respects_surfaces = True

    def __init__(self, network, volume, cube, anisotropy: float, cancel: CancelToken = NEVER):
        self.network, self.cube, self.anisotropy = network, cube, anisotropy
        self._lock, self._lattices = threading.Lock(), (None, None)
        pyramid = density_pyramid(level0_density(volume, cube, cancel))
        self.padded = padded_levels(pyramid, network.points)
        self._read_pyramid(pyramid)

    def _read_pyramid(self, pyramid):
        """Make what depends neither on optical thickness nor on suns."""
        self.phase = PhaseFeatures(self.network.points, self.anisotropy)

    @staticmethod
    def read_points(values) -> Stencil:
        """The stencil from the floats of a weights file."""
        return Stencil.read(values)

    def prepare(self, conditions: Conditions, tasks=SERIAL) -> "PreparedStencil":
        """What predicts under these conditions. Raises Cancelled."""
        stencil = self.network.points
        visibility = visibility_levels(stencil, conditions.shadow_map) if conditions.shadow_map else None
        sun = SunLevels(unit_optical_depths(self.padded, conditions.sun), visibility)
        with tasks.cancel.locked(self._lock):
            earlier = self._lattices[1] if self._lattices[0] == conditions.bounds_key else None
            # Unneeded ones are given back before there are new ones.
            self._lattices = None, None
            lattices = build_lattices(self.padded, conditions.sigma_hat, stencil, sun, conditions.bounds, tasks.each, earlier)
            self._lattices = conditions.bounds_key, lattices
        lookup = FieldLookup(stencil, lattices, conditions.sun)
        return PreparedStencil(self.network, lookup, self.phase, self.anisotropy)


@dataclass(frozen=True)
class PreparedStencil:
    """A StencilPredictor under certain conditions."""

    network: object
    lookup: FieldLookup
    phase: PhaseFeatures
    anisotropy: float

    def predict(self, positions, omega, albedos, jitter=None, ray_features=None) -> np.ndarray:
        """Radiance float32 (A, N) at points of the cube's frame, (N, 3); jitter: as for FieldLookup."""
        features, gamma = describe(self.lookup, self.phase, positions, omega, jitter)
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        return self.network.run(features=features, anisotropy=anisotropy, gamma=gamma, albedo=albedos)

    @property
    def lattice_cells(self) -> int:
        return self.lookup.lattices.values.size


class RayPredictor(StencilPredictor):
    """Density at a sparse stencil, light along the camera ray and scattered fluence, for a network that reads them."""

    needs_ray_features = True

    @staticmethod
    def read_points(values) -> Stencil:
        return Stencil.read(values, SPARSE)

    def _read_pyramid(self, pyramid):
        self.coarse, self._transport, self._fluence = pyramid[LEVEL], (None, None), {}

    def prepare(self, conditions: Conditions, tasks=SERIAL) -> "PreparedRays":
        stencil = self.network.points
        with tasks.cancel.locked(self._lock):
            if self._lattices[0] != conditions.bounds_key:
                self._lattices = None, None
                lattices = build_lattices(
                    self.padded, conditions.sigma_hat, stencil, bounds=conditions.bounds, mapper=tasks.each)
                self._lattices = conditions.bounds_key, lattices
            lattices = self._lattices[1]
            cells = self._solve(conditions, tasks.cancel).astype(np.float32)
        return PreparedRays(self.network, FieldLookup(stencil, lattices, conditions.sun), cells, self.anisotropy)

    def fluence(self, suns, tasks=SERIAL) -> ScatteredFluence:
        """Scattered light of several suns, one Conditions each, for camera rays to look up. Raises Cancelled."""
        with tasks.cancel.locked(self._lock):
            # One after the other: on several threads they take longer, since these wait for Python's lock between
            # short operations.
            cells = [found for sun in suns for found in tasks.each(lambda one: self._solve(one, tasks.cancel), [sun])]
        return ScatteredFluence.in_cube(self.cube, [fluence_and_flux(values) for values in cells], self.anisotropy)

    def _solve(self, conditions: Conditions, cancel: CancelToken) -> np.ndarray:
        """As `fluence_lattice`, solved once per optical thickness, sun and surfaces."""
        key = conditions.sigma_hat, *conditions.sun, conditions.occluders
        if key not in self._fluence:
            if len(self._fluence) >= MOST_LATTICES:
                self._fluence.clear()
            # The optical thickness and the surfaces are the same for all suns of a render.
            solver_key = conditions.sigma_hat, conditions.occluders
            if self._transport[0] != solver_key:
                solver = DiscreteOrdinates(self.coarse, conditions.sigma_hat, self.anisotropy, conditions.triangles)
                self._transport = solver_key, solver
            solver, shadow_map = self._transport[1], conditions.shadow_map
            visibility = shadow_map.lit_cells(CELLS, parts=CELL_POINTS) if shadow_map else 1.0
            self._fluence[key] = fluence_lattice(solver.light(conditions.sun, visibility, cancel), solver.boundaries)
        return self._fluence[key]


@dataclass(frozen=True)
class PreparedRays:
    """A RayPredictor under certain conditions; cells: float32, of `fluence_lattice`."""

    network: object
    lookup: FieldLookup
    cells: np.ndarray
    anisotropy: float

    def predict(self, positions, omega, albedos, jitter=None, ray_features=None) -> np.ndarray:
        """Radiance float32 (A, N) at points of the cube's frame, (N, 3); ray_features: (N, COLUMNS) of RayFeatures."""
        first, view = distinct_rows(omega)
        stencil = self.lookup(positions, omega[first], view, jitter).reshape(len(positions), -1)
        sun = self.lookup.sun
        gamma = angle_to_sun(omega[first], sun)
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        around = read_fluence(self.cells, positions, omega, sun, self.anisotropy)
        ray = np.concatenate([ray_features, around], axis=1)
        return self.network.run(stencil=stencil, ray=ray, view=view, anisotropy=anisotropy, gamma=gamma, albedo=albedos)

    @property
    def lattice_cells(self) -> int:
        return self.lookup.lattices.values.size
