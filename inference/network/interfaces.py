# SPDX-License-Identifier: GPL-3.0-or-later
"""What the renderer requires of a network, and of a system that takes its place."""

from typing import Any, Protocol

import numpy as np

from ..grids.working_cube import Cube
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL, AnyTasks
from ..scene.description import Volume
from ..transport.scattered_fluence import ScatteredFluence
from .conditions import Conditions
from .ray_points import RayPoints


class System(Protocol):
    """A network, or what `register_system` registers in place of one. Immutable and safe on several threads.

    Optional attributes: `provider`, str, execution provider that runs it; `warnings`, list of str for the user.
    """

    @property
    def name(self) -> str:
        """Name by which Settings.model asks for it."""

    @property
    def checksum(self) -> str:
        """SHA-256 of its weights, "" without any."""

    @property
    def needs_ray_features(self) -> bool:
        """Whether predictions need RayFeatures."""

    @property
    def anisotropy_range(self) -> tuple[float, float]:
        """(lowest, highest) mean cosine that it accepts."""

    @property
    def sigma_hat_range(self) -> tuple[float, float]:
        """(lowest, highest) optical thickness of the working cube, at the largest density, that it accepts."""

    @property
    def albedo_range(self) -> tuple[float, float]:
        """(lowest, highest) albedo that it accepts."""

    def predictor(
        self,
        volume: Volume,
        cube: Cube,
        anisotropy: float,
        cancel: CancelToken = NEVER,
    ) -> Any:
        """A Predictor for one volume in its working cube. Raises Cancelled."""


class Predictor(Protocol):
    """What a system reads of one volume, for any optical thickness and sun. Safe on several threads."""

    @property
    def respects_surfaces(self) -> bool:
        """Whether predictions take occluders into account."""

    def prepare(self, conditions: Conditions, tasks: AnyTasks = SERIAL) -> "PreparedPrediction":
        """What predicts under these conditions. Raises Cancelled."""


class FluencePredictor(Predictor, Protocol):
    """The predictor of a system that needs ray features."""

    def fluence(self, suns: list[Conditions], tasks: AnyTasks = SERIAL) -> ScatteredFluence | None:
        """Scattered light of several suns for lookups along camera rays, or None. Raises Cancelled."""


class PreparedPrediction(Protocol):
    """Predictions under certain conditions. Immutable and safe on several threads."""

    @property
    def lattice_cells(self) -> int:
        """Cells of the lookup lattices, for the report."""

    def predict(self, points: RayPoints, albedos: np.ndarray) -> np.ndarray:
        """Multiple-scattered radiance float32 (A, N) for a sun of irradiance 1, without the factor of the local albedo.

        points: in the cube's frame. albedos: (A,).
        """
