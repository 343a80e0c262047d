# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays cut into blocks of steps, many rays at a time.

Arrays (P, STEPS) hold the blocks of all rays one after another. Places on a ray are counted in its coarse steps.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from inference.grids.bound_medium import BoundMedium
from inference.marching.ray_steps import (
    FINEST,
    PEAK_GROWTH,
    PEAK_THICKNESS,
    STEP_GROWTH,
    STEP_THICKNESS,
    STEPS,
    Boxes,
    RayBatch,
    step_counts,
)
from inference.numerics.small_matmul import product

from .cells import near_filled, peaks_near

# How often a block may be cut, and into how many at a time.
LEVELS, MOST_PARTS = 7, 8
# Parts of a step in whose middles visibility is looked up where it changes.
VISIBLE_PARTS = 8
# Evenly spaced points per step at which volumes are sampled; whatever depends on their mean is evaluated once per step.
SAMPLES = 2


class Frame(Protocol):
    """An affine transform from world positions to indices: linear @ position + offset."""

    @property
    def linear(self) -> np.ndarray:
        """(3, 3)."""

    @property
    def offset(self) -> np.ndarray:
        """(3,)."""


class RayLines:
    """Rays as lines through several frames, by places on the rays.

    count: int (R,), number of coarse steps. near, dt: float64 (R,), distance at which each ray begins, and length of
    its coarse steps.
    """

    def __init__(self, frames: Sequence[Frame], rays: RayBatch, count: np.ndarray):
        """frames: media, shadow maps or lattices of light, which give indices from world positions."""
        self.near, self.count, self.dt = rays.near, count, (rays.far - rays.near) / count
        start = rays.origins + rays.near[:, None] * rays.directions
        self.first = [product(start, frame.linear.T) + frame.offset for frame in frames]
        self.slope = [product(rays.directions, frame.linear.T) * self.dt[:, None] for frame in frames]

    def index(self, v: int, ray: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Indices into frame v, float32 (3, N), of places (N,) on rays (N,)."""
        return (place[:, None] * self.slope[v][ray] + self.first[v][ray]).astype(np.float32).T

    def mean(self, sample: Callable[[np.ndarray], np.ndarray], v: int, blocks: "Blocks") -> np.ndarray:
        """Means over steps, float32 (P, STEPS); sample: values (N,) at indices (3, N) into frame v."""
        begin = self.index(v, blocks.ray, blocks.place)
        slope = (blocks.size[:, None] * self.slope[v][blocks.ray]).astype(np.float32).T
        samples = (np.arange(STEPS * SAMPLES, dtype=np.float32) + np.float32(0.5)) / np.float32(SAMPLES)
        index = samples * slope[:, :, None] + begin[:, :, None]
        values = sample(index.reshape(3, -1)).reshape(-1, STEPS, SAMPLES)
        return np.float32(0.5) * values[..., 0] + np.float32(0.5) * values[..., 1]


@dataclass
class Blocks:
    """Some blocks of some rays, in the order of the rays and front to back.

    rays: number of rays. ray: int (P,), of each block. place, size: float64 (P,), where it begins on its ray, and the
    size of its steps. looked_at: number of blocks that were looked at to find these. rank: int (P,), how many blocks of
    the ray come before it here.
    """

    rays: int
    ray: np.ndarray
    place: np.ndarray
    size: np.ndarray
    looked_at: int = 0

    def __post_init__(self) -> None:
        first = np.searchsorted(self.ray, np.arange(self.rays))
        self.rank = np.arange(len(self.ray)) - first[self.ray]

    def steps(self, inside: float) -> np.ndarray:
        """Places (P, STEPS) in the steps."""
        return self.place[:, None] + (np.arange(STEPS) + inside) * self.size[:, None]

    def edges(self) -> np.ndarray:
        """Places (P, STEPS + 1) of the edges between steps."""
        return self.place[:, None] + np.arange(STEPS + 1) * self.size[:, None]

    def followed(self) -> np.ndarray:
        """bool (P,): whether the next block begins where this one ends, on the same ray."""
        followed = np.zeros(len(self.ray), bool)
        ends = self.place + STEPS * self.size
        followed[:-1] = (self.ray[1:] == self.ray[:-1]) & (self.place[1:] == ends[:-1])
        return followed

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


def sums_within(values: np.ndarray) -> np.ndarray:
    """Inclusive prefix sums of values (P, STEPS) along each block."""
    sums = values.copy()
    for k in range(1, values.shape[1]):
        sums[:, k] += sums[:, k - 1]
    return sums


@dataclass(frozen=True)
class Cutting:
    """How rays are cut into blocks.

    behind: optical depth beyond which they are not followed. skip_empty: without, places away from density are looked
    at like others. keep_empty: keep blocks without extinction, where any volume may hold something. always_first: keep
    the first block of each ray. everywhere: volumes count even on rays that miss their support.
    """

    behind: float
    skip_empty: bool = True
    keep_empty: bool = False
    always_first: bool = False
    everywhere: bool = False


def met_volumes(media: Sequence[BoundMedium], rays: RayBatch) -> np.ndarray:
    """bool (R, V): whether rays meet the support of each volume."""
    met = []
    for medium in media:
        enter, leave = medium.grid.interval(rays.origins, rays.directions)
        met.append(np.maximum(enter, rays.near) <= np.minimum(leave, rays.far))
    return np.stack(met, axis=1)


def cut_into_blocks(
    media: Sequence[BoundMedium], rays: RayBatch, cutting: Cutting
) -> tuple[RayLines, Blocks, np.ndarray]:
    """Blocks of rays, and the mean extinction float32 (V, P, STEPS) of their steps.

    Each ray looks at one block after another, as coarse as it may be, and cuts those that turn out to be too thick.
    """
    lines = RayLines(media, rays, step_counts(Boxes.of(media), rays))
    count = len(lines.count)
    met = met_volumes(media, rays) | (cutting.everywhere or len(media) == 1)
    whole = -(-lines.count // STEPS) * float(STEPS)
    place, reached, gap = np.zeros((3, count))
    level = np.zeros(count, int)
    size, end = np.ones((count, LEVELS + 1)), np.zeros((count, LEVELS + 1))
    found, looked_at = [], 0
    while True:
        ray = np.flatnonzero((place < whole) & (reached < cutting.behind))
        if not len(ray):
            break
        for _ in range(LEVELS):
            level[ray] -= (level[ray] > 0) & (place[ray] >= end[ray, level[ray]])
        blocks = Blocks(count, ray, place[ray], size[ray, level[ray]])
        sigma, near, nearby = _look_at(media, lines, blocks, cutting, met)
        looked_at += int(near.sum())
        tau = sigma.sum(axis=0) * (lines.dt[ray] * blocks.size).astype(np.float32)[:, None]
        peak = nearby * (lines.dt[ray] * blocks.size)
        parts = np.where(level[ray] < LEVELS, _parts(tau, reached[ray], blocks.size, peak), 1)
        kept = parts == 1
        gained = sums_within(tau)[:, -1]
        some = kept & near & (cutting.keep_empty | (gained > 0.0))
        found.append((ray[some], blocks.place[some], blocks.size[some], sigma[:, some]))
        reached[ray[kept]] += gained[kept]
        gap[ray[kept]] = np.where(tau[kept, -1] > 0.0, 0.0, blocks.size[kept])
        place[ray[kept]] += STEPS * blocks.size[kept]
        cut, step, parts = ray[~kept], blocks.size[~kept], parts[~kept]
        # Density that begins here may begin in the step in front, behind its samples.
        back = np.minimum(gap[cut], step) * (tau[~kept, 0] > 0.0)
        back = np.where(4.0 * step <= MOST_PARTS * back, back, 0.0)
        for _ in range(MOST_PARTS):
            parts = np.where((back > 0.0) & (parts * back < 4.0 * step), 2 * parts, parts)
        level[cut] += 1
        size[cut, level[cut]] = step / parts
        end[cut, level[cut]] = place[cut] + STEPS * step
        place[cut] -= back
        gap[cut] = 0.0
    ray, place, size = (np.concatenate([np.zeros(0, int if n == 0 else float), *column]) for n, column in
                        enumerate(list(zip(*found))[:3]))  # fmt: skip
    order = np.argsort(ray, kind="stable")
    sigma = np.concatenate([block[3] for block in found], axis=1)
    return lines, Blocks(count, ray[order].astype(int), place[order], size[order], looked_at), sigma[:, order]


def _look_at(
    media: Sequence[BoundMedium], lines: RayLines, blocks: Blocks, cutting: Cutting, met: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Extinction (V, P, STEPS) of blocks, whether any volume may hold something there, bool (P,), and the largest
    extinction float64 (P,) that there may be.

    met: of `met_volumes`.
    """
    sigma = np.zeros((len(media), len(blocks.ray), STEPS), np.float32)
    nearby = np.zeros(len(blocks.ray))
    anywhere = cutting.always_first & (blocks.place == 0.0)
    inside = blocks.steps(0.0) < lines.count[blocks.ray, None]
    for v, medium in enumerate(media):
        middle = lines.index(v, blocks.ray, blocks.place + 0.5 * STEPS * blocks.size)
        occupancy = medium.grid.occupancy
        near = (near_filled(occupancy, middle) | (not cutting.skip_empty)) & met[blocks.ray, v]
        peak = peaks_near(occupancy, middle).astype(np.float64) * met[blocks.ray, v]
        nearby += peak * medium.sigma_t
        anywhere = anywhere | near
        if medium.sigma_t > 0.0:
            some = Blocks(blocks.rays, blocks.ray[near], blocks.place[near], blocks.size[near])
            mean = lines.mean(medium.grid.sample_density, v, some)
            sigma[v, near] = mean * inside[near] * np.float32(medium.sigma_t)
    return sigma, anywhere, nearby


def _parts(tau: np.ndarray, reached: np.ndarray, size: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Into how many parts blocks are cut, int (P,): 1 where their steps are thin enough.

    tau: (P, STEPS), optical thickness of steps. reached: (P,), optical depth in front of the block. size: (P,), of
    steps. peak: (P,), optical thickness of a step as dense as the densest place near.
    """
    depth = np.minimum(reached, 600.0)
    allowed = STEP_THICKNESS * np.exp(depth / STEP_GROWTH)
    allowed_peak = PEAK_THICKNESS * np.exp(depth / PEAK_GROWTH)
    thickest, parts = tau.max(axis=1).astype(np.float64), np.ones(len(tau), int)
    while np.any(more := (parts < MOST_PARTS) & (thickest > parts * allowed)):
        parts[more] *= 2
    # Coarse steps need not be cut where none can be thick.
    filled = (thickest > 0.0) & (peak > 2.0 * size * PEAK_THICKNESS)
    while np.any(more := filled & (parts < MOST_PARTS) & (peak > parts * allowed_peak) & (size > parts * FINEST)):
        parts[more] *= 2
    return parts


def mean_visibility(
    visible_at: Callable[[np.ndarray, float], np.ndarray], blocks: Blocks, filled: np.ndarray
) -> np.ndarray:
    """Visibility float32 (S,) of a light in filled steps, bool (P, STEPS).

    That in the middle of each, and the mean over a step where the one before or behind it, filled too, has another in
    its middle. visible_at: visibility (N,) in filled steps, by their number among them, int (N,), at a part of their
    length.
    """
    steps, ray = np.flatnonzero(filled), np.repeat(blocks.ray, STEPS)[filled.ravel()]
    found = np.asarray(visible_at(np.arange(len(steps)), 0.5), np.float32)
    changes = (np.diff(steps) == 1) & (np.diff(ray) == 0) & (np.diff(found) != 0.0)
    some = np.flatnonzero(np.append(changes, False) | np.append(False, changes))
    parts = (np.arange(VISIBLE_PARTS) + 0.5) / VISIBLE_PARTS
    found[some] = np.mean([visible_at(some, part) for part in parts], axis=0)
    return found
