# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays cut into steps, and the blocks of steps that may hold density.

Most of the box around a cloud is empty. Steps are therefore stored in blocks of equal steps, and only the blocks of a
ray that lie near density: arrays (P, STEPS), the blocks of all rays one after another. Blocks whose steps are too thick
are cut into smaller blocks. Positions on a ray are in coarse steps. The steps of a ray depend on that ray alone, so
that an image does not depend on which rays are marched together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.occupancy import REACH
from ..numerics.small_matmul import lengths, product

# Minimal number of coarse steps along the longest edge of a grid; there is one per voxel at least.
STEPS_PER_EDGE = 128
# Optical thickness of a step above which its block is cut where the ray begins, and the optical depth over which this
# limit grows by e: deeper steps are seen less.
STEP_THICKNESS, STEP_GROWTH = 0.3, 8.0
# The same for steps taken as dense as the densest voxel near, towards which light may vary as much; and the finest
# step, as a fraction of a coarse step, that blocks are cut into for that.
PEAK_THICKNESS, PEAK_GROWTH, FINEST = 0.3, 3.0, 0.0625
# How often a block may be cut, and into how many at a time.
LEVELS, MOST_PARTS = 7, 8
# Evenly spaced points per step at which volumes are sampled; whatever depends on their mean is evaluated once per step.
SAMPLES = 2
# Rays that graze a corner get as many steps as if they crossed this many voxels.
MIN_VOXELS = 32
# Steps per block: neither end of a block lies further from its middle than the reach of the occupancy.
STEPS = 2 * REACH


@dataclass(frozen=True)
class RayBatch:
    """Rays that are marched together.

    origins, directions: float64 (R, 3) in the world, unit directions. near, far: float64 (R,), distances between which
    the rays are marched. detail: int (R,), times as many depth samples on each as `MarchOptions.depth_samples` says, at
    most `MarchOptions.most_detail`; None: as many.
    """

    origins: np.ndarray
    directions: np.ndarray
    near: np.ndarray
    far: np.ndarray
    detail: np.ndarray | None = None

    def take(self, rays: np.ndarray | slice) -> "RayBatch":
        """A batch of these rays, by number."""
        detail = None if self.detail is None else self.detail[rays]
        return RayBatch(self.origins[rays], self.directions[rays], self.near[rays], self.far[rays], detail)

    def plain(self) -> "RayBatch":
        """The same without detail."""
        return RayBatch(self.origins, self.directions, self.near, self.far)


def steps_per_voxel(media: Sequence[BoundMedium]) -> float:
    """Number of coarse steps per voxel."""
    return max(1.0, STEPS_PER_EDGE / max(max(medium.grid.shape) for medium in media))


def step_counts(media: Sequence[BoundMedium], rays: RayBatch, least: int = MIN_VOXELS) -> np.ndarray:
    """Number of coarse steps int (R,) per ray, for the medium that needs the most; least: voxels that a ray crosses."""
    # Instances that are turned alike need the same.
    turned = {medium.linear.tobytes(): medium.linear for medium in media if medium.matters}
    crossed = [lengths(product(rays.directions, linear.T)) * (rays.far - rays.near) for linear in turned.values()]
    return np.ceil(np.maximum(np.max(crossed, axis=0), least) * steps_per_voxel(media)).astype(int)
