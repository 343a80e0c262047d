# SPDX-License-Identifier: GPL-3.0-or-later
"""The network for light from everywhere, and what it predicts with in one volume."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..environments.blurred_environment import read_image
from ..environments.environment_light import ALBEDOS, Skies, read_lattice
from ..environments.open_depths import OpenDepths
from ..features.descriptors import FieldLookup, distinct_rows
from ..grids.working_cube import Cube
from .conditions import RayPoints
from .environment_features import (
    CANDIDATES,
    SHARPEST,
    OpenMeans,
    blurs,
    candidates,
    inputs,
    lobe_weights,
    probe_positions,
    seldom_scattered,
    visible_ahead,
)
from .provider import SmallNetwork

# Folder of these networks' weights; each has the name of the network for suns that it stands beside.
FOLDER = "environment"


class EnvironmentNetwork(SmallNetwork):
    """A loaded network."""

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
    return EnvironmentNetwork.load(FOLDER, model, provider)


@dataclass(frozen=True, kw_only=True)
class PreparedEnvironment:
    """What predicts the light of environments in one volume, for one optical thickness. Immutable.

    cube: of the volume. skies: the light, S of them of C channels. lookup: of the density at the stencil. low: number
    of its low-frequency points. depths: what is open to points. light, absorbed: of `solve_environment`, of no channel
    where the skies are even: all that the network weighs is their radiance then. radiance: (50, S C), of
    `direction_radiance`. blurred: float32 (H, 2H, B, S C). sigma_hat: extinction per unit density times the
    cube's edge. thickness: the same at the largest density. anisotropy: G.
    """

    network: EnvironmentNetwork
    cube: Cube
    skies: Skies
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

    def predict(self, points: RayPoints, along: np.ndarray, albedos: Sequence[float]) -> np.ndarray:
        """Radiance float32 (1 + A, N, C) scattered towards the camera, without the factor of the local albedo.

        Single scattering, then multiple scattering for each of A albedos. along: (N, 2), optical depth ahead of each
        point and behind it on its ray.
        """
        shares, visible = self.skies.shares(points.positions), self.skies.visible(points.positions)
        points = points.in_cube(self.cube)
        positions, omega = points.positions, points.directions
        first, view = distinct_rows(omega)
        count, channels = len(positions), self.radiance.shape[1] // shares.shape[1]
        density = self.lookup(positions, omega[first], view, points.jitter)[:, : self.low]
        depths = self.depths(positions)
        opened = OpenMeans(depths, lobe_weights(omega[first])[view], self.sigma_hat)
        probes = probe_positions(positions, omega, depths, self.sigma_hat)
        flat, solved = probes.reshape(-1, 3), self.light.shape[-1] // 4
        light = read_lattice(self.light, flat).reshape(count, probes.shape[1], 4, solved)
        absorbed = read_lattice(self.absorbed, flat).reshape(count, probes.shape[1], 4, len(ALBEDOS), solved + 1)
        seldom, even = seldom_scattered(light, absorbed.swapaxes(2, 3), omega)
        x = inputs(density, along, opened, even, omega, self.thickness, self.anisotropy)
        if self.skies.even:
            return self._weighed(x, np.tile(self.radiance[0], (count, CANDIDATES, 1)), albedos)
        ahead, open_to = read_image(self.blurred, omega[first])[view], opened.radiance(self.radiance)
        for sky, seen in visible.items():
            own = slice(sky * channels, (sky + 1) * channels)
            lobes = lobe_weights(omega[first], [np.clip(g, -SHARPEST, SHARPEST) for g in blurs(self.anisotropy)])[view]
            ahead[..., own] *= visible_ahead(lobes, self.radiance[:, own], seen)[..., None]
            open_to[..., own] = opened.radiance(self.radiance[:, own], seen)
        ahead, open_to = _reaching(ahead, shares), _reaching(open_to, shares)
        return self._weighed(x, candidates(ahead, open_to, light, seldom, omega, self.anisotropy), albedos)

    def _weighed(self, x: np.ndarray, radiances: np.ndarray, albedos: Sequence[float]) -> np.ndarray:
        """As `predict`; x, radiances: as of `EnvironmentNetwork.run`."""
        predicted = self.network.run(x, radiances, albedos)
        return np.maximum(predicted, np.float32(0.0)).transpose(1, 0, 2)


def _reaching(radiance: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Radiances (N, K, C) of what reaches N points of skies (N, K, S C), of which they see shares (N, S)."""
    if shares.shape[1] == 1:
        return radiance * shares[:, :, None]
    return np.einsum("nksc,ns->nkc", radiance.reshape(*radiance.shape[:2], shares.shape[1], -1), shares)
