# SPDX-License-Identifier: GPL-3.0-or-later
"""The network for light from everywhere, and what it predicts with in one volume."""

import contextlib
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..features.descriptors import FieldLookup, distinct_rows
from ..scene.errors import SceneError
from ..transport.blurred_environment import read_image
from ..transport.environment_light import ALBEDOS, read_lattice
from ..transport.open_depths import OpenDepths
from .conditions import RayPoints
from .environment_features import OpenMeans, candidates, inputs, lobe_weights, probe_positions, seldom_scattered
from .provider import open_session
from .weights_file import read_weights

# Folder of these networks' weights; each has the name of the network for suns that it stands beside.
FOLDER = "environment"


@dataclass
class EnvironmentNetwork:
    """A loaded network. session: of `open_session`. checksum: SHA-256 of its file. lock: held while it runs."""

    session: Any
    configuration: dict[str, Any]
    checksum: str
    lock: contextlib.AbstractContextManager[Any]

    def run(self, x: np.ndarray, radiances: np.ndarray, albedos: Sequence[float] | np.ndarray) -> np.ndarray:
        """Radiance float32 (N, 1 + A, C): single scattering, then multiple scattering for each albedo (A,).

        x: float32 (N, COLUMNS) and radiances: float32 (N, CANDIDATES, C), of `environment_features`.
        """
        with self.lock:
            values = {"x": x, "candidates": radiances, "albedo": np.asarray(albedos, np.float32)}
            return self.session.run(["radiance"], values)[0]


def load_environment_network(model: str, provider: str = "CPU") -> EnvironmentNetwork:
    """The network beside a network for suns; provider: of `provider.PROVIDERS`.

    Raises SceneError where the file is missing or damaged.
    """
    content = read_weights(f"{FOLDER}/{model}")
    try:
        opened = open_session(content, provider)
        configuration = json.loads(opened.session.get_modelmeta().custom_metadata_map["configuration"])
    except SceneError:
        raise
    except Exception as error:  # onnxruntime raises types of its own, all of which mean an unusable file
        raise SceneError(f"the weights of {model!r} cannot be read ({error}); reinstall the extension") from error
    return EnvironmentNetwork(opened.session, configuration, hashlib.sha256(content).hexdigest(), opened.lock)


@dataclass(frozen=True)
class PreparedEnvironment:
    """What predicts the light of an environment in one volume, for one optical thickness. Immutable.

    lookup: of the density at the stencil. low: number of its low-frequency points. depths: what is open to points.
    light, absorbed: of `solve_environment`, C channels. radiance: (50, S C), of `direction_radiance`, of S skies that
    reach places differently. blurred: float32 (H, 2H, B, S C).
    sigma_hat: extinction per unit density times the cube's edge. thickness: the same at the largest density.
    anisotropy: G.
    """

    network: EnvironmentNetwork
    lookup: FieldLookup
    low: int
    depths: OpenDepths
    light: np.ndarray
    absorbed: np.ndarray
    radiance: np.ndarray
    blurred: np.ndarray
    sigma_hat: float
    thickness: float
    anisotropy: float

    def predict(self, points: RayPoints, along: np.ndarray, shares: np.ndarray, albedos: Sequence[float]) -> np.ndarray:
        """Radiance float32 (1 + A, N, C) scattered towards the camera, without the factor of the local albedo.

        Single scattering, then multiple scattering for each of A albedos. points: in the cube's frame. along: (N, 2),
        optical depth ahead of each point and behind it on its ray. shares: (N, S), of the skies at the points.
        """
        positions, omega = points.positions, points.directions
        first, view = distinct_rows(omega)
        count, channels = len(positions), self.radiance.shape[1] // shares.shape[1]
        density = self.lookup(positions, omega[first], view, points.jitter)[:, : self.low, 0]
        depths = self.depths(positions)
        opened = OpenMeans(depths, lobe_weights(omega[first])[view], self.sigma_hat)
        probes = probe_positions(positions, omega, depths, self.sigma_hat)
        flat = probes.reshape(-1, 3)
        light = read_lattice(self.light, flat).reshape(count, probes.shape[1], 4, channels)
        absorbed = read_lattice(self.absorbed, flat).reshape(count, probes.shape[1], 4, len(ALBEDOS), channels + 1)
        seldom, even = seldom_scattered(light, absorbed.swapaxes(2, 3), omega)
        x = inputs(density, along, opened, even, omega, self.thickness, self.anisotropy)
        ahead = _reaching(read_image(self.blurred, omega[first])[view], shares)
        open_to = _reaching(opened.radiance(self.radiance), shares)
        radiances = candidates(ahead, open_to, light, seldom, omega, self.anisotropy)
        found = self.network.run(x, radiances, albedos)
        return np.maximum(found, np.float32(0.0)).transpose(1, 0, 2)


def _reaching(radiance: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Radiances (N, K, C) of what reaches N points of skies (N, K, S C), of which they see shares (N, S)."""
    if shares.shape[1] == 1:
        return radiance * shares[:, :, None]
    return np.einsum("nksc,ns->nkc", radiance.reshape(*radiance.shape[:2], shares.shape[1], -1), shares)
