# SPDX-License-Identifier: GPL-3.0-or-later
"""What networks of kind "ray" predict from at points, in the light of one sun or lamp."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..features.descriptors import FieldLookup, angle_to_sun, distinct_rows
from ..features.final_gather import REDUCED, SCALE, SCATTERED, SINGLE, FinalGather
from ..features.stencil import frames
from ..transport.scattered_fluence import PROBES, FluenceLattice
from .ray_points import RayPoints
from .uncertainty import UncertaintyNetwork, deviations


@dataclass(frozen=True)
class PreparedRays:
    """A `stencil_predictor.RayPredictor` under certain conditions; a `PreparedPrediction`."""

    network: Any
    lookup: FieldLookup
    light: FluenceLattice
    gather: FinalGather
    anisotropy: float

    def predict(self, points: RayPoints, albedos: np.ndarray) -> np.ndarray:
        """As PreparedPrediction. Raises ValueError without ray features."""
        return self.network.run(**self._inputs(points), albedo=albedos)

    def deviation(
        self, network: UncertaintyNetwork, points: RayPoints, radiance: Mapping[float, np.ndarray]
    ) -> np.ndarray:
        """Standard deviations float32 (A, N) of the errors of predicted radiance, over it.

        radiance: (N,), of each of A albedos, as `predict` gives it for these points.
        """
        return deviations(network, self._inputs(points), radiance)

    def _inputs(self, points: RayPoints) -> dict[str, np.ndarray]:
        """What the network reads, by name, but for the albedos. Raises ValueError without ray features."""
        positions, omega, sun = points.positions, points.directions, self.lookup.sun
        first, view = distinct_rows(omega)
        stencil = self.lookup(positions, omega[first], view, points.jitter).reshape(len(points), -1)
        gamma = angle_to_sun(omega[first], sun)
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        around = self.light.read(positions, omega, sun, self.anisotropy)
        if points.ray_features is None:
            raise ValueError(f"the network {self.network.name} needs ray features")
        return {
            "stencil": stencil,
            "ray": np.concatenate([points.ray_features, around], axis=1),
            "gathered": self.gather(positions, frames(omega[first], sun)[view]),
            "view": view,
            "anisotropy": anisotropy,
            "gamma": gamma,
        }

    @property
    def lattice_cells(self) -> int:
        """Cells of the lookup lattices."""
        return self.lookup.lattices.values.size


def directions_to(place: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3) from positions (N, 3) to a place (3,)."""
    away = place - positions
    return away / np.maximum(np.linalg.norm(away, axis=1), 1e-30)[:, None]


@dataclass(frozen=True)
class PreparedLampRays:
    """A RayPredictor for one lamp under certain conditions. Immutable.

    light: scattered light of a lamp of power 1, over `scale`. gather: of its unscattered light, over `most`. place:
    (3,), of the lamp in the cube's frame. ahead: distance along camera rays at which its direction is taken: a forward
    phase function scatters into a ray what arrives from ahead.
    """

    network: Any
    lookup: FieldLookup
    light: FluenceLattice
    gather: FinalGather
    most: float
    place: np.ndarray
    ahead: float
    scale: float
    anisotropy: float

    def predict(self, points: RayPoints, irradiance: np.ndarray, albedos: np.ndarray) -> np.ndarray:
        """Radiance float32 (A, N) as if a sun of irradiance 1 stood in the lamp's place, as PreparedPrediction.

        irradiance: (N,), of the lamp of power 1, over which the points' ray features are given. Raises ValueError
        without them.
        """
        if self.most == 0.0:
            # It shines past the volume.
            return np.zeros((len(albedos), len(points)), np.float32)
        return self.network.run(**self._inputs(points, irradiance), albedo=albedos)

    def deviation(
        self,
        network: UncertaintyNetwork,
        points: RayPoints,
        irradiance: np.ndarray,
        radiance: Mapping[float, np.ndarray],
    ) -> np.ndarray:
        """As PreparedRays; the other arguments as for `predict`."""
        return deviations(network, self._inputs(points, irradiance), radiance)

    def _inputs(self, points: RayPoints, irradiance: np.ndarray) -> dict[str, np.ndarray]:
        """As PreparedRays."""
        if points.ray_features is None:
            raise ValueError(f"the network {self.network.name} needs ray features")
        positions, omega = points.positions, points.directions
        towards = directions_to(self.place, positions + self.ahead * omega)
        view = np.arange(len(points), dtype=np.int32)
        stencil = self.lookup(positions, omega, view, points.jitter, towards).reshape(len(points), -1)
        gamma = np.arccos(np.clip((omega * towards).sum(axis=1), -1.0, 1.0)).astype(np.float32)
        anisotropy = np.full(gamma.shape, self.anisotropy, np.float32)
        around = self.light.read(positions, omega, towards, self.anisotropy)
        of_sun = (self.scale / np.maximum(irradiance, 1e-30)).astype(np.float32)
        around[:, : PROBES + 1] += np.log(of_sun)[:, None]
        gathered = self.gather(positions, frames(omega, towards))
        gathered[:, :, SCATTERED] *= of_sun[:, None]
        # The gathered light of a lamp is that of a sun, dimmed as by matter: with the same exponents.
        unscattered = (self.most / np.maximum(irradiance, 1e-30)).astype(np.float32)[:, None]
        gathered[:, :, SINGLE] *= unscattered
        gathered[:, :, REDUCED] *= unscattered ** np.float32(SCALE)
        return {
            "stencil": stencil,
            "ray": np.concatenate([points.ray_features, around], axis=1),
            "gathered": gathered,
            "view": view,
            "anisotropy": anisotropy,
            "gamma": gamma,
        }

    @property
    def lattice_cells(self) -> int:
        """Cells of the lookup lattices."""
        return self.lookup.lattices.values.size
