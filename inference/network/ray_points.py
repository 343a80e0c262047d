# SPDX-License-Identifier: GPL-3.0-or-later
"""Points along camera rays, which networks are asked about."""

from dataclasses import dataclass, replace

import numpy as np

from ..grids.working_cube import Cube


@dataclass(frozen=True)
class RayPoints:
    """N points along camera rays.

    positions: (N, 3). directions: (N, 3), unit vectors along the rays. jitter: (N, 3) in [-1/2, 1/2), offset of each
    point's lookups in cells, or None. ray_features: float32 (N, COLUMNS) of `RayFeatures`, None for networks that need
    none.
    """

    positions: np.ndarray
    directions: np.ndarray
    jitter: np.ndarray | None = None
    ray_features: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.positions)

    def in_cube(self, cube: Cube) -> "RayPoints":
        """The same points in the cube's frame, of points of the world."""
        return replace(self, positions=cube.positions(self.positions), directions=cube.directions(self.directions))

    def thickened(self, factor: float) -> "RayPoints":
        """The same points with the ray features of so many times the optical thickness.

        Depths are proportional to it, and so is the little light that a thin medium scatters.
        """
        ray = self.ray_features
        if ray is None or factor == 1.0:
            return self
        return replace(self, ray_features=np.concatenate([ray[:, :2] * factor, ray[:, 2:] * max(factor, 1.0)], axis=1))
