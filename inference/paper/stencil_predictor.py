# SPDX-License-Identifier: GPL-3.0-or-later
"""How networks of kind "stencil", MRPNN of the paper and its variants, read a volume."""

import threading
from dataclasses import dataclass

import numpy as np

from ..features.descriptors import FieldLookup
from ..features.mip_lattices import Lattices, density_lattices, padded_pyramid
from ..features.stencil import Stencil
from ..grids.working_cube import Cube, extent
from ..network.conditions import LitConditions, RayPoints
from ..network.interfaces import PointNetwork, Predictor
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL, AnyTasks
from ..scene.description import Volume
from .descriptors import describe
from .phase_features import PhaseFeatures
from .sun_lattices import SunLevels, sun_lattices, unit_optical_depths, visibility_levels


class StencilPredictor(Predictor):
    """Density, transmittance and phase function at the stencil, for a network that reads them; a `Predictor`.

    network: whose `points` are the Stencil. cube: of the volume. Safe on several threads. Raises Cancelled.
    """

    respects_surfaces, respects_albedo = True, False

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
        # Of the last optical thickness.
        self._lattices: tuple[float, Lattices] | None = None
        self.extent = extent(volume, cube)
        self.padded = padded_pyramid(volume, cube, network.points, cancel)
        self.phase = PhaseFeatures(network.points, anisotropy)

    def prepare(self, conditions: LitConditions, tasks: AnyTasks = SERIAL) -> "PreparedStencil":
        """What predicts under these conditions. Raises Cancelled."""
        stencil, light = self.network.points, conditions.light
        visibility = visibility_levels(stencil, light.shadow_map) if light.shadow_map else None
        sun = SunLevels(unit_optical_depths(self.padded, light.direction), visibility)
        sigma_hat, mapper = conditions.sigma_hat, tasks.each
        with tasks.cancel.locked(self._lock):
            if self._lattices is None or self._lattices[0] != sigma_hat:
                # Released before building new ones.
                self._lattices = None
                self._lattices = sigma_hat, density_lattices(self.padded, sigma_hat, stencil, self.extent, mapper)
            density = self._lattices[1]
        transmittance = sun_lattices(sun, sigma_hat, stencil, self.extent, mapper)
        lookup = FieldLookup(stencil, density, light.direction)
        return PreparedStencil(self.network, lookup, transmittance, self.phase, self.anisotropy)


@dataclass(frozen=True)
class PreparedStencil:
    """A StencilPredictor under certain conditions; a `PreparedPrediction`."""

    network: PointNetwork[Stencil]
    lookup: FieldLookup
    transmittance: Lattices
    phase: PhaseFeatures
    anisotropy: float
    scale = 1.0

    def predict(self, points: RayPoints, albedos: np.ndarray) -> np.ndarray:
        """As PreparedPrediction; ray features are not used."""
        features, gamma = describe(
            self.lookup, self.transmittance, self.phase, points.positions, points.directions, points.jitter
        )
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        return self.network.run(features=features, anisotropy=anisotropy, gamma=gamma, albedo=albedos)
