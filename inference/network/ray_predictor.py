# SPDX-License-Identifier: GPL-3.0-or-later
"""How networks of kind "ray" read a volume."""

import copy
import functools
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..environments.environment_light import ordinate_radiance, reaching, solve_environment
from ..environments.open_depths import OpenDepths, direction_depths
from ..features.density_reader import DensityReader
from ..features.descriptors import FieldLookup
from ..features.final_gather import LEVEL as GATHER_LEVEL
from ..features.final_gather import FinalGather
from ..features.stencil import SPARSE, Stencil
from ..grids.halving import halve
from ..grids.working_cube import Cube
from ..models.abilities import Abilities
from ..numerics.alike import SAME, alike
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL, AnyTasks
from ..scene.description import Volume
from ..source_terms.forward_peak import MIN_FORWARD
from ..source_terms.lamp_beam import CubeCells
from ..source_terms.nearby_light import NearbyMedium
from ..transport.discrete_ordinates import LEVEL, DiscreteOrdinates
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
from .lamp_nearby import MIN_ALBEDO, LampNearby, NearbyTransport
from .network import Kind
from .placed_lights import PlacedSkies
from .prepared_rays import PreparedRays

# Fluence lattices, of lights and optical thicknesses, that are cached per instance.
MAX_LATTICES = 128
# Lights in instances whose final gathering is kept at a time; more than threads.
MAX_GATHERS = 24


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
        """Fluence and flux, float32 (n, n, n, 4), of half precision. Whoever reads them shares this array."""
        light = (
            fluence_and_flux(self.cells) if self.for_networks else self.cells[1:-1, 1:-1, 1:-1, :4].astype(np.float16)
        )
        return np.ascontiguousarray(light, np.float32)


@dataclass(frozen=True)
class _SolvedEnvironment:
    """`solve_environment` of some skies. key: of what it was solved for."""

    key: Hashable
    lattices: tuple[np.ndarray, np.ndarray]


class _Instances:
    """What the instances of a volume share: what they read, and of each light what any of them still uses.

    coarse, fine: levels of the density pyramid, that the coarse transport is solved on and that light is gathered
    through. many: whether there are several. coarser: octaves by which these cells are larger than usual.
    """

    def __init__(self, density: DensityReader, coarser: int) -> None:
        self.coarse, self.fine = (np.ascontiguousarray(density.level(m + coarser)) for m in (LEVEL, GATHER_LEVEL))
        self.many, self.coarser = coarser > 0, coarser
        self.transport: tuple[Hashable, DiscreteOrdinates] | None = None
        self.depths: OpenDepths | None = None
        self.albedo: CoarseAlbedo | None = None
        self.solved: weakref.WeakValueDictionary[Hashable, _Solved] = weakref.WeakValueDictionary()
        self.environments: weakref.WeakValueDictionary[Hashable, _SolvedEnvironment] = weakref.WeakValueDictionary()
        self.prepared: weakref.WeakValueDictionary[Hashable, PreparedRays] = weakref.WeakValueDictionary()
        self._gathers: OrderedDict[Hashable, FinalGather] = OrderedDict()
        self._lock = threading.Lock()

    def gather(self, key: Hashable, make: Callable[[], tuple[FinalGather, float]]) -> FinalGather:
        """What `make` makes, of which the last are kept: of each sun in each instance they would take much memory."""
        with self._lock:
            gather = self._gathers.pop(key, None)
        gather = make()[0] if gather is None else gather
        with self._lock:
            self._gathers[key] = gather
            while len(self._gathers) > MAX_GATHERS:
                self._gathers.popitem(last=False)
        return gather


def _itself(gather: FinalGather) -> FinalGather:
    return gather


class RayPredictor(Predictor):
    """Density at a sparse stencil, light along the camera ray and scattered fluence, for a network that reads them.

    For every kind of light. network: whose `points` are the sparse stencil. cube: of the volume. Safe on several
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
        self._lock, self._stencil = threading.Lock(), replace(network.points, finest=cube.finest)
        self.volume, self.density = volume, DensityReader(volume, cube, self._stencil, cancel)
        #: What instances share, by `coarser` of their cells.
        self._sharing = {0: _Instances(self.density, 0)}
        self._shared = self._sharing[0]
        self.density.readers.add(self)
        self._forget()

    @property
    def coarse(self) -> np.ndarray:
        """The level of the density pyramid that the coarse transport is solved on, float32 (n, n, n)."""
        return self._shared.coarse

    def _forget(self) -> None:
        """Hold nothing of any light."""
        self._solved: dict[Hashable, _Solved] = {}
        self._environment: _SolvedEnvironment | None = None
        self._coloured: dict[Hashable, np.ndarray] = {}

    def at(self, cube: Cube) -> "RayPredictor":
        """As of Predictor."""
        instance = copy.copy(self)
        instance.cube = cube
        instance._forget()
        self._shared.many = True
        self.density.readers.add(instance)
        return instance

    def with_anisotropy(self, cube: Cube, anisotropy: float) -> "RayPredictor":
        """As of Predictor. They share the density, and no light."""
        instance = copy.copy(self)
        instance.cube, instance.anisotropy = cube, anisotropy
        instance._sharing = {0: _Instances(self.density, 0)}
        instance._shared = instance._sharing[0]
        instance._shared.many = True
        instance._forget()
        self.density.readers.add(instance)
        return instance

    def coarsened(self, coarser: int) -> "RayPredictor":
        """The same on cells of the coarse transport that are so many octaves larger than usual."""
        with self._lock:
            known = self._sharing.get(coarser)
            if known is None:
                known = self._sharing[coarser] = _Instances(self.density, coarser)
        instance = copy.copy(self)
        instance._shared = known
        instance._forget()
        self.density.readers.add(instance)
        return instance

    def prepare(self, conditions: LitConditions, tasks: AnyTasks = SERIAL) -> PreparedRays:
        """What predicts under these conditions. Raises Cancelled."""
        light, sigma_hat = conditions.light, conditions.sigma_hat
        with tasks.cancel.locked(self._lock):
            known = self._shared.prepared.get(conditions.key)
            lattices = self.density.lattices(conditions.sigma_hat, tasks)
            solved = self._solve(conditions, tasks.cancel)
        if known is not None:
            return known

        def make(cancel: CancelToken = NEVER) -> tuple[FinalGather, float]:
            depth, most = light.unit_depth(CubeCells(self._shared.fine, sigma_hat), cancel)
            return FinalGather.of(self._shared.fine, depth, solved.light, (sigma_hat, self.anisotropy)), most

        gather, most = functools.partial(self._shared.gather, conditions.key, make), 1.0
        if light.near is not None or not self._shared.many:
            held, most = make(tasks.cancel)
            gather = functools.partial(_itself, held)
        prepared = self._shared.prepared[conditions.key] = PreparedRays(
            network=self.network,
            lookup=FieldLookup(self._stencil, lattices, light.direction),
            source=light,
            light=FluenceLattice(solved.cells),
            gather=gather,
            anisotropy=self.anisotropy,
            ahead=self.anisotropy * mean_free_path(self.coarse, sigma_hat),
            scale=solved.scale,
            most=most,
        )
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
        # What is left of even light is solved for anyway.
        ordinates = ordinate_radiance(skies.image[..., :0] if skies.even else skies.image)
        brightest = max(float(ordinates.max(initial=0.0)), 1e-30)
        key: Hashable = alike(conditions.sigma_hat, brightest), np.round(ordinates / brightest, SAME).tobytes()
        key = key, skies.weights, self.cube.key if skies.vary else b"", conditions.occluders if skies.hidden else b""
        with tasks.cancel.locked(self._lock):
            lattices = self.density.lattices(conditions.sigma_hat, tasks)
            shared = self._shared
            if shared.depths is None:
                levels = [self.density.level(m) for m in (0, 1)]
                lattice = direction_depths(self.coarse, tasks.cancel)
                shared.depths = OpenDepths(levels, lattice)
            if self._environment is None or self._environment.key != key:
                # Released before another is solved for.
                self._environment = None
                self._environment = shared.environments.get(key)
            if self._environment is None:
                medium, entering = (
                    (self.coarse, conditions.sigma_hat, self.anisotropy),
                    skies.entering(ordinates, self.cube),
                )
                solved = solve_environment(*medium, entering, conditions.triangles, tasks.cancel)
                if skies.vary:
                    solved = reaching(solved, lambda at: skies.shares(self.cube.world(at)), len(skies.weights))
                self._environment = shared.environments[key] = _SolvedEnvironment(key, solved)
            depths, (light, absorbed) = shared.depths, self._environment.lattices
        lookup = FieldLookup(self._stencil, lattices, conditions.light.direction)
        return PreparedEnvironment(
            network=network,
            cube=self.cube,
            skies=skies,
            lookup=lookup,
            low=len(self._stencil.low),
            depths=depths,
            light=light,
            absorbed=absorbed,
            radiance=skies.radiance,
            blurred=skies.blurred(blurs(self.anisotropy)),
            sigma_hat=conditions.sigma_hat,
            thickness=thickness,
            anisotropy=self.anisotropy,
        )

    def fluence(self, lights: Sequence[LitConditions], tasks: AnyTasks = SERIAL) -> ScatteredFluence:
        """Scattered light of several lights for lookups along camera rays. Raises Cancelled."""

        def solve(conditions: LitConditions) -> tuple[np.ndarray, float]:
            solved = self._together(conditions, tasks.cancel)
            return solved.light, solved.scale

        with tasks.cancel.locked(self._lock):
            for conditions in lights:
                if conditions.albedo is None:
                    self._solver(conditions)
            each = [own for conditions in lights for own in self._apart(conditions)]
            held = list(tasks.each(lambda own: self._solve(own, tasks.cancel), each))
            solved = [solve(conditions) for conditions in lights]
            del held
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
            asked = {albedo: replace(conditions, albedo=albedo) for albedo in albedos}
            lights = {}
            for albedo, of_albedo in asked.items():
                each = [self._solve(own, tasks.cancel) for own in self._apart(of_albedo)]
                together = self._together(of_albedo, tasks.cancel).cells if len(each) > 1 else None
                lights[albedo] = NearbyTransport([(solved.cells, solved.scale) for solved in each], together)
        density = FluenceLattice(np.pad(self.coarse, 1)[..., None])
        return LampNearby(
            share=share,
            lights=lights,
            lamps=conditions.light.near.seen(conditions.sigma_hat, density),
            anisotropy=self.anisotropy,
            density=density,
            extent=self.density.extent,
            radius=conditions.light.near.radius,
        )

    def varying_albedo(
        self, conditions: Conditions[PlacedLight], tasks: AnyTasks = SERIAL
    ) -> tuple[CoarseAlbedo, np.ndarray]:
        """The albedo of a volume in which it varies, and `CoarseAlbedo.light` in it. Raises Cancelled."""
        cancel, key = tasks.cancel, conditions.key
        with cancel.locked(self._lock):
            if self._shared.albedo is None:
                self._shared.albedo = CoarseAlbedo(self.volume, self.cube, self.coarse, cancel)
            known = self._shared.albedo
            if key not in self._coloured:
                if len(self._coloured) >= MAX_LATTICES:
                    self._coloured.clear()
                self._coloured[key] = known.light(
                    lambda albedo: known.solver(conditions.sigma_hat, self.anisotropy, conditions.triangles, albedo),
                    conditions.light.source(len(known.density)),
                    cancel,
                )
            return known, self._coloured[key]

    def _apart(self, conditions: LitConditions) -> list[LitConditions]:
        """The same for each of several lamps whose light is not linear in theirs; else for all of the light."""
        near = conditions.light.near
        if conditions.albedo is None or near is None or self.anisotropy**2 < MIN_FORWARD:
            return [conditions]
        return [replace(conditions, light=lamp) for lamp in near.lamps]

    def _together(self, conditions: LitConditions, cancel: CancelToken) -> _Solved:
        """The transport of a light; of several lamps apart, fluence and flux of all of them."""
        each = self._apart(conditions)
        if len(each) == 1:
            return self._solve(each[0], cancel)
        assert conditions.light.near is not None
        key = conditions.key
        if key not in self._solved:
            solved = [self._solve(own, cancel) for own in each]
            total = np.zeros((*solved[0].cells.shape[:3], 4), np.float32)
            for own, power in zip(solved, conditions.light.near.powers):
                total += np.float32(power * own.scale) * own.cells[..., :4]
            self._solved[key] = self._shared.solved[key] = _Solved(total, 1.0, False)
        return self._solved[key]

    def _solve(self, conditions: LitConditions, cancel: CancelToken) -> _Solved:
        """The transport of a light, solved once."""
        key, light = conditions.key, conditions.light
        solved = self._solved.get(key) or self._shared.solved.get(key)
        if solved is None:
            if conditions.albedo is None:
                solver = self._solver(conditions)
                cells = solver.extrapolated(light.source(len(self.coarse)), self._shared.coarser, cancel)
            else:
                albedo = max(conditions.albedo, MIN_ALBEDO)
                solver = self._new_solver(conditions, albedo)
                medium = NearbyMedium(self.coarse, conditions.sigma_hat, self.anisotropy, albedo)
                assert light.near is not None
                cells = light.near.nearby(solver, medium, cancel)
            scale = light.scale(cells[0])
            cells /= np.float32(scale)
            lattice = fluence_lattice if conditions.albedo is None else moment_lattice
            solved = _Solved(lattice(cells, solver.boundaries), scale, conditions.albedo is None)
            self._shared.solved[key] = solved
        if key not in self._solved:
            if len(self._solved) >= MAX_LATTICES:
                self._solved.clear()
            self._solved[key] = solved
        return solved

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


#: Networks that read the light along camera rays, and with it every kind of light.
RAY = Kind(lambda values: Stencil.read(values, SPARSE), RayPredictor, Abilities(every_light=True))
