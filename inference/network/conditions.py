# SPDX-License-Identifier: GPL-3.0-or-later
"""The conditions under which the multiple scattering of a volume is predicted."""

from dataclasses import dataclass

import numpy as np

from ..occluders.shadow_map import ShadowMap
from ..transport.lamp_beam import LampInCube

# Lowest and highest coordinates (3,).
Bounds = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Conditions:
    """One optical thickness and one sun or lamp, in the frame of a volume's working cube.

    sigma_hat: extinction per unit density times the cube's edge. sun: (3,) unit vector towards it. bounds: lowest and
    highest (3,) of the points to predict at. shadow_map: of the sun, in the cube's frame, or None. triangles: (T, 3, 3)
    of black surfaces, in the cube's frame, or None. occluders: `Occluders.key` of those that shadow_map and triangles
    stand for. screen: `Sun.screen_key`. lamp: that takes the sun's place, or None.
    """

    sigma_hat: float
    sun: np.ndarray
    bounds: Bounds
    shadow_map: ShadowMap | None = None
    triangles: np.ndarray | None = None
    occluders: bytes = b""
    screen: bytes = b""
    lamp: LampInCube | None = None

    @property
    def bounds_key(self) -> tuple[float, ...]:
        """Equal for conditions with equal lattices of the density."""
        low, high = self.bounds
        return (self.sigma_hat, *low, *high)
