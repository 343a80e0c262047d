"""Camera rays cut into steps, and the blocks of steps that may hold anything.

Most of a box around a cloud is empty. Steps are therefore kept in blocks of a few, and only those blocks of a
ray that lie near density: arrays (P, STEPS), all rays' blocks one after another. A ray's steps depend on that
ray alone, so that an image does not depend on which rays are marched together.
"""

from dataclasses import dataclass

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.occupancy import REACH
from ..numerics.small_matmul import product

# Steps for each optical depth that a voxel of the finest grid may hold; per voxel at least, and at most.
STEPS_PER_DEPTH = 2.0
STEPS_PER_VOXEL = (1, 8)
# Of a coarse grid, along its longest edge at least.
STEPS_PER_EDGE = 128
# Places in each step, evenly apart, at which volumes are read; what follows from the mean is asked for once a step.
PLACES = 2
# A ray that only grazes a corner is cut as finely as if it passed so many voxels.
LEAST_VOXELS = 32
# Of a block: no end of it lies further from its middle than occupancy tells.
STEPS = 2 * REACH * STEPS_PER_VOXEL[0]


@dataclass(frozen=True)
class RayBatch:
    """Rays that are marched together.

    origins, directions: float64 (R, 3) in the world, directions of unit length. near, far: float64 (R,), distances between
    which the rays are marched.
    """

    origins: np.ndarray
    directions: np.ndarray
    near: np.ndarray
    far: np.ndarray

    def take(self, rays) -> "RayBatch":
        """Some of the rays."""
        return RayBatch(self.origins[rays], self.directions[rays], self.near[rays], self.far[rays])


def voxel_thickness(media: list[BoundMedium]) -> float:
    """Largest optical thickness of a voxel, as if the densest voxels of all media overlapped."""
    return sum(medium.voxel_thickness for medium in media)


def steps_per_voxel(media: list[BoundMedium]) -> float:
    """By the largest optical thickness of a voxel, within bounds."""
    coarse = STEPS_PER_EDGE / max(max(medium.grid.shape) for medium in media)
    return max(float(np.clip(STEPS_PER_DEPTH * voxel_thickness(media), *STEPS_PER_VOXEL)), coarse)


def step_thickness(media: list[BoundMedium]) -> float:
    """Largest optical thickness of a step."""
    return voxel_thickness(media) / steps_per_voxel(media)


def step_counts(media: list[BoundMedium], rays: RayBatch) -> np.ndarray:
    """Steps (R,) that each ray is cut into, by the medium that needs most."""
    crossed = [
        np.linalg.norm(product(rays.directions, medium.linear.T), axis=1) * (rays.far - rays.near)
        for medium in media if medium.matters
    ]
    return np.ceil(np.maximum(np.max(crossed, axis=0), LEAST_VOXELS) * steps_per_voxel(media)).astype(int)


class RaySteps:
    """Rays cut into steps: their lengths, and positions on them as continuous indices into each grid.

    near, far: (R,) and count: int (R,), the number of steps in between. dt: (R,) float32 length of each ray's steps.
    """

    def __init__(self, frames, rays: RayBatch, count):
        """frames: with `linear` (3, 3) and `offset` (3,), indices from world positions."""
        self.near, self.far, self.count = rays.near, rays.far, count
        self.dt = ((rays.far - rays.near) / count).astype(np.float32)
        # Indices at the start of each ray in double precision; from there on in single.
        start = rays.origins + rays.near[:, None] * rays.directions
        self.first = [(f.linear @ start.T + f.offset[:, None]).astype(np.float32) for f in frames]
        self.slope = [(f.linear @ rays.directions.T).astype(np.float32) for f in frames]

    def index(self, v: int, ray, step):
        """float32 (3, N) at pairs of ray and step, (N,), or (3, N * K) at steps (N, K)."""
        along = step.astype(np.float32) * self.dt[ray].reshape(-1, *[1] * (step.ndim - 1))
        shape = (3, len(ray)) + (1,) * (step.ndim - 1)
        places = along * self.slope[v].take(ray, axis=1).reshape(shape)
        places += self.first[v].take(ray, axis=1).reshape(shape)
        return places.reshape(3, -1)

    def mean(self, sample, v: int, ray, number) -> np.ndarray:
        """(N, STEPS): means over each step of what `sample` gives at indices into a grid, of blocks, (N,) their numbers."""
        places = (np.arange(STEPS * PLACES, dtype=np.float32) + np.float32(0.5)) / np.float32(PLACES)
        values = sample(self.index(v, ray, (number * STEPS)[:, None] + places)).reshape(-1, STEPS, PLACES)
        return product(values, np.full(PLACES, 1.0 / PLACES, np.float32))


@dataclass
class Blocks:
    """Some blocks of some rays, in the order of the rays and front to back.

    rays: how many rays there are; ray, number: (P,), of each block its ray and its place on it.
    """

    rays: int
    ray: np.ndarray
    number: np.ndarray

    def __post_init__(self):
        first = np.searchsorted(self.ray, np.arange(self.rays))
        self.rank = np.arange(len(self.ray)) - first[self.ray]

    def steps(self, edges: bool = False) -> np.ndarray:
        """int (P, STEPS) number of each step on its ray, or (P, STEPS + 1) of the edges between them."""
        return self.number[:, None] * STEPS + np.arange(STEPS + edges)

    def followed(self) -> np.ndarray:
        """bool (P,): whether the next block begins where this one ends, on the same ray."""
        followed = np.zeros(len(self.ray), bool)
        followed[:-1] = (self.ray[1:] == self.ray[:-1]) & (self.number[1:] == self.number[:-1] + 1)
        return followed

    def where(self, chosen) -> "Blocks":
        return Blocks(self.rays, self.ray[chosen], self.number[chosen])

    def sums(self, values: np.ndarray) -> np.ndarray:
        """float64 (R,) of values (P,)."""
        return np.bincount(self.ray, values, self.rays)

    def before(self, values: np.ndarray) -> np.ndarray:
        """float64 (P,): sums of values (P,) over the blocks before each on its ray."""
        return self._running(values, self.rank)

    def behind(self, values: np.ndarray) -> np.ndarray:
        """float64 (P,): sums of values (P,) over the blocks behind each on its ray."""
        last = np.bincount(self.ray, minlength=self.rays)[self.ray] - 1
        return self._running(values, last - self.rank)

    def _running(self, values, place):
        # A row a ray: sums of one ray never meet another's, however large.
        table = np.zeros((self.rays, place.max(initial=-1) + 2))
        table[self.ray, place + 1] = values
        np.cumsum(table, axis=1, out=table)
        return table[self.ray, place]


def blocks_near_density(media, steps: RaySteps, always_first: bool, skip_empty: bool = True) -> Blocks:
    """Blocks that may hold density of any medium, or all. always_first: of every ray at least the first."""
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
    """Running sums of values (P, STEPS) along each block."""
    sums = values.copy()
    for k in range(1, values.shape[1]):
        sums[:, k] += sums[:, k - 1]
    return sums
