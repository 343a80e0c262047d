# SPDX-License-Identifier: GPL-3.0-or-later
"""Predicted multiple scattering in one volume: a network, and what it reads of the volume."""

import threading
from collections.abc import Hashable, Sequence
from dataclasses import replace
from typing import TypeVar, cast

import numpy as np

from ..environments.surface_irradiance import SurfaceIrradiance
from ..grids.working_cube import Cube, extent, fit_cube
from ..occluders.occluders import NO_OCCLUDERS, Occluders
from ..plan.plan import distinct_albedos
from ..plan.resolution import Coarser
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL, AnyTasks
from ..scene.description import Medium, Volume
from ..scene.environment import Environment
from ..scene.optimizations import ALL
from ..scene.phase_function import henyey_greenstein
from ..transport.discrete_ordinates import CELLS
from ..transport.mean_free_path import mean_free_path
from ..transport.scattered_fluence import ScatteredFluence
from .albedos import Albedos, UniformAlbedos, VaryingAlbedos
from .conditions import Conditions, PlacedLight, PredictedLight
from .environment_network import EnvironmentNetwork, PreparedEnvironment
from .interfaces import Predictor, System
from .placed_lights import PlacedSkies
from .prepared_predictors import NearbyPredictor, PreparedPredictor, RadiancePredictor
from .ray_predictor import RayPredictor

AnyLight = TypeVar("AnyLight", bound=PlacedLight)

# Points per network call.
POINTS_PER_TASK = 4096
# Fluence of a beam of irradiance 1 that meets a conservative half-space head-on, deep inside: sqrt(3) H(1), with
# Chandrasekhar's H-function. No cloud holds more of one sun's light.
MAX_FLUENCE = 5.04
# Relative errors beyond the trained range, standard deviations: for each factor by which the optical thickness exceeds
# it, and by which 1 - |G| falls short of it (natural logarithms); measured by benchmarks.fidelity.calibration.
BEYOND_THICKNESS, BEYOND_ANISOTROPY = 0.6, 2.0


class VolumePredictor:
    """A network with what it reads of one volume, for any extinction and sun.

    network: from `load_network`. anisotropy: of the medium; outside the network's range the nearest value is used.
    cube: of `fit_cube`, where it is known. like: of another instance of the same voxels, whose cube lies alike in them,
    perhaps of another anisotropy. coarser: octaves by which cells of the coarse transport are larger than usual; 0 for
    networks that know suns alone. Safe on several threads. Raises Cancelled.

    Outside the range of optical thickness that the network was trained for, the prediction is that at the end of the
    range: scaled down in proportion below it, where multiple scattering is linear in density, and constant above it. No
    prediction exceeds the radiance if the largest fluence that one sun can produce arrived entirely where the phase
    function peaks.
    """

    def __init__(
        self,
        network: System,
        volume: Volume,
        anisotropy: float,
        cancel: CancelToken = NEVER,
        cube: Cube | None = None,
        like: "VolumePredictor | None" = None,
        coarser: int = 0,
    ):
        self.network, self.volume = network, volume
        self.cube, self.requested_anisotropy = cube or fit_cube(volume), anisotropy
        self.extent = extent(volume, self.cube)
        self.anisotropy = float(np.clip(anisotropy, *network.anisotropy_range))
        self.coarser = coarser
        before, self._voxels, predictor = 0, object(), None
        if like is not None and like.anisotropy == self.anisotropy:
            before, self._voxels, predictor = like.coarser, like._voxels, like._predictor.at(self.cube)
        elif like is not None:
            predictor = like._predictor.with_anisotropy(self.cube, self.anisotropy)
        self._predictor: Predictor = predictor or network.predictor(volume, self.cube, self.anisotropy, cancel)
        if coarser != before:
            self._predictor = self._every_light.coarsened(coarser)
        self._lock = threading.Lock()
        # The last of each class of light.
        self._last: dict[type, tuple[Hashable, RadiancePredictor]] = {}

    @property
    def resolution(self) -> Coarser:
        """How finely it resolves the volume."""
        return Coarser(transport=self.coarser, density=self.cube.finest)

    @property
    def kind(self) -> Hashable:
        """Equal for instances of one volume that share what is prepared for them."""
        return id(self._voxels), self.coarser

    @property
    def _every_light(self) -> RayPredictor:
        """What reads the volume for a network that predicts every kind of light."""
        return cast(RayPredictor, self._predictor)

    def warnings(self, name: str, medium: Medium, sigma_t: float, occluders: Occluders = NO_OCCLUDERS) -> list[str]:
        """Properties of a medium and of occluders that the network does not support.

        name: of the volume, for the messages.
        """
        texts, network = [], self.network
        if occluders and not self._predictor.respects_surfaces:
            texts.append(f"{name}: the network {network.name} does not account for surfaces")
        if self.anisotropy != medium.anisotropy:
            texts.append(
                f"{name}: anisotropy {medium.anisotropy:g} is outside the network's range; "
                f"multiple scattering uses {self.anisotropy:g}"
            )
        for albedo, _ in distinct_albedos(medium, [0, 1, 2]):
            used = float(np.clip(albedo, *network.albedo_range))
            if used != albedo:
                texts.append(
                    f"{name}: albedo {albedo:g} is outside the network's range; multiple scattering uses {used:g}"
                )
        if self.volume.scattering is not None and not self._predictor.respects_albedo:
            texts.append(f"{name}: the network {network.name} knows one albedo; multiple scattering uses the mean")
        if self.peak_sigma_hat(sigma_t) > network.sigma_hat_range[1]:
            texts.append(
                f"{name}: very dense, so multiple scattering is less accurate; lower Density if it looks wrong"
            )
        return texts

    def peak_sigma_hat(self, sigma_t: float) -> float:
        """Optical thickness of the working cube at the largest density."""
        return sigma_t * self.cube.edge * self.volume.peak

    def outside(self, sigma_t: float) -> float:
        """Standard deviation of the relative error that comes of a medium outside the trained range."""
        asked, known = (1.0 - abs(g) for g in (self.requested_anisotropy, self.anisotropy))
        # Below the range, what a thin medium scatters is proportional to its density.
        thickness = BEYOND_THICKNESS * np.log(max(1.0 / self._used(sigma_t), 1.0))
        return float(np.hypot(thickness, BEYOND_ANISOTROPY * np.log(known / max(asked, 1e-3))))

    def taken_area(self, sigma_t: float) -> tuple[float, float]:
        """Area across a beam of what the volume takes of its light, and its optical depth if it were a slab.

        Means over the axes of its cube.
        """
        coarse = self._every_light.coarse
        depths = np.concatenate([sigma_t * self.cube.edge * coarse.mean(axis=axis).ravel() for axis in range(3)])
        taken = float(-np.expm1(-depths.astype(np.float64)).mean())
        slabs = np.geomspace(1e-3, 1e3, 200)
        mean = np.interp(depths.mean() / max(taken, 1e-30), slabs / -np.expm1(-slabs), slabs)
        return taken * self.cube.edge**2, float(mean)

    def surface_irradiance(
        self, positions: np.ndarray, normals: np.ndarray, sigma_t: float, albedo: float
    ) -> SurfaceIrradiance:
        """Of world positions (N, 3) with normals (N, 3), by the coarse transport for an extinction and an albedo."""
        solver = self._every_light.coarser_solver(sigma_t * self.cube.edge, albedo)
        return SurfaceIrradiance(solver, self.cube, positions, normals)

    def prepare(
        self,
        sigma_t: float,
        light: PredictedLight,
        occluders: Occluders = NO_OCCLUDERS,
        tasks: AnyTasks = SERIAL,
    ) -> RadiancePredictor:
        """What predicts for one extinction and light. Raises Cancelled."""
        key = (sigma_t, light.key, *light.albedos, occluders.key)
        with tasks.cancel.locked(self._lock):
            if type(light) in self._last and self._last[type(light)][0] == key:
                return self._last[type(light)][1]
            # Released before preparing a new one.
            self._last.pop(type(light), None)
            conditions = self._conditions(sigma_t, light, occluders)
            share, network = self.transport_share(light), None
            if share < 1.0:
                peak = max(henyey_greenstein(1.0, self.anisotropy), henyey_greenstein(-1.0, self.anisotropy))
                network = PreparedPredictor(
                    prediction=self._predictor.prepare(conditions, tasks),
                    light=light,
                    cube=self.cube,
                    albedo_range=self.network.albedo_range,
                    used=self._used(sigma_t),
                    most=np.float32(MAX_FLUENCE * peak),
                    outside=self.outside(sigma_t),
                )
            prepared: RadiancePredictor | None = network
            if light.near and share > 0.0:
                conditions = replace(conditions, sigma_hat=sigma_t * self.cube.edge)
                nearby = self._every_light.nearby(conditions, light.albedos, share, tasks)
                prepared = NearbyPredictor(
                    nearby=nearby, cube=self.cube, network=network, outside=self.outside(sigma_t)
                )
            assert prepared is not None
            self._last[type(light)] = key, prepared
            return prepared

    def fluence(
        self,
        sigma_t: float,
        lights: Sequence[PredictedLight],
        occluders: Occluders = NO_OCCLUDERS,
        tasks: AnyTasks = SERIAL,
    ) -> ScatteredFluence | None:
        """As of `Predictor`: what networks read, for albedo 1.

        Where they do not predict it, that for the largest albedo. Raises Cancelled.
        """
        asked = []
        for light in lights:
            conditions = self._conditions(sigma_t, light, occluders)
            if light.albedos and self.transport_share(light) >= 1.0:
                conditions = replace(conditions, sigma_hat=sigma_t * self.cube.edge, albedo=max(light.albedos))
            asked.append(conditions)
        return self._predictor.fluence(asked, tasks)

    def prepare_environment(
        self,
        network: EnvironmentNetwork,
        environments: Sequence[Environment],
        sigma_t: float,
        occluders: Occluders = NO_OCCLUDERS,
        tasks: AnyTasks = SERIAL,
    ) -> PreparedEnvironment:
        """What predicts the light of environments for one extinction. Raises Cancelled.

        network: beside this one. occluders: which end the light of environments that they hide in places.
        """
        conditions = self._conditions(sigma_t, PlacedSkies(environments, self.cube), occluders)
        thickness = max(self.peak_sigma_hat(sigma_t), 1e-30)
        return self._every_light.prepare_environment(network, conditions, thickness, tasks)

    def albedos(
        self,
        medium: Medium,
        sigma_t: float,
        indices: Sequence[int],
        light: PlacedLight,
        occluders: Occluders = NO_OCCLUDERS,
        tasks: AnyTasks = SERIAL,
        optimizations: frozenset[str] = ALL,
    ) -> Albedos:
        """Albedos of some colour channels of the volume's medium, in a light. Raises Cancelled.

        optimizations: those in use.
        """
        if self.volume.scattering is None or not self._predictor.respects_albedo:
            return UniformAlbedos(distinct_albedos(medium, list(indices), optimizations))
        conditions = self._conditions(sigma_t, light, occluders)
        coarse, solved = self._every_light.varying_albedo(conditions, tasks)
        return VaryingAlbedos(
            values=coarse.uniform.tolist(),
            enclosing=coarse.enclosing,
            light=solved,
            cube=self.cube,
            indices=indices,
            sigma_hat=conditions.sigma_hat,
            anisotropy=self.anisotropy,
            free_path=mean_free_path(coarse.density, conditions.sigma_hat),
        )

    @property
    def lamp_radius(self) -> float:
        """Distance from a lamp, in world units, within which the coarse transport does not tell its light apart."""
        return self.cube.edge / (CELLS >> self.coarser)

    def transport_share(self, light: PredictedLight) -> float:
        """Share of the coarse transport alone in a light's multiple scattering, 0 to 1."""
        return light.near.transport_share(self.extent) if light.near else 0.0

    def _conditions(self, sigma_t: float, light: AnyLight, occluders: Occluders) -> Conditions[AnyLight]:
        triangles = self.cube.positions(occluders.triangles) if occluders else None
        sigma_hat = sigma_t * self.cube.edge * (1.0 if light.any_thickness else self._used(sigma_t))
        return Conditions(sigma_hat, light, triangles, occluders.key)

    def _used(self, sigma_t: float) -> float:
        """Ratio of the optical thickness within the network's range to the true one."""
        peak = self.peak_sigma_hat(sigma_t)
        return float(np.clip(peak, *self.network.sigma_hat_range)) / peak
