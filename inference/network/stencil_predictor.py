# SPDX-License-Identifier: GPL-3.0-or-later
"""How networks of kinds "stencil" and "ray" read a volume."""

import copy
import functools
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..features.descriptors import FieldLookup, describe
from ..features.final_gather import LEVEL as GATHER_LEVEL
from ..features.final_gather import FinalGather
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
from ..grids.working_cube import Cube
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL, AnyTasks
from ..scene.description import Volume
from ..transport.discrete_ordinates import CELLS, LEVEL, DiscreteOrdinates
from ..transport.environment_light import ordinate_radiance, reaching, solve_environment
from ..transport.lamp_beam import CubeCells
from ..transport.mean_free_path import mean_free_path
from ..transport.nearby_light import NearbyMedium
from ..transport.open_depths import OpenDepths, direction_depths
from ..transport.scattered_fluence import (
    FluenceLattice,
    ScatteredFluence,
    fluence_and_flux,
    fluence_lattice,
    moment_lattice,
)
from ..transport.varying_albedo import CoarseAlbedo
from .conditions import SAME, Bounds, Conditions, LitConditions, PlacedLight, RayPoints, alike
from .environment_features import blurs
from .environment_network import EnvironmentNetwork, PreparedEnvironment
from .interfaces import PointNetwork, Predictor, PreparedPrediction
from .lamp_nearby import MIN_ALBEDO, LampNearby
from .placed_lights import PlacedSkies
from .prepared_rays import PreparedRays

# Fluence lattices, of lights and optical thicknesses, that are cached per instance.
MAX_LATTICES = 128
# Lights in instances whose final gathering is kept at a time; more than threads.
MAX_GATHERS = 24


class StencilPredictor(Predictor):
    """Density, transmittance and phase function at the stencil, for a network that reads them; a `Predictor`.

    network: whose `points` are the Stencil. cube: of the volume. Safe on several
    threads. Raises Cancelled.
    """

    needs_ray_features = False
    respects_surfaces = True

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
        self._lattices: tuple[tuple[float, ...], Lattices] | None = None
        self.volume = volume
        self.padded = padded_pyramid(volume, cube, network.points, cancel)
        self._read_pyramid()

    def _read_pyramid(self) -> None:
        """Compute what depends on the volume alone."""
        self.phase = PhaseFeatures(self.network.points, self.anisotropy)

    def at(self, cube: Cube) -> "StencilPredictor":
        """As of Predictor."""
        found = copy.copy(self)
        found.cube = cube
        return found

    @staticmethod
    def read_points(values: np.ndarray) -> Stencil:
        """The stencil from the floats of a weights file."""
        return Stencil.read(values)

    def prepare(self, conditions: LitConditions, tasks: AnyTasks = SERIAL) -> PreparedPrediction:
        """What predicts under these conditions. Raises Cancelled."""
        stencil, light = self.network.points, conditions.light
        visibility = visibility_levels(stencil, light.shadow_map) if light.shadow_map else None
        sun = SunLevels(unit_optical_depths(self.padded, light.direction), visibility)
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
        lookup = FieldLookup(stencil, lattices, light.direction)
        return PreparedStencil(self.network, lookup, self.phase, self.anisotropy)


@dataclass(frozen=True)
class PreparedStencil:
    """A StencilPredictor under certain conditions; a `PreparedPrediction`."""

    network: PointNetwork[Stencil]
    lookup: FieldLookup
    phase: PhaseFeatures
    anisotropy: float
    scale = 1.0

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
        """Fluence and flux, float32 (64, 64, 64, 4), of half precision. Whoever reads them shares this array."""
        found = (
            fluence_and_flux(self.cells) if self.for_networks else self.cells[1:-1, 1:-1, 1:-1, :4].astype(np.float16)
        )
        return np.ascontiguousarray(found, np.float32)


@dataclass(frozen=True)
class _SolvedEnvironment:
    """`solve_environment` of some skies. key: of what it was solved for."""

    key: Hashable
    lattices: tuple[np.ndarray, np.ndarray]


class _Instances:
    """What the instances of a volume share: what they read, and of each light what any of them still uses."""

    def __init__(self) -> None:
        self.lattices: tuple[tuple[float, ...], Lattices] | None = None
        self.transport: tuple[Hashable, DiscreteOrdinates] | None = None
        self.depths: OpenDepths | None = None
        self.albedo: CoarseAlbedo | None = None
        self.solved: weakref.WeakValueDictionary[Hashable, _Solved] = weakref.WeakValueDictionary()
        self.environments: weakref.WeakValueDictionary[Hashable, _SolvedEnvironment] = weakref.WeakValueDictionary()
        self.prepared: weakref.WeakValueDictionary[Hashable, PreparedRays] = weakref.WeakValueDictionary()
        # Whether there are several.
        self.many = False
        self._gathers: OrderedDict[Hashable, FinalGather] = OrderedDict()
        self._lock = threading.Lock()

    def gathers(self, key: Hashable, make: Callable[[], tuple[FinalGather, float]]) -> FinalGather:
        """What `make` makes, of which the last are kept: of each sun in each instance they would take much memory."""
        with self._lock:
            found = self._gathers.pop(key, None)
        found = make()[0] if found is None else found
        with self._lock:
            self._gathers[key] = found
            while len(self._gathers) > MAX_GATHERS:
                self._gathers.popitem(last=False)
        return found


def _same(held: FinalGather) -> FinalGather:
    return held


class RayPredictor(StencilPredictor):
    """Density at a sparse stencil, light along the camera ray and scattered fluence, for a network that reads them.

    Arguments as for StencilPredictor.
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
        self._shared = _Instances()
        self._forget()

    def _forget(self) -> None:
        """Hold nothing of any light."""
        self._solved: dict[Hashable, _Solved] = {}
        self._environment: _SolvedEnvironment | None = None
        self._places: dict[Hashable, np.ndarray] = {}

    def at(self, cube: Cube) -> "RayPredictor":
        """As of Predictor."""
        found = copy.copy(self)
        found.cube = cube
        found._forget()
        self._shared.many = True
        return found

    def prepare(self, conditions: LitConditions, tasks: AnyTasks = SERIAL) -> PreparedRays:
        """What predicts under these conditions. Raises Cancelled."""
        light, sigma_hat = conditions.light, conditions.sigma_hat
        key = conditions.key, conditions.bounds_key
        with tasks.cancel.locked(self._lock):
            known = self._shared.prepared.get(key)
            lattices = self._density_lattices(conditions, tasks)
            solved = self._solve(conditions, tasks.cancel)
        if known is not None:
            return known

        def gather(cancel: CancelToken = NEVER) -> tuple[FinalGather, float]:
            depth, most = light.unit_depth(CubeCells(self.fine, sigma_hat), cancel)
            return FinalGather.of(self.fine, depth, solved.light, (sigma_hat, self.anisotropy)), most

        most, gathers = 1.0, functools.partial(self._shared.gathers, key, gather)
        if light.near is not None or not self._shared.many:
            held, most = gather(tasks.cancel)
            gathers = functools.partial(_same, held)
        prepared = PreparedRays(
            network=self.network,
            lookup=FieldLookup(self.network.points, lattices, light.direction),
            source=light,
            light=FluenceLattice(solved.cells),
            gather=gathers,
            anisotropy=self.anisotropy,
            ahead=self.anisotropy * mean_free_path(self.coarse, sigma_hat),
            scale=solved.scale,
            most=most,
        )
        self._shared.prepared[key] = prepared
        return prepared

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
        brightest = max(float(ordinates.max(initial=0.0)), 1e-30)
        key: Hashable = alike(conditions.sigma_hat, brightest), np.round(ordinates / brightest, SAME).tobytes()
        key = key, skies.weights, self.cube.key if skies.vary else b""
        with tasks.cancel.locked(self._lock):
            lattices = self._density_lattices(conditions, tasks)
            shared = self._shared
            if shared.depths is None:
                levels = [inner_cells(self.padded[m], m, self.network.points) for m in (0, 1)]
                lattice = direction_depths(self.coarse, tasks.cancel)
                shared.depths = OpenDepths(levels, lattice)
            if self._environment is None or self._environment.key != key:
                # Released before another is solved for.
                self._environment = None
                self._environment = shared.environments.get(key)
            if self._environment is None:
                solved = solve_environment(self.coarse, conditions.sigma_hat, self.anisotropy, ordinates, tasks.cancel)
                if skies.vary:
                    solved = reaching(solved, lambda at: skies.shares(self.cube.world(at)), len(skies.weights))
                self._environment = shared.environments[key] = _SolvedEnvironment(key, solved)
            depths, (light, absorbed) = shared.depths, self._environment.lattices
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
            radiance=skies.radiance,
            blurred=skies.blurred(blurs(self.anisotropy)),
            sigma_hat=conditions.sigma_hat,
            thickness=thickness,
            anisotropy=self.anisotropy,
        )

    def _density_lattices(self, conditions: Conditions[PlacedLight], tasks: AnyTasks) -> Lattices:
        """Lattices of the density, which serve every light."""
        shared = self._shared
        if shared.lattices is None or shared.lattices[0] != conditions.bounds_key:
            shared.lattices = None
            lattices = build_lattices(
                self.padded,
                conditions.sigma_hat,
                self.network.points,
                bounds=conditions.bounds,
                mapper=tasks.each,
            )
            shared.lattices = conditions.bounds_key, lattices
        return shared.lattices[1]

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
        extent: Bounds,
        tasks: AnyTasks = SERIAL,
    ) -> LampNearby:
        """The transport of a near light for some albedos; share, extent: as in LampNearby. Raises Cancelled."""
        assert conditions.light.near is not None
        with tasks.cancel.locked(self._lock):
            solved = {albedo: self._solve(replace(conditions, albedo=albedo), tasks.cancel) for albedo in albedos}
        lights = {albedo: (FluenceLattice(one.cells), one.scale) for albedo, one in solved.items()}
        density = FluenceLattice(np.pad(self.coarse, 1)[..., None])
        start = conditions.light.near.soft_start(conditions.sigma_hat, density)
        return LampNearby(share, lights, self.anisotropy, density, extent, start)

    def varying_albedo(
        self, conditions: Conditions[PlacedLight], tasks: AnyTasks = SERIAL
    ) -> tuple[CoarseAlbedo, np.ndarray]:
        """The albedo of a volume in which it varies, and its `CoarseAlbedo.places` in a light. Raises Cancelled."""
        cancel, key = tasks.cancel, conditions.key
        with cancel.locked(self._lock):
            if self._shared.albedo is None:
                self._shared.albedo = CoarseAlbedo(self.volume, self.cube, self.coarse, cancel)
            known = self._shared.albedo
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
        found = self._solved.get(key) or self._shared.solved.get(key)
        if found is None:
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
            found = _Solved(lattice(cells, solver.boundaries), scale, conditions.albedo is None)
            self._shared.solved[key] = found
        if key not in self._solved:
            if len(self._solved) >= MAX_LATTICES:
                self._solved.clear()
            self._solved[key] = found
        return found

    def _solver(self, conditions: LitConditions) -> DiscreteOrdinates:
        """Solver of the transport; all lights of a render share their optical thickness and occluders."""
        key, shared = (alike(conditions.sigma_hat), conditions.surfaces_key), self._shared
        if shared.transport is None or shared.transport[0] != key:
            shared.transport = key, self._new_solver(conditions)
        return shared.transport[1]

    def coarser_solver(self, sigma_hat: float, albedo: float) -> DiscreteOrdinates:
        """Solver of the transport without surfaces, on cells twice as large."""
        coarser = np.empty([n // 2 for n in self.coarse.shape], np.float32)
        halve(np.ascontiguousarray(self.coarse), coarser)
        return DiscreteOrdinates(coarser, sigma_hat, self.anisotropy, albedo=albedo)

    def _new_solver(self, conditions: LitConditions, albedo: float = 1.0) -> DiscreteOrdinates:
        return DiscreteOrdinates(self.coarse, conditions.sigma_hat, self.anisotropy, conditions.triangles, albedo)
