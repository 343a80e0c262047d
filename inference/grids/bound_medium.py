# SPDX-License-Identifier: GPL-3.0-or-later
"""A medium bound to its grid and to the extinction of some colour channels, for ray marching."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..numerics.intersection import box_interval
from ..scene.description import Medium
from .grid import Grid
from .sun_optical_depth import ZERO, SunOpticalDepth


@dataclass(frozen=True)
class BoundMedium:
    """One volume as rays traverse it in some colour channels.

    sigma_t: extinction coefficient per unit density and world unit. sun_depths: L optical depths, one per sun.
    """

    grid: Grid
    medium: Medium
    sigma_t: float
    sun_depths: list[SunOpticalDepth]

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

    def sun_optical_depth(
        self, index: np.ndarray, sun: int, may_be_outside: bool, camera_depth: np.ndarray | np.float32 = ZERO
    ) -> np.ndarray:
        """Optical depth float32 (N,) from continuous indices float32 (3, N) to a sun.

        may_be_outside: whether points may lie outside the support. They are moved towards the sun onto it; where the
        ray misses it the depth is 0. camera_depth: as for SunOpticalDepth.
        """
        depth = self.sun_depths[sun]
        if not may_be_outside:
            return depth(index, self.sigma_t, camera_depth)
        direction = depth.direction
        near, far = box_interval(index.T, direction[None], *self.grid.box)
        hits = far > np.maximum(near, 0.0)
        index = index + np.where(hits, np.maximum(near, 0.0), 0.0) * direction[:, None]
        return np.where(hits, depth(index.astype(np.float32), self.sigma_t, camera_depth), np.float32(0.0))


def scattering_channels(media: Sequence[BoundMedium], channels: Sequence[int]) -> list[int]:
    """Of the colour channels that are rendered together, those whose scattering differs: the first stands for all
    unless an albedo varies in colour.
    """
    coloured = any(medium.varies and len(medium.grid.scattering) == 3 for medium in media)
    return list(channels) if coloured else list(channels[:1])
