# SPDX-License-Identifier: GPL-3.0-or-later
"""What networks of kind "ray" predict from at points, in the light of one sun or lamp."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..features.descriptors import FieldLookup, angle_to_sun, distinct_rows
from ..features.final_gather import REDUCED, SCALE, SCATTERED, SINGLE, FinalGather
from ..features.stencil import frames
from ..transport.scattered_fluence import PROBES, FluenceLattice
from .conditions import PredictedLight, RayPoints
from .interfaces import PointNetwork
from .uncertainty import Predicted, UncertaintyNetwork, deviations


@dataclass(frozen=True)
class PreparedRays:
    """A `ray_predictor.RayPredictor` under certain conditions; a `PreparedPrediction`.

    source: the light. light: what of it has scattered, over `scale`. gather: gives what gathers its unscattered light,
    over `most`. ahead: distance along camera rays at which its direction is taken: a forward phase function scatters
    into a ray what arrives from ahead.
    """

    network: PointNetwork
    lookup: FieldLookup
    source: PredictedLight
    light: FluenceLattice
    gather: Callable[[], FinalGather]
    anisotropy: float
    ahead: float
    scale: float
    most: float

    def predict(self, points: RayPoints, albedos: np.ndarray) -> np.ndarray:
        """As PreparedPrediction. Raises ValueError without ray features."""
        if self.most == 0.0:
            # The light passes the volume.
            return np.zeros((len(albedos), len(points)), np.float32)
        return self.network.run(**self._inputs(points), albedo=albedos)

    def deviation(self, network: UncertaintyNetwork, points: RayPoints, radiance: Predicted) -> np.ndarray:
        """Standard deviations float32 (A, N) of the errors of predicted radiance, over it.

        radiance: (N,), of each of A albedos, as `predict` gives it for these points.
        """
        return deviations(network, self._inputs(points), radiance)

    def _inputs(self, points: RayPoints) -> dict[str, np.ndarray]:
        """What the network reads, by name, but for the albedos. Raises ValueError without ray features."""
        if points.ray_features is None:
            raise ValueError(f"the network {self.network.name} needs ray features")
        positions, omega = points.positions, points.directions
        towards = self.source.towards(positions + self.ahead * omega)
        local = towards if towards.ndim == 2 else None
        if local is None:
            first, view = distinct_rows(omega)
        else:
            first = view = np.arange(len(points), dtype=np.int32)
        stencil = self.lookup(positions, omega[first], view, points.jitter, local).reshape(len(points), -1)
        gamma = angle_to_sun(omega[first], towards)
        around = self.light.read(positions, omega, towards, self.anisotropy)
        gathered = self.gather()(positions, frames(omega[first], towards)[view])
        # As if a sun of the irradiance at each point stood where the light does.
        irradiance = np.maximum(points.irradiance, 1e-30)
        of_sun = np.atleast_1d(self.scale / irradiance).astype(np.float32)
        around[:, : PROBES + 1] += np.log(of_sun)[:, None]
        gathered[:, :, SCATTERED] *= of_sun[:, None]
        # The gathered light of a lamp is that of a sun, dimmed as by matter: with the same exponents.
        unscattered = np.atleast_1d(self.most / irradiance).astype(np.float32)[:, None]
        gathered[:, :, SINGLE] *= unscattered
        gathered[:, :, REDUCED] *= unscattered ** np.float32(SCALE)
        return {
            "stencil": stencil,
            "ray": np.concatenate([points.ray_features, around], axis=1),
            "gathered": gathered,
            "view": view,
            "anisotropy": np.full(gamma.shape, self.anisotropy, np.float32),
            "gamma": gamma,
        }
