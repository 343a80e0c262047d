# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays cut into steps, and the blocks of steps that may hold density.

Most of the box around a cloud is empty. Steps are therefore stored in blocks of equal steps, and only the blocks of a
ray that lie near density: arrays (P, STEPS), the blocks of all rays one after another. Blocks whose steps are too thick
are cut into smaller blocks. Positions on a ray are in coarse steps. The steps of a ray depend on that ray alone, so
that an image does not depend on which rays are marched together.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..grids.bound_medium import BoundMedium, Movement
from ..grids.occupancy import REACH
from ..numerics.intersection import box_interval
from ..numerics.small_matmul import lengths, product

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
# Rays times media whose crossings are found at a time.
CROSSINGS = 1 << 17
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

    def crossings(
        self, origins: np.ndarray, directions: np.ndarray, clip: Sequence[np.ndarray]
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Where R rays meet N media at a time, between distances `clip`, (R,) each.

        Yields the distances (R, N) at which they enter and leave, infinite and in the wrong order on a miss, the
        lengths (R, N) of a world unit on each ray in voxels, and the voxels (N,) along the media's longest edges.
        """
        size = max(CROSSINGS // max(len(origins), 1), 1)
        near, far = np.broadcast_to(clip[0], len(origins)), np.broadcast_to(clip[1], len(origins))
        for start in range(0, len(self.linear), size):
            span = slice(start, start + size)
            frames, shape = self.linear[span].reshape(-1, 3).T, self.shape[span]
            at = product(origins, frames).reshape(-1, len(shape), 3) + self.offset[span]
            slopes = product(directions, frames).reshape(-1, len(shape), 3)
            enter, leave = box_interval(at, slopes, self.low[span], self.high[span])
            enter, leave = np.maximum(enter, near[:, None]), np.minimum(leave, far[:, None])
            miss = ~(enter < leave)
            enter[miss], leave[miss] = np.inf, -np.inf
            yield enter, leave, lengths(slopes.reshape(-1, 3)).reshape(miss.shape), shape.max(axis=1)

    def intervals(
        self, origins: np.ndarray, directions: np.ndarray, clip: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Intervals in which rays meet any medium: near and far (R,), near > far on a miss.

        clip: distances (R,) to the near and the far clipping plane.
        """
        near, far = np.full(len(origins), np.inf), np.full(len(origins), -np.inf)
        for enter, leave, _, _ in self.crossings(origins, directions, clip):
            near, far = np.minimum(near, enter.min(axis=1)), np.maximum(far, leave.max(axis=1))
        return near, far


def step_counts(boxes: Boxes, rays: RayBatch, least: int = MIN_VOXELS) -> np.ndarray:
    """Number of coarse steps int (R,) per ray, for the medium that needs the most of those that it meets.

    least: voxels that a ray crosses.
    """
    counts = np.full(len(rays.near), least)
    if rays.eyes is not None and any(motion is not None for motion in boxes.motion):
        for eye in np.unique(rays.eyes):
            some = np.flatnonzero(rays.eyes == eye)
            counts[some] = step_counts(boxes.seen_by(eye), replace(rays.take(some), eyes=None), least)
        return counts
    for enter, leave, scale, edges in boxes.crossings(rays.origins, rays.directions, (rays.near, rays.far)):
        crossed = np.maximum(scale * (rays.far - rays.near)[:, None], least)
        needed = np.ceil(crossed * np.maximum(STEPS_PER_EDGE / edges, 1.0)) * (enter < leave)
        counts = np.maximum(counts, needed.max(axis=1).astype(int))
    return counts
