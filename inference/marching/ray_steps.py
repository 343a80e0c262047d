# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays cut into steps, and the blocks of steps that may hold density.

Most of the box around a cloud is empty. Steps are therefore stored in blocks, and only the blocks of a ray that lie
near density: arrays (P, STEPS), the blocks of all rays one after another. The steps of a ray depend on that ray alone,
so that an image does not depend on which rays are marched together.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.occupancy import REACH
from ..numerics.small_matmul import product

# Steps per unit of optical thickness of a voxel of the finest grid; steps per voxel at least, and at most.
STEPS_PER_DEPTH = 2.0
STEPS_PER_VOXEL = (1, 8)
# Minimal number of steps along the longest edge of a coarse grid.
STEPS_PER_EDGE = 128
# Evenly spaced points per step at which volumes are sampled; whatever depends on their mean is evaluated once per step.
SAMPLES = 2
# Rays that graze a corner get as many steps as if they crossed this many voxels.
MIN_VOXELS = 32
# Steps per block: neither end of a block lies further from its middle than the reach of the occupancy.
STEPS = 2 * REACH * STEPS_PER_VOXEL[0]


class Frame(Protocol):
    """An affine transform from world positions to indices: linear @ position + offset."""

    @property
    def linear(self) -> np.ndarray:
        """(3, 3)."""

    @property
    def offset(self) -> np.ndarray:
        """(3,)."""


@dataclass(frozen=True)
class RayBatch:
    """Rays that are marched together.

    origins, directions: float64 (R, 3) in the world, unit directions. near, far: float64 (R,), distances between which
    the rays are marched.
    """

    origins: np.ndarray
    directions: np.ndarray
    near: np.ndarray
    far: np.ndarray

    def take(self, rays: np.ndarray | slice) -> "RayBatch":
        """Some of the rays, by number."""
        return RayBatch(self.origins[rays], self.directions[rays], self.near[rays], self.far[rays])


def voxel_thickness(media: Sequence[BoundMedium]) -> float:
    """Largest optical thickness of a voxel, as if the densest voxels of all media overlapped."""
    return sum(medium.voxel_thickness for medium in media)


def steps_per_voxel(media: Sequence[BoundMedium]) -> float:
    """Number of steps per voxel, by the largest optical thickness of a voxel, within bounds."""
    coarse = STEPS_PER_EDGE / max(max(medium.grid.shape) for medium in media)
    return max(float(np.clip(STEPS_PER_DEPTH * voxel_thickness(media), *STEPS_PER_VOXEL)), coarse)


def step_thickness(media: Sequence[BoundMedium]) -> float:
    """Largest optical thickness of a step."""
    return voxel_thickness(media) / steps_per_voxel(media)


def step_counts(media: Sequence[BoundMedium], rays: RayBatch) -> np.ndarray:
    """Number of steps int (R,) per ray, as the medium that needs most requires."""
    crossed = [
        np.linalg.norm(product(rays.directions, medium.linear.T), axis=1) * (rays.far - rays.near)
        for medium in media
        if medium.matters
    ]
    return np.ceil(np.maximum(np.max(crossed, axis=0), MIN_VOXELS) * steps_per_voxel(media)).astype(int)


class RaySteps:
    """Rays cut into steps: their lengths, and positions on them as continuous indices into several frames.

    near, far: (R,). count: int (R,), number of steps in between. dt: float32 (R,), length of each ray's steps.
    """

    def __init__(self, frames: Sequence[Frame], rays: RayBatch, count: np.ndarray):
        """frames: media, shadow maps or lattices of light, which give indices from world positions."""
        self.near, self.far, self.count = rays.near, rays.far, count
        self.dt = ((rays.far - rays.near) / count).astype(np.float32)
        # Double precision for the start of each ray; single precision from there on.
        start = rays.origins + rays.near[:, None] * rays.directions
        self.first = [(f.linear @ start.T + f.offset[:, None]).astype(np.float32) for f in frames]
        self.slope = [(f.linear @ rays.directions.T).astype(np.float32) for f in frames]

    def index(self, v: int, ray: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Indices into frame v, float32 (3, N) for rays and steps (N,), or (3, N * K) for steps (N, K).

        Steps are counted from the ray's start: step k begins at k and its middle is k + 1/2.
        """
        along = step.astype(np.float32) * self.dt[ray].reshape(-1, *[1] * (step.ndim - 1))
        shape = (3, len(ray)) + (1,) * (step.ndim - 1)
        indices = along * self.slope[v].take(ray, axis=1).reshape(shape)
        indices += self.first[v].take(ray, axis=1).reshape(shape)
        return indices.reshape(3, -1)

    def mean(
        self, sample: Callable[[np.ndarray], np.ndarray], v: int, ray: np.ndarray, number: np.ndarray
    ) -> np.ndarray:
        """Means over the steps of some blocks: float32 (N, STEPS).

        sample: values (M,) at indices (3, M) into frame v. ray, number: (N,), of each block its ray and its place on
        it.
        """
        samples = (np.arange(STEPS * SAMPLES, dtype=np.float32) + np.float32(0.5)) / np.float32(SAMPLES)
        values = sample(self.index(v, ray, (number * STEPS)[:, None] + samples)).reshape(-1, STEPS, SAMPLES)
        return product(values, np.full(SAMPLES, 1.0 / SAMPLES, np.float32))


@dataclass
class Blocks:
    """Some blocks of some rays, in the order of the rays and front to back.

    rays: number of rays. ray, number: int (P,), of each block its ray and its place on it. rank: int (P,), how many
    blocks of the ray come before it here.
    """

    rays: int
    ray: np.ndarray
    number: np.ndarray

    def __post_init__(self) -> None:
        first = np.searchsorted(self.ray, np.arange(self.rays))
        self.rank = np.arange(len(self.ray)) - first[self.ray]

    def steps(self, edges: bool = False) -> np.ndarray:
        """Number of each step on its ray, int (P, STEPS), or of the edges between steps, (P, STEPS + 1)."""
        return self.number[:, None] * STEPS + np.arange(STEPS + edges)

    def followed(self) -> np.ndarray:
        """bool (P,): whether the next block begins where this one ends, on the same ray."""
        followed = np.zeros(len(self.ray), bool)
        followed[:-1] = (self.ray[1:] == self.ray[:-1]) & (self.number[1:] == self.number[:-1] + 1)
        return followed

    def where(self, chosen: np.ndarray) -> "Blocks":
        """The blocks chosen by a mask (P,) or by number."""
        return Blocks(self.rays, self.ray[chosen], self.number[chosen])

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums float64 (R,) over each ray of values (P,)."""
        return np.bincount(self.ray, values, self.rays)

    def before(self, values: np.ndarray) -> np.ndarray:
        """Sums float64 (P,) of values (P,) over the blocks in front of each on its ray."""
        return self._running(values, self.rank)

    def behind(self, values: np.ndarray) -> np.ndarray:
        """Sums float64 (P,) of values (P,) over the blocks behind each on its ray."""
        last = np.bincount(self.ray, minlength=self.rays)[self.ray] - 1
        return self._running(values, last - self.rank)

    def _running(self, values: np.ndarray, place: np.ndarray) -> np.ndarray:
        # One row per ray: the sums of one ray do not touch those of another, however large they are.
        table = np.zeros((self.rays, place.max(initial=-1) + 2))
        table[self.ray, place + 1] = values
        np.cumsum(table, axis=1, out=table)
        return table[self.ray, place]


def blocks_near_density(
    media: Sequence[BoundMedium], steps: RaySteps, always_first: bool, skip_empty: bool = True
) -> Blocks:
    """Blocks that may hold density of any medium.

    always_first: keep at least the first block of each ray. skip_empty: without, all blocks.
    """
    counts = -(-steps.count // STEPS)
    ray = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(ray)) - np.repeat(np.cumsum(counts) - counts, counts)
    if not skip_empty:
        return Blocks(len(counts), ray, number)
    near = (number == 0) & always_first
    middle = number * STEPS + 0.5 * STEPS
    for v, medium in enumerate(media):
        near |= medium.grid.occupancy.near(steps.index(v, ray, middle))
    return Blocks(len(counts), ray[near], number[near])


def sums_within(values: np.ndarray) -> np.ndarray:
    """Inclusive prefix sums of values (P, STEPS) along each block."""
    sums = values.copy()
    for k in range(1, values.shape[1]):
        sums[:, k] += sums[:, k - 1]
    return sums
