# SPDX-License-Identifier: GPL-3.0-or-later
"""What the renderer requires of a network, and of a system that takes its place."""

from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np

from ..grids.working_cube import Cube
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import SERIAL, AnyTasks
from ..scene.description import Volume
from ..transport.scattered_fluence import ScatteredFluence
from .conditions import LitConditions, RayPoints


class Points(Protocol):
    """Points around x that a network reads: a stencil or a lattice."""

    @property
    def digest(self) -> str:
        """SHA-256 of their bytes."""


#: What a network reads points around a point of.
Around = TypeVar("Around", covariant=True)


class PointNetwork(Protocol[Around]):
    """A network that predicts from arrays by name. Safe on several threads."""

    @property
    def name(self) -> str:
        """As of System."""

    @property
    def points(self) -> Around:
        """Points around x that it was trained with."""

    def run(self, **inputs: np.ndarray) -> np.ndarray:
        """Radiance float32 (A, N), as of `Network.run`."""


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
    def deviation(self) -> float | None:
        """Standard deviation of the relative error of its predictions, where it has been measured."""

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
    ) -> "Predictor":
        """What predicts in one volume in its working cube. Raises Cancelled."""


class Predictor(Protocol):
    """What a system reads of one volume, for any optical thickness and light. Safe on several threads."""

    @property
    def respects_surfaces(self) -> bool:
        """Whether predictions take occluders into account."""

    @property
    def respects_albedo(self) -> bool:
        """Whether predictions take an albedo into account that varies in the volume."""

    def prepare(self, conditions: LitConditions, tasks: AnyTasks = SERIAL) -> "PreparedPrediction":
        """What predicts under these conditions. Raises Cancelled."""

    def fluence(self, lights: Sequence[LitConditions], tasks: AnyTasks = SERIAL) -> ScatteredFluence | None:
        """Scattered light of several lights for lookups along camera rays; None where no ray features are read.

        Raises Cancelled.
        """
        return None

    def at(self, cube: Cube) -> "Predictor":
        """The same for another instance of the volume, whose working cube lies alike in its voxels."""
        return self

    def with_anisotropy(self, cube: Cube, anisotropy: float) -> "Predictor | None":
        """As `at`, for a medium of another anisotropy; None where both would share nothing."""
        return None


class PreparedPrediction(Protocol):
    """Predictions under certain conditions. Immutable and safe on several threads."""

    @property
    def scale(self) -> float:
        """Fluence of the brightest light that has scattered, over that of a sun of irradiance 1."""

    def predict(self, points: RayPoints, albedos: np.ndarray) -> np.ndarray:
        """Multiple-scattered radiance float32 (A, N) for a sun of irradiance 1, without the factor of the local albedo.

        points: in the cube's frame. albedos: (A,).
        """
