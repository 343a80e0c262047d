# SPDX-License-Identifier: GPL-3.0-or-later
"""How networks of kind "ray" read a volume."""

import functools
import threading
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..environments.blurred_environment import blurred
from ..environments.environment_light import direction_radiance, ordinate_radiance, reaching, solve_environment
from ..environments.open_depths import OpenDepths, direction_depths
from ..features.density_reader import DensityReader
from ..features.descriptors import FieldLookup
from ..features.final_gather import LEVEL as GATHER_LEVEL
from ..features.final_gather import FinalGather
from ..features.stencil import SPARSE, Stencil
from ..grids.halving import halve
from ..grids.working_cube import Cube
from ..models.abilities import Abilities
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL, AnyTasks
from ..scene.description import Volume
from ..source_terms.lamp_beam import CubeCells
from ..source_terms.nearby_light import NearbyMedium
from ..transport.discrete_ordinates import CELLS, LEVEL, DiscreteOrdinates
from ..transport.mean_free_path import mean_free_path
from ..transport.scattered_fluence import (
    FluenceLattice,
    ScatteredFluence,
    fluence_and_flux,
    fluence_lattice,
    moment_lattice,
)
from ..transport.varying_albedo import CoarseAlbedo
from .conditions import Conditions, LitConditions, PlacedLight
from .environment_features import blurs
from .environment_network import EnvironmentNetwork, PreparedEnvironment
from .interfaces import PointNetwork, Predictor
from .lamp_nearby import MIN_ALBEDO, LampNearby
from .network import Kind
from .placed_lights import PlacedSkies
from .prepared_rays import PreparedRays

# Fluence lattices, of lights and optical thicknesses, that are cached per volume.
MAX_LATTICES = 128


@dataclass(frozen=True)
class _Solved:
    """The coarse transport of a light of strength 1, over a factor.

    cells: a `fluence_lattice` for albedo 1, which networks read, or a `moment_lattice` for another albedo. scale: the
    factor. for_networks: which of them it is.
    """

    cells: np.ndarray
    scale: float
    for_networks: bool

    @functools.cached_property
    def light(self) -> np.ndarray:
        """Fluence and flux, float16 (64, 64, 64, 4)."""
        return (
            fluence_and_flux(self.cells) if self.for_networks else self.cells[1:-1, 1:-1, 1:-1, :4].astype(np.float16)
        )


class RayPredictor(Predictor):
    """Density at a sparse stencil, light along the camera ray and scattered fluence, for a network that reads them.

    An `EveryLightPredictor`. network: whose `points` are the sparse stencil. cube: of the volume. Safe on several
    threads. Raises Cancelled.
    """

    respects_surfaces = respects_albedo = True

    def __init__(
        self,
        network: PointNetwork[Stencil],
        volume: Volume,
        cube: Cube,
        anisotropy: float,
        cancel: CancelToken = NEVER,
    ):
        self.network, self.cube, self.anisotropy = network, cube, anisotropy
        self._lock = threading.Lock()
        self.volume, self.density = volume, DensityReader(volume, cube, network.points, cancel)
        # The levels that the coarse transport is solved on and that light is gathered through.
        self.coarse, self.fine = (np.ascontiguousarray(self.density.level(m)) for m in (LEVEL, GATHER_LEVEL))
        self._transport: tuple[tuple[float, bytes], DiscreteOrdinates] | None = None
        self._solved: dict[Hashable, _Solved] = {}
        self._depths: OpenDepths | None = None
        self._environment: tuple[Hashable, tuple[np.ndarray, np.ndarray]] | None = None
        self._albedo: CoarseAlbedo | None = None
        self._places: dict[Hashable, np.ndarray] = {}

    def prepare(self, conditions: LitConditions, tasks: AnyTasks = SERIAL) -> PreparedRays:
        """What predicts under these conditions. Raises Cancelled."""
        light, sigma_hat = conditions.light, conditions.sigma_hat
        with tasks.cancel.locked(self._lock):
            lattices = self.density.lattices(conditions.sigma_hat, tasks)
            solved = self._solve(conditions, tasks.cancel)
        depth, most = light.unit_depth(CubeCells(self.fine, sigma_hat), tasks.cancel)
        return PreparedRays(
            network=self.network,
            lookup=FieldLookup(self.network.points, lattices, light.direction),
            source=light,
            light=FluenceLattice(solved.cells),
            gather=FinalGather.of(self.fine, depth, solved.light, (sigma_hat, self.anisotropy)),
            anisotropy=self.anisotropy,
            ahead=self.anisotropy * mean_free_path(self.coarse, sigma_hat),
            scale=solved.scale,
            most=most,
        )

    def prepare_environment(
        self,
        network: EnvironmentNetwork,
        conditions: Conditions[PlacedSkies],
        thickness: float,
        tasks: AnyTasks = SERIAL,
    ) -> PreparedEnvironment:
        """What predicts the light of environments. Raises Cancelled.

        thickness: optical thickness of the cube at the largest density.
        """
        skies = conditions.light.skies
        ordinates = ordinate_radiance(skies.image)
        key = conditions.sigma_hat, ordinates.tobytes(), skies.weights
        with tasks.cancel.locked(self._lock):
            lattices = self.density.lattices(conditions.sigma_hat, tasks)
            if self._depths is None:
                levels = [self.density.level(m) for m in (0, 1)]
                lattice = direction_depths(self.coarse, tasks.cancel)
                self._depths = OpenDepths(levels, lattice)
            if self._environment is None or self._environment[0] != key:
                self._environment = None
                solved = solve_environment(self.coarse, conditions.sigma_hat, self.anisotropy, ordinates, tasks.cancel)
                if skies.vary:
                    solved = reaching(solved, lambda at: skies.shares(self.cube.world(at)), len(skies.weights))
                self._environment = key, solved
            depths, (light, absorbed) = self._depths, self._environment[1]
        lookup = FieldLookup(self.network.points, lattices, conditions.light.direction)
        return PreparedEnvironment(
            network=network,
            cube=self.cube,
            skies=skies,
            lookup=lookup,
            low=len(self.network.points.low),
            depths=depths,
            light=light,
            absorbed=absorbed,
            radiance=direction_radiance(skies.image).astype(np.float32),
            blurred=blurred(skies.image, blurs(self.anisotropy)),
            sigma_hat=conditions.sigma_hat,
            thickness=thickness,
            anisotropy=self.anisotropy,
        )

    def fluence(self, lights: Sequence[LitConditions], tasks: AnyTasks = SERIAL) -> ScatteredFluence:
        """Scattered light of several lights for lookups along camera rays. Raises Cancelled."""

        def solve(conditions: LitConditions) -> tuple[np.ndarray, float]:
            solved = self._solve(conditions, tasks.cancel)
            return solved.light, solved.scale

        with tasks.cancel.locked(self._lock):
            for conditions in lights:
                if conditions.albedo is None:
                    self._solver(conditions)
            solved = list(tasks.each(solve, lights))
        scales = [scale for _, scale in solved]
        return ScatteredFluence.in_cube(self.cube, [light for light, _ in solved], self.anisotropy, scales)

    def nearby(
        self,
        conditions: LitConditions,
        albedos: Sequence[float],
        share: float,
        tasks: AnyTasks = SERIAL,
    ) -> LampNearby:
        """The transport of a near light for some albedos; share: as in LampNearby. Raises Cancelled."""
        assert conditions.light.near is not None
        with tasks.cancel.locked(self._lock):
            solved = {albedo: self._solve(replace(conditions, albedo=albedo), tasks.cancel) for albedo in albedos}
        lights = {albedo: (FluenceLattice(transport.cells), transport.scale) for albedo, transport in solved.items()}
        density = FluenceLattice(np.pad(self.coarse, 1)[..., None])
        start = conditions.light.near.soft_start(conditions.sigma_hat, density)
        return LampNearby(share, lights, self.anisotropy, density, self.density.extent, start)

    def varying_albedo(
        self, conditions: Conditions[PlacedLight], tasks: AnyTasks = SERIAL
    ) -> tuple[CoarseAlbedo, np.ndarray]:
        """The albedo of a volume in which it varies, and its `CoarseAlbedo.places` in a light. Raises Cancelled."""
        cancel, key = tasks.cancel, conditions.key
        with cancel.locked(self._lock):
            if self._albedo is None:
                self._albedo = CoarseAlbedo(self.volume, self.cube, self.coarse, cancel)
            known = self._albedo
            if key not in self._places:
                if len(self._places) >= MAX_LATTICES:
                    self._places.clear()
                self._places[key] = known.places(
                    lambda albedo: known.solver(conditions.sigma_hat, self.anisotropy, conditions.triangles, albedo),
                    conditions.light.source(len(known.density)),
                    cancel,
                )
            return known, self._places[key]

    def _solve(self, conditions: LitConditions, cancel: CancelToken) -> _Solved:
        """The transport of a light, solved once."""
        key, light = conditions.key, conditions.light
        solved = self._solved.get(key)
        if solved is None:
            if len(self._solved) >= MAX_LATTICES:
                self._solved.clear()
            if conditions.albedo is None:
                solver = self._solver(conditions)
                cells = solver.solve(light.source(CELLS), cancel)
            else:
                albedo = max(conditions.albedo, MIN_ALBEDO)
                solver = self._new_solver(conditions, albedo)
                medium = NearbyMedium(self.coarse, conditions.sigma_hat, self.anisotropy, albedo)
                assert light.near is not None
                cells = light.near.nearby(solver, medium, cancel)
            scale = light.scale(cells[0])
            cells /= np.float32(scale)
            lattice = fluence_lattice if conditions.albedo is None else moment_lattice
            solved = self._solved[key] = _Solved(lattice(cells, solver.boundaries), scale, conditions.albedo is None)
        return solved

    def _solver(self, conditions: LitConditions) -> DiscreteOrdinates:
        """Solver of the transport; all lights of a render share their optical thickness and occluders."""
        key = conditions.sigma_hat, conditions.occluders
        if self._transport is None or self._transport[0] != key:
            self._transport = key, self._new_solver(conditions)
        return self._transport[1]

    def coarser_solver(self, sigma_hat: float, albedo: float) -> DiscreteOrdinates:
        """Solver of the transport without surfaces, on cells twice as large."""
        coarser = np.empty([n // 2 for n in self.coarse.shape], np.float32)
        halve(np.ascontiguousarray(self.coarse), coarser)
        return DiscreteOrdinates(coarser, sigma_hat, self.anisotropy, albedo=albedo)

    def _new_solver(self, conditions: LitConditions, albedo: float = 1.0) -> DiscreteOrdinates:
        return DiscreteOrdinates(self.coarse, conditions.sigma_hat, self.anisotropy, conditions.triangles, albedo)


#: Networks that read the light along camera rays, and with it every kind of light.
RAY = Kind(lambda values: Stencil.read(values, SPARSE), RayPredictor, Abilities(every_light=True))
