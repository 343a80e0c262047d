# SPDX-License-Identifier: GPL-3.0-or-later
"""A medium bound to its grid and to the extinction of colour channels, for ray marching."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..scene.description import Medium
from .grid import Grid
from .sun_optical_depth import SunOpticalDepth


@dataclass(frozen=True)
class BoundMedium:
    """A volume as rays traverse it in colour channels of equal extinction.

    sigma_t: extinction coefficient per unit density and world unit. sun_depths: L optical depths, one per sun.
    motion: float64 (E, 3, 4), places at the frame of places at the time at which each eye sees, in the world; None for
    a volume that stands still.
    """

    grid: Grid
    medium: Medium
    sigma_t: float
    sun_depths: list[SunOpticalDepth]
    motion: np.ndarray | None = None

    @property
    def linear(self) -> np.ndarray:
        """(3, 3), linear part of continuous indices from world positions."""
        return self.grid.linear

    @property
    def offset(self) -> np.ndarray:
        """(3,), translation of continuous indices from world positions."""
        return self.grid.offset

    @property
    def emits(self) -> bool:
        """Whether the volume emits light."""
        return bool(self.grid.emission) and self.medium.emission > 0.0

    @property
    def varies(self) -> bool:
        """Whether the albedo varies where the medium attenuates."""
        return bool(self.grid.scattering) and self.sigma_t > 0.0

    @property
    def matters(self) -> bool:
        """Whether the volume attenuates or may emit light in these channels."""
        return self.sigma_t > 0.0 or bool(self.grid.emission)

    @property
    def voxel_thickness(self) -> float:
        """Largest optical thickness of a voxel, along its longest edge."""
        return self.grid.peak * self.sigma_t * self.grid.longest


def scattering_channels(media: Sequence[BoundMedium], channels: Sequence[int]) -> list[int]:
    """Colour channels whose scattering differs: all of `channels` if an albedo varies in colour, else the first."""
    coloured = any(medium.varies and len(medium.grid.scattering) == 3 for medium in media)
    return list(channels) if coloured else list(channels[:1])
