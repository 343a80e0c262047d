# SPDX-License-Identifier: GPL-3.0-or-later
"""How networks of kinds "stencil" and "ray" read a volume."""

import functools
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..features.descriptors import FieldLookup, describe
from ..features.final_gather import LEVEL as GATHER_LEVEL
from ..features.final_gather import FinalGather, shadowed_depth, unit_sun_depth
from ..features.mip_lattices import (
    Lattices,
    SunLevels,
    build_lattices,
    inner_cells,
    padded_pyramid,
    unit_optical_depths,
    visibility_levels,
)
from ..features.phase_features import PhaseFeatures
from ..features.stencil import SPARSE, Stencil
from ..grids.halving import halve
from ..grids.lamp_optical_depth import DIRECTIONS, RADII
from ..grids.sphere_depth import start_depths
from ..grids.working_cube import Cube
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL, AnyTasks
from ..scene.description import Volume
from ..transport.blurred_environment import blurred
from ..transport.cell_sources import EnteringLight, LampBeam, SunBeam
from ..transport.discrete_ordinates import CELLS, LEVEL, CellSource, DiscreteOrdinates
from ..transport.environment_light import Skies, direction_radiance, ordinate_radiance, reaching, solve_environment
from ..transport.lamp_beam import CubeCells
from ..transport.mean_free_path import mean_free_path
from ..transport.nearby_light import NearbyMedium, nearby_light
from ..transport.open_depths import OpenDepths, direction_depths
from ..transport.scattered_fluence import (
    FluenceLattice,
    ScatteredFluence,
    fluence_and_flux,
    fluence_lattice,
    moment_lattice,
)
from ..transport.varying_albedo import CoarseAlbedo
from .conditions import Bounds, Conditions
from .environment_features import blurs
from .environment_network import EnvironmentNetwork, PreparedEnvironment
from .lamp_nearby import MIN_ALBEDO, LampNearby, SoftStart
from .prepared_rays import PreparedLampRays, PreparedRays
from .ray_points import RayPoints

# Fluence lattices, of suns and optical thicknesses, that are cached per volume.
MAX_LATTICES = 64
# Sample points along an edge of a cell of the coarse transport for the visibility of the sun.
VISIBILITY_SAMPLES = 3


class StencilPredictor:
    """Density, transmittance and phase function at the stencil, for a network that reads them; a `Predictor`.

    network: whose `points` are the Stencil. cube: of the volume. Safe on several
    threads. Raises Cancelled.
    """

    needs_ray_features = False
    respects_surfaces = True

    def __init__(
        self,
        network: Any,
        volume: Volume,
        cube: Cube,
        anisotropy: float,
        cancel: CancelToken = NEVER,
    ):
        self.network, self.cube, self.anisotropy = network, cube, anisotropy
        self._lock = threading.Lock()
        self._lattices: tuple[tuple[float, ...], Lattices] | None = None
        self.volume = volume
        self.padded = padded_pyramid(volume, cube, network.points, cancel)
        self._read_pyramid()

    def _read_pyramid(self) -> None:
        """Compute what depends on the volume alone."""
        self.phase = PhaseFeatures(self.network.points, self.anisotropy)

    @staticmethod
    def read_points(values: np.ndarray) -> Stencil:
        """The stencil from the floats of a weights file."""
        return Stencil.read(values)

    def prepare(self, conditions: Conditions, tasks: AnyTasks = SERIAL) -> "PreparedStencil | PreparedRays":
        """What predicts under these conditions. Raises Cancelled."""
        stencil = self.network.points
        visibility = visibility_levels(stencil, conditions.shadow_map) if conditions.shadow_map else None
        sun = SunLevels(unit_optical_depths(self.padded, conditions.sun), visibility)
        with tasks.cancel.locked(self._lock):
            earlier = None
            if self._lattices is not None and self._lattices[0] == conditions.bounds_key:
                earlier = self._lattices[1]
            # Released before building new ones.
            self._lattices = None
            lattices = build_lattices(
                self.padded, conditions.sigma_hat, stencil, sun, conditions.bounds, tasks.each, earlier
            )
            self._lattices = conditions.bounds_key, lattices
        lookup = FieldLookup(stencil, lattices, conditions.sun)
        return PreparedStencil(self.network, lookup, self.phase, self.anisotropy)


@dataclass(frozen=True)
class PreparedStencil:
    """A StencilPredictor under certain conditions; a `PreparedPrediction`."""

    network: Any
    lookup: FieldLookup
    phase: PhaseFeatures
    anisotropy: float

    def predict(self, points: RayPoints, albedos: np.ndarray) -> np.ndarray:
        """As PreparedPrediction; ray features are not used."""
        features, gamma = describe(self.lookup, self.phase, points.positions, points.directions, points.jitter)
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        return self.network.run(features=features, anisotropy=anisotropy, gamma=gamma, albedo=albedos)

    @property
    def lattice_cells(self) -> int:
        """Cells of the lookup lattices."""
        return self.lookup.lattices.values.size


@dataclass(frozen=True)
class _SolvedLamp:
    """The coarse transport of a lamp of power 1, over a factor.

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


class RayPredictor(StencilPredictor):
    """Density at a sparse stencil, light along the camera ray and scattered fluence, for a network that reads them.

    A `FluencePredictor`; arguments as for StencilPredictor.
    """

    needs_ray_features = True

    @staticmethod
    def read_points(values: np.ndarray) -> Stencil:
        """The sparse stencil from the floats of a weights file."""
        return Stencil.read(values, SPARSE)

    def _read_pyramid(self) -> None:
        """Take the levels that the coarse transport is solved on and that light is gathered through."""
        self.coarse, self.fine = (
            np.ascontiguousarray(inner_cells(self.padded[m], m, self.network.points)) for m in (LEVEL, GATHER_LEVEL)
        )
        self._transport: tuple[tuple[float, bytes], DiscreteOrdinates] | None = None
        self._fluence: dict[tuple[Any, ...], tuple[np.ndarray, np.ndarray]] = {}
        self._lamps: dict[tuple[Any, ...], _SolvedLamp] = {}
        self._depths: OpenDepths | None = None
        self._environment: tuple[tuple[Any, ...], tuple[np.ndarray, np.ndarray]] | None = None
        self._albedo: CoarseAlbedo | None = None
        self._places: dict[tuple[Any, ...], np.ndarray] = {}

    def prepare(self, conditions: Conditions, tasks: AnyTasks = SERIAL) -> PreparedRays:
        """What predicts under these conditions. Raises Cancelled."""
        with tasks.cancel.locked(self._lock):
            lattices = self._density_lattices(conditions, tasks)
            cells, light = self._solve(conditions, tasks.cancel)
        lookup = FieldLookup(self.network.points, lattices, conditions.sun)
        depth = unit_sun_depth(self.fine, conditions.sun)
        if conditions.shadow_map:
            depth = shadowed_depth(depth, conditions.shadow_map.cell_visibility(len(depth)), conditions.sigma_hat)
        gather = self._final_gather(depth, light, conditions)
        return PreparedRays(self.network, lookup, FluenceLattice(cells), gather, self.anisotropy)

    def _final_gather(self, depth: np.ndarray, light: np.ndarray, conditions: Conditions) -> FinalGather:
        """Gathers light around camera rays; depth and light: as for `FinalGather.of`."""
        return FinalGather.of(self.fine, depth, light, (conditions.sigma_hat, self.anisotropy))

    def prepare_environment(
        self,
        network: EnvironmentNetwork,
        skies: Skies,
        conditions: Conditions,
        thickness: float,
        tasks: AnyTasks = SERIAL,
    ) -> PreparedEnvironment:
        """What predicts the light of an environment. Raises Cancelled.

        conditions: whose sun only gives the stencil a frame. thickness: optical thickness of the cube at the largest
        density.
        """
        ordinates = ordinate_radiance(skies.image)
        key = conditions.sigma_hat, ordinates.tobytes(), skies.weights
        with tasks.cancel.locked(self._lock):
            lattices = self._density_lattices(conditions, tasks)
            if self._depths is None:
                levels = [inner_cells(self.padded[m], m, self.network.points) for m in (0, 1)]
                lattice = direction_depths(self.coarse, tasks.cancel)
                self._depths = OpenDepths(levels, lattice)
            if self._environment is None or self._environment[0] != key:
                self._environment = None
                solved = solve_environment(self.coarse, conditions.sigma_hat, self.anisotropy, ordinates, tasks.cancel)
                if skies.vary:
                    solved = reaching(solved, lambda at: skies.shares(self.cube.world(at)), len(skies.weights))
                self._environment = key, solved
            depths, (light, absorbed) = self._depths, self._environment[1]
        lookup = FieldLookup(self.network.points, lattices, conditions.sun)
        return PreparedEnvironment(
            network,
            lookup,
            len(self.network.points.low),
            depths,
            light,
            absorbed,
            direction_radiance(skies.image).astype(np.float32),
            blurred(skies.image, blurs(self.anisotropy)),
            conditions.sigma_hat,
            thickness,
            self.anisotropy,
        )

    def _density_lattices(self, conditions: Conditions, tasks: AnyTasks) -> Lattices:
        """Lattices of the density, which serve every light."""
        if self._lattices is None or self._lattices[0] != conditions.bounds_key:
            self._lattices = None
            lattices = build_lattices(
                self.padded,
                conditions.sigma_hat,
                self.network.points,
                bounds=conditions.bounds,
                mapper=tasks.each,
            )
            self._lattices = conditions.bounds_key, lattices
        return self._lattices[1]

    def fluence(self, suns: list[Conditions], tasks: AnyTasks = SERIAL) -> ScatteredFluence:
        """Scattered light of several suns for lookups along camera rays. Raises Cancelled."""
        with tasks.cancel.locked(self._lock):
            if suns:
                self._solver(suns[0])
            solved = list(tasks.each(lambda sun: self._solve(sun, tasks.cancel), suns))
        return ScatteredFluence.in_cube(self.cube, [light for _, light in solved], self.anisotropy)

    def prepare_lamp(self, conditions: Conditions, tasks: AnyTasks = SERIAL) -> PreparedLampRays:
        """What predicts the light of the conditions' lamp. Raises Cancelled."""
        assert conditions.lamp is not None
        with tasks.cancel.locked(self._lock):
            lattices = self._density_lattices(conditions, tasks)
            solved = self._solve_lamp(conditions, tasks.cancel)
        lookup = FieldLookup(self.network.points, lattices, conditions.sun)
        fine = CubeCells(self.fine, conditions.sigma_hat)
        depth, most = conditions.lamp.unit_depth(fine, tasks.cancel)
        gather = self._final_gather(depth, solved.light, conditions)
        place = self.cube.positions(conditions.lamp.centre[None])[0]
        ahead = self.anisotropy * mean_free_path(self.coarse, conditions.sigma_hat)
        lattice, scale = FluenceLattice(solved.cells), solved.scale
        return PreparedLampRays(self.network, lookup, lattice, gather, most, place, ahead, scale, self.anisotropy)

    def lamp_fluence(
        self, lamps: Sequence[tuple[Conditions, float | None]], tasks: AnyTasks = SERIAL
    ) -> ScatteredFluence:
        """Scattered light of several lamps of power 1 for lookups along camera rays. Raises Cancelled.

        lamps: conditions of each, and the albedo for which the transport alone is its light, or None where networks
        predict it.
        """

        def solve(lamp: tuple[Conditions, float | None]) -> _SolvedLamp:
            conditions, albedo = lamp
            return self._solve_lamp(conditions, tasks.cancel, None if albedo is None else max(albedo, MIN_ALBEDO))

        with tasks.cancel.locked(self._lock):
            for conditions, albedo in lamps:
                if albedo is None:
                    self._solver(conditions)
            solved = list(tasks.each(solve, lamps))
        return ScatteredFluence.in_cube(
            self.cube, [one.light for one in solved], self.anisotropy, [one.scale for one in solved]
        )

    def lamp_nearby(
        self, conditions: Conditions, albedos: Sequence[float], share: float, extent: Bounds, tasks: AnyTasks = SERIAL
    ) -> LampNearby:
        """The transport of the conditions' lamp for some albedos; share, extent: as in LampNearby. Raises Cancelled."""
        with tasks.cancel.locked(self._lock):
            solved = {albedo: self._solve_lamp(conditions, tasks.cancel, max(albedo, MIN_ALBEDO)) for albedo in albedos}
        lights = {albedo: (FluenceLattice(one.cells), one.scale) for albedo, one in solved.items()}
        density = FluenceLattice(np.pad(self.coarse, 1)[..., None])
        start = self._soft_start(conditions, density)
        return LampNearby(share, lights, self.anisotropy, density, extent, start)

    def _soft_start(self, conditions: Conditions, density: FluenceLattice) -> SoftStart | None:
        """Of the conditions' lamp, in the matter around it; density: of the coarse cells."""
        assert conditions.lamp is not None
        source = conditions.lamp.emitters[0].source
        if not source.soft_falloff or source.radius == 0.0:
            return None
        radius = source.radius / self.cube.edge
        middle, away = self.cube.positions(source.centre[None])[0], DIRECTIONS[:, :, None] * (radius * RADII)
        around = float(density.values(middle + away.reshape(3, -1).T).mean())
        return SoftStart(radius, around, start_depths(around * radius * conditions.sigma_hat))

    def varying_albedo(
        self, conditions: Conditions, image: np.ndarray | None = None, tasks: AnyTasks = SERIAL
    ) -> tuple[CoarseAlbedo, np.ndarray]:
        """The albedo of a volume in which it varies, and its `CoarseAlbedo.places`. Raises Cancelled.

        In the light of the conditions' sun or lamp, or of an environment's image (H, 2H, C) in the cube's frame.
        """
        cancel, ordinates = tasks.cancel, None
        # Its colours differ little in where they come from, compared to what the albedo does to them.
        if image is not None:
            ordinates = ordinate_radiance(image).mean(axis=1)
        lamp_key = conditions.lamp.key if conditions.lamp else b""
        light_key = (*conditions.sun, conditions.screen, lamp_key) if ordinates is None else ordinates.tobytes()
        key = conditions.sigma_hat, light_key, conditions.occluders
        with cancel.locked(self._lock):
            if self._albedo is None:
                self._albedo = CoarseAlbedo(self.volume, self.cube, self.coarse, cancel)
            known = self._albedo
            if key not in self._places:
                if len(self._places) >= MAX_LATTICES:
                    self._places.clear()
                cells = len(known.density)
                self._places[key] = known.places(
                    lambda albedo: known.solver(conditions.sigma_hat, self.anisotropy, conditions.triangles, albedo),
                    self._source(conditions, cells) if ordinates is None else EnteringLight(ordinates),
                    cancel,
                )
            return known, self._places[key]

    def _source(self, conditions: Conditions, cells: int) -> CellSource:
        """The conditions' sun or lamp, on so many cells along an edge."""
        if conditions.lamp is not None:
            return LampBeam(conditions.lamp)
        shadow_map = conditions.shadow_map
        visibility = shadow_map.cell_visibility(cells, parts=VISIBILITY_SAMPLES) if shadow_map else 1.0
        return SunBeam(conditions.sun, visibility)

    def _solve_lamp(self, conditions: Conditions, cancel: CancelToken, albedo: float | None = None) -> _SolvedLamp:
        """The transport of a lamp of power 1; albedo: for which it is solved, None for what networks read."""
        lamp = conditions.lamp
        assert lamp is not None
        key = conditions.sigma_hat, lamp.key, conditions.occluders, albedo
        found = self._lamps.get(key)
        if found is None:
            if len(self._lamps) >= MAX_LATTICES:
                self._lamps.clear()
            if albedo is None:
                solver = self._solver(conditions)
                light = solver.solve(LampBeam(lamp), cancel)
            else:
                solver = self._new_solver(conditions, albedo)
                medium = NearbyMedium(self.coarse, conditions.sigma_hat, self.anisotropy, albedo)
                light = nearby_light(solver, medium, lamp, cancel)
            # The lattices' range is that of suns: the brightest cell has the light of a sun of irradiance 1.
            scale = max(float(light[0].max()), 1e-30)
            light /= np.float32(scale)
            lattice = fluence_lattice if albedo is None else moment_lattice
            found = self._lamps[key] = _SolvedLamp(lattice(light, solver.boundaries), scale, albedo is None)
        return found

    def _solve(self, conditions: Conditions, cancel: CancelToken) -> tuple[np.ndarray, np.ndarray]:
        """`fluence_lattice` and `fluence_and_flux`, solved once per optical thickness, sun and occluders."""
        key = conditions.sigma_hat, *conditions.sun, conditions.screen, conditions.occluders
        found = self._fluence.get(key)
        if found is None:
            if len(self._fluence) >= MAX_LATTICES:
                self._fluence.clear()
            solver = self._solver(conditions)
            cells = fluence_lattice(solver.solve(self._source(conditions, CELLS), cancel), solver.boundaries)
            found = self._fluence[key] = cells, fluence_and_flux(cells)
        return found

    def _solver(self, conditions: Conditions) -> DiscreteOrdinates:
        """Solver of the transport; all suns of a render share their optical thickness and occluders."""
        key = conditions.sigma_hat, conditions.occluders
        if self._transport is None or self._transport[0] != key:
            self._transport = key, self._new_solver(conditions)
        return self._transport[1]

    def coarser_solver(self, sigma_hat: float, albedo: float) -> DiscreteOrdinates:
        """Solver of the transport without surfaces, on cells twice as large."""
        coarser = np.empty([n // 2 for n in self.coarse.shape], np.float32)
        halve(np.ascontiguousarray(self.coarse), coarser)
        return DiscreteOrdinates(coarser, sigma_hat, self.anisotropy, albedo=albedo)

    def _new_solver(self, conditions: Conditions, albedo: float = 1.0) -> DiscreteOrdinates:
        return DiscreteOrdinates(self.coarse, conditions.sigma_hat, self.anisotropy, conditions.triangles, albedo)
