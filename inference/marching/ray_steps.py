# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays cut into steps, and the blocks of steps that may hold density.

Most of the box around a cloud is empty. Steps are therefore stored in blocks of equal steps, and only the blocks of a
ray that lie near density: arrays (P, STEPS), the blocks of all rays one after another. Blocks whose steps are too thick
are cut into smaller blocks. Positions on a ray are in coarse steps. The steps of a ray depend on that ray alone, so
that an image does not depend on which rays are marched together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..grids.bound_medium import BoundMedium, Movement
from ..grids.occupancy import REACH
from ..kernels.library import call

# Minimal number of coarse steps along the longest edge of a grid; there is one per voxel at least.
STEPS_PER_EDGE = 128
# Optical thickness of a step above which its block is cut where the ray begins, and the optical depth over which this
# limit grows by e: deeper steps are seen less.
STEP_THICKNESS, STEP_GROWTH = 0.3, 8.0
# The same for steps taken as dense as the densest voxel near, towards which light may vary as much; and the finest
# step, as a fraction of a coarse step, that blocks are cut into for that.
PEAK_THICKNESS, PEAK_GROWTH, FINEST = 0.3, 3.0, 0.0625
# How often a block may be cut, and into how many at a time: as kernels/steps.h has it, for the docs.
LEVELS, MOST_PARTS = 7, 8
# Evenly spaced points per step at which volumes are sampled; whatever depends on their mean is evaluated once per step.
SAMPLES = 2
# Rays that graze a corner get as many steps as if they crossed this many voxels.
MIN_VOXELS = 32
# Rays times media whose crossings are found at a time, and steps above which nobody counts.
CROSSINGS, MANY = 1 << 20, 2.0**60
# Steps per block: neither end of a block lies further from its middle than the reach of the occupancy.
STEPS = 2 * REACH


@dataclass(frozen=True)
class RayBatch:
    """Rays that are marched together.

    origins, directions: float64 (R, 3) in the world, unit directions. near, far: float64 (R,), distances between which
    the rays are marched. detail: int (R,), times as many depth samples on each as `MarchOptions.depth_samples` says, at
    most `MarchOptions.most_detail`; None: as many. eyes: int (R,), numbers of the eyes that see along them, by which
    volumes move; None where all volumes stand still.
    """

    origins: np.ndarray
    directions: np.ndarray
    near: np.ndarray
    far: np.ndarray
    detail: np.ndarray | None = None
    eyes: np.ndarray | None = None

    def take(self, rays: np.ndarray | slice) -> "RayBatch":
        """A batch of these rays, by number."""
        detail, eyes = (None if values is None else values[rays] for values in (self.detail, self.eyes))
        return RayBatch(self.origins[rays], self.directions[rays], self.near[rays], self.far[rays], detail, eyes)

    def plain(self) -> "RayBatch":
        """The same without detail."""
        return replace(self, detail=None)


@dataclass(frozen=True)
class Boxes:
    """The supports of V media that attenuate or emit, as rays meet them.

    linear: (V, 3, 3) and offset: (V, 3), continuous indices from world positions. shape: (V, 3), voxels. low, high:
    (V, 3), indices at which rays may meet what they hold. motion: as of BoundMedium, of each.
    """

    linear: np.ndarray
    offset: np.ndarray
    shape: np.ndarray
    low: np.ndarray
    high: np.ndarray
    motion: Sequence[Movement | None] = ()

    @classmethod
    def of(cls, media: Sequence[BoundMedium]) -> "Boxes":
        """Of some media."""
        media = [medium for medium in media if medium.matters]
        return cls(
            np.array([medium.linear for medium in media]).reshape(-1, 3, 3),
            np.array([medium.offset for medium in media]).reshape(-1, 3),
            np.array([medium.grid.shape for medium in media], np.float64).reshape(-1, 3),
            np.array([medium.box[0] for medium in media]).reshape(-1, 3),
            np.array([medium.box[1] for medium in media]).reshape(-1, 3),
            [medium.motion for medium in media],
        )

    def seen_by(self, eye: int) -> "Boxes":
        """Where they are when an eye sees them."""
        linear, offset = self.linear.copy(), self.offset.copy()
        for v, motion in enumerate(self.motion):
            if motion is not None:
                offset[v] += linear[v] @ motion.frames[eye, :, 3]
                linear[v] = linear[v] @ motion.frames[eye, :, :3]
        return Boxes(linear, offset, self.shape, self.low, self.high)

    def crossed(self, rays: RayBatch, least: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances (R,) between which rays meet any medium, infinite and in the wrong order on a miss, and the coarse
        steps (R,) of each for the medium that needs the most of those that it meets.

        least: voxels that a ray crosses.
        """
        enter, leave, counts = np.empty((3, len(rays.near)))
        steps = np.maximum(STEPS_PER_EDGE / np.max(self.shape, axis=1, initial=1.0), 1.0)
        size = max(CROSSINGS // max(len(steps), 1), 1)
        for start in range(0, len(enter), size):
            some = slice(start, start + size)
            call(
                "cross_boxes",
                rays=len(enter[some]),
                boxes=len(steps),
                origins=np.ascontiguousarray(rays.origins[some], np.float64),
                directions=np.ascontiguousarray(rays.directions[some], np.float64),
                near_distance=np.ascontiguousarray(rays.near[some], np.float64),
                far_distance=np.ascontiguousarray(rays.far[some], np.float64),
                linear=np.ascontiguousarray(self.linear),
                offset=np.ascontiguousarray(self.offset),
                low=np.ascontiguousarray(self.low, np.float64),
                high=np.ascontiguousarray(self.high, np.float64),
                steps=steps,
                least=least,
                enter=enter[some],
                leave=leave[some],
                counts=counts[some],
            )
        return enter, leave, counts

    def intervals(
        self, origins: np.ndarray, directions: np.ndarray, clip: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Intervals in which rays meet any medium: near and far (R,), near > far on a miss.

        clip: distances (R,) to the near and the far clipping plane.
        """
        near, far = (np.broadcast_to(end, len(origins)) for end in clip)
        return self.crossed(RayBatch(origins, directions, near, far))[:2]


def step_counts(boxes: Boxes, rays: RayBatch, least: int = MIN_VOXELS) -> np.ndarray:
    """Number of coarse steps int (R,) per ray, for the medium that needs the most of those that it meets.

    least: voxels that a ray crosses.
    """
    if rays.eyes is not None and any(motion is not None for motion in boxes.motion):
        counts = np.empty(len(rays.near), int)
        for eye in np.unique(rays.eyes):
            some = np.flatnonzero(rays.eyes == eye)
            counts[some] = step_counts(boxes.seen_by(eye), replace(rays.take(some), eyes=None), least)
        return counts
    # Rays of infinitely many steps are told apart later.
    return np.minimum(boxes.crossed(rays, least)[2], MANY).astype(int)
