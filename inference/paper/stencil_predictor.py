# SPDX-License-Identifier: GPL-3.0-or-later
"""How networks of kind "stencil", MRPNN of the paper and its variants, read a volume."""

from dataclasses import dataclass

import numpy as np

from ..features.density_reader import DensityReader
from ..features.descriptors import FieldLookup
from ..features.mip_lattices import Lattices
from ..features.stencil import Stencil
from ..grids.working_cube import Cube
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
        self.density = DensityReader(volume, cube, network.points, cancel)
        self.phase = PhaseFeatures(network.points, anisotropy)

    def prepare(self, conditions: LitConditions, tasks: AnyTasks = SERIAL) -> "PreparedStencil":
        """What predicts under these conditions. Raises Cancelled."""
        stencil, light = self.network.points, conditions.light
        visibility = visibility_levels(stencil, light.shadow_map) if light.shadow_map else None
        sun = SunLevels(unit_optical_depths(self.density.padded, light.direction), visibility)
        transmittance = sun_lattices(sun, conditions.sigma_hat, stencil, self.density.extent, tasks.each)
        density = self.density.lattices(conditions.sigma_hat, tasks)
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
