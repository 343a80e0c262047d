# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a network's prediction is expected to be from the truth at a point: a small network beside it tells."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..features.stencil import LAYER_POINTS, SPARSE
from ..marching import ray_features
from ..marching.ray_features import MAX_TAU_AHEAD, MAX_TAU_SUN
from ..models.weights_file import WEIGHTS
from ..scene.phase_function import henyey_greenstein
from ..transport import scattered_fluence
from .provider import SmallNetwork

# Folder of these networks' weights; each has the name of the network whose error it tells.
FOLDER = "uncertainty"
# Points of the sparse stencil in each of its layers.
_LAYERS = [count // SPARSE for count in LAYER_POINTS]
_STARTS, _SIZES = np.cumsum([0, *_LAYERS[:-1]]), np.array(_LAYERS, np.float32)
# Added before logarithms of densities, light, radiance, and of what an albedo absorbs.
_LEAST_DENSITY, _LEAST_LIGHT, _LEAST_RADIANCE, _LEAST_ABSORPTION = 3e-4, 1e-4, 1e-6, 1e-3
#: Radiance (N,) that was predicted for each of A albedos.
Predicted = Mapping[float, np.ndarray]
_LOGS = scattered_fluence.PROBES + 1
#: Columns of `inputs`.
COLUMNS = len(_LAYERS) + 4 + (ray_features.COLUMNS - 2) + scattered_fluence.COLUMNS + 1 + 5 + 2 + 2 + 1


def inputs(
    stencil: np.ndarray,
    ray: np.ndarray,
    anisotropy: np.ndarray,
    gamma: np.ndarray,
    albedo: np.ndarray,
    radiance: np.ndarray,
) -> np.ndarray:
    """What the network for the error reads: float32 (N, COLUMNS).

    stencil, ray: of points, as the network `mrpnn` reads them. anisotropy, gamma: (N,). albedo: (N,), and the radiance
    (N,) that was predicted for it.
    """
    # Accepts the training data's rows as well.
    stencil, ray = stencil.astype(np.float32), ray.astype(np.float32)
    layers = np.log(np.add.reduceat(stencil, _STARTS, axis=1) / _SIZES + _LEAST_DENSITY)
    tau_sun, tau_ahead = np.clip(ray[:, 0], 0.0, MAX_TAU_SUN), np.clip(ray[:, 1], 0.0, MAX_TAU_AHEAD)
    ahead = np.log(np.maximum(ray[:, 2 : ray_features.COLUMNS], 0.0) + _LEAST_LIGHT)
    around = ray[:, ray_features.COLUMNS :]
    g: Any = anisotropy
    cosine, log_radiance = np.cos(gamma), np.log(radiance + _LEAST_RADIANCE)
    phase = np.log(henyey_greenstein(cosine, g))
    columns = [np.log1p(tau_sun), np.exp(-tau_sun), np.log1p(tau_ahead), np.exp(-tau_ahead)]
    columns += [*ahead.T, *around.T, around[:, 0] - around[:, 1:_LOGS].mean(axis=1)]
    columns += [cosine, np.sin(gamma), g, phase, np.log(1.0 - np.abs(g))]
    columns += [albedo, np.log(1.0 - albedo + _LEAST_ABSORPTION)]
    # Beside the light around the point, and beside what arrives from straight ahead.
    columns += [log_radiance, log_radiance - around[:, 0], log_radiance - phase - ahead[:, 0]]
    return np.concatenate([layers, np.stack(columns, axis=1)], axis=1).astype(np.float32)


class UncertaintyNetwork(SmallNetwork):
    """A loaded network."""

    @property
    def typical(self) -> float:
        """Root mean square of the deviations of the rows that it was trained on."""
        return self.configuration["typical"]

    def run(self, x: np.ndarray) -> np.ndarray:
        """Standard deviation float32 (N,) of the error over the prediction; x: of `inputs`."""
        with self.lock:
            return self.session.run(["deviation"], {"x": x})[0]


def deviations(network: UncertaintyNetwork, read: Mapping[str, np.ndarray], radiance: Predicted) -> np.ndarray:
    """Standard deviations float32 (A, N) of the errors of predicted radiance, over it.

    read: what the network for suns reads of N points, by name. radiance: (N,), predicted for each of A albedos.
    """
    view = read["view"]
    angles = read["anisotropy"][view], read["gamma"][view]
    relative = [
        network.run(inputs(read["stencil"], read["ray"], *angles, np.full(len(view), albedo, np.float32), predicted))
        for albedo, predicted in radiance.items()
    ]
    return np.stack(relative)


def has_uncertainty(model: str) -> bool:
    """Whether a network for the error stands beside the network of a name."""
    return (WEIGHTS / FOLDER / f"{model}.onnx").exists()


def load_uncertainty_network(model: str) -> UncertaintyNetwork:
    """The network beside one for suns; it runs on the processor. Raises SceneError where the file is damaged."""
    return UncertaintyNetwork.load(FOLDER, model)
