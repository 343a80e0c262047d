# SPDX-License-Identifier: GPL-3.0-or-later
"""Light at the points of a coarse grid along one direction, of which the network predicts a few.

From every point a ray is marched. It tells what is known of the light before that is predicted (`Estimator.guides`).
The light is predicted at some of the points, and a sum of the guides is fitted to it. The ratio of the light to this
sum varies little from point to point. It is interpolated, and the guides tell the rest: a ratio estimator, whose
control variate is the sum of the guides.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..numerics.quadrature import PLASTIC
from ..numerics.small_matmul import product
from .directional_factor import BakedView
from .lattice import BakeLattice

# Light that guides do not tell, as a share of the mean.
AMBIENT = 0.02
# Steps of the fit of guides.
FIT_STEPS = 60
# Directions in which light is known already that guide predictions along the next.
NEAR = 3
# Predictions in a point's neighbourhood that count as much as those of one that is twice as wide.
SPARSE = 0.2


@dataclass(frozen=True)
class MarchedPoints:
    """N points of rays. guides: (N, C), as of Estimator. predict: light (M, 3) at some of them, by number.

    `predict` may raise Cancelled.
    """

    guides: np.ndarray
    predict: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class PointGrid:
    """A grid of points, to which values at scattered positions are averaged. world_from_index: (4, 4)."""

    shape: tuple[int, ...]
    world_from_index: np.ndarray

    @staticmethod
    def over(lattice: BakeLattice, stride: int) -> "PointGrid":
        """A point in the middle of each block of stride^3 voxels."""
        frame = lattice.world_from_index.copy()
        frame[:3, :3] *= stride
        frame[:3, 3] = lattice.positions(np.full((1, 3), 0.5 * (stride - 1)))[0]
        return PointGrid(tuple(-(-n // stride) for n in lattice.density.shape), frame)

    @property
    def spacing(self) -> float:
        """Distance of neighbours in world units, the longest."""
        return float(np.linalg.norm(self.world_from_index[:3, :3], axis=0).max())

    def positions(self, places: np.ndarray) -> np.ndarray:
        """World positions (N, 3) of points int (N, 3)."""
        return places @ self.world_from_index[:3, :3].T + self.world_from_index[:3, 3]

    def places(self, positions: np.ndarray) -> np.ndarray:
        """The nearest point, by number (N,), of positions (N, 3)."""
        inverse = np.linalg.inv(self.world_from_index)
        index = np.rint(product(positions, inverse[:3, :3].T) + inverse[:3, 3]).astype(np.int64)
        x, y, z = np.clip(index, 0, np.array(self.shape) - 1).T
        return (x * self.shape[1] + y) * self.shape[2] + z

    def averaged(self, places: np.ndarray, values: Sequence[np.ndarray], most: float) -> np.ndarray:
        """Means (K, nx, ny, nz) at all points of values, K of (N,), at places.

        Neighbourhoods are doubled until they hold values; those with few are blended with wider ones, which count as
        much as so many samples.
        """
        size = int(np.prod(self.shape))
        sums = [np.bincount(places, one, size) for one in (*values, np.ones(len(places)))]
        return _blended(np.stack(sums).astype(np.float32).reshape(-1, *self.shape), np.float32(most))

    def spread(self, places: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values (N, K) of points int (N, 3) on the whole grid, (nx, ny, nz, K): others take means of those near by."""
        at = np.ravel_multi_index(tuple(places.T), self.shape)
        found = np.ascontiguousarray(np.moveaxis(self.averaged(at, list(values.T), 1e-6), 0, -1))
        found[tuple(places.T)] = values
        return found


def _blended(sums: np.ndarray, most: np.float32) -> np.ndarray:
    """Means (K, nx, ny, nz) of sums (K + 1, nx, ny, nz), of which the last counts the samples."""
    shape = sums.shape[1:]
    if max(shape) == 1:
        return sums[:-1] / np.maximum(sums[-1:], np.float32(1e-30))
    coarse = np.pad(sums, [(0, 0), *((0, n % 2 if n > 1 else 0) for n in shape)])
    for axis in (1, 2, 3):
        if coarse.shape[axis] > 1:
            even, odd = (coarse[(slice(None),) * axis + (slice(start, None, 2),)] for start in (0, 1))
            coarse = even + odd
    wide = _blended(coarse, most)
    for axis in (1, 2, 3):
        if shape[axis - 1] > 1:
            wide = _doubled(wide, axis, shape[axis - 1])
    wide *= most
    wide += sums[:-1]
    wide /= sums[-1:] + most
    return wide


def _doubled(values: np.ndarray, axis: int, size: int) -> np.ndarray:
    """Values between the middles of blocks of two, along an axis, of `size` points."""
    before = np.concatenate([values.take([0], axis), values.take(range(values.shape[axis] - 1), axis)], axis)
    after = np.concatenate([values.take(range(1, values.shape[axis]), axis), values.take([-1], axis)], axis)
    near = np.float32(0.75) * values
    pairs = np.stack([near + np.float32(0.25) * before, near + np.float32(0.25) * after], axis + 1)
    shape = [*values.shape[:axis], 2 * values.shape[axis], *values.shape[axis + 1 :]]
    return pairs.reshape(shape).take(range(size), axis)


@dataclass(frozen=True)
class KnownLight:
    """Light (nx, ny, nz) at the points of a grid, mean over the colours, about along a unit direction (3,)."""

    direction: np.ndarray
    grid: PointGrid
    light: np.ndarray

    def at(self, positions: np.ndarray) -> np.ndarray:
        """(N,) at the points next to world positions (N, 3)."""
        return self.light.reshape(-1)[self.grid.places(positions)]


@dataclass(frozen=True)
class GuidedLight:
    """Light of one volume at points of grids.

    middle: (3,) in the world, of the volume. march: from world positions (N, 3) along unit directions (N, 3); the light
    is that of all it returns. It may raise Cancelled. every: whether light is predicted at every point. known: along
    other directions.
    """

    middle: np.ndarray
    march: Callable[[np.ndarray, np.ndarray], list[MarchedPoints]]
    every: bool
    known: list[KnownLight]

    def __call__(
        self, grid: PointGrid, places: np.ndarray, view: BakedView, importance: np.ndarray, most: int
    ) -> np.ndarray:
        """Light (N, 3) at points int (N, 3) of a grid along the rays of a view, which guides further predictions.

        importance: (N,), at least 0; those without any take the light of others. most: how many are predicted, about.
        """
        some = np.flatnonzero(importance > 0.0)
        if not len(some):
            return np.zeros((len(places), 3), np.float32)
        positions = grid.positions(places[some])
        directions, along = view.directions(positions), view.directions(self.middle[None])
        assert directions is not None and along is not None
        near = sorted(self.known, key=lambda known: -float(known.direction @ along[0]))[:NEAR]
        light = np.zeros((len(some), 3), np.float32)
        for marched in self.march(positions, directions):
            if self.every:
                light += marched.predict(np.arange(len(some)))
            else:
                light += light_at_points(grid, positions, marched, importance[some], near, most)
        values = grid.spread(places[some], light)
        self.known.append(KnownLight(along[0], grid, values.mean(axis=3)))
        return values[tuple(places.T)]


def light_at_points(
    grid: PointGrid,
    positions: np.ndarray,
    marched: MarchedPoints,
    importance: np.ndarray,
    known: Sequence[KnownLight],
    most: int,
) -> np.ndarray:
    """Light float32 (N, 3) at positions (N, 3) of points of a grid, predicted at about so many of them.

    importance: (N,). known: along other directions.
    """
    guides = np.column_stack([marched.guides, *(one.at(positions) for one in known), np.ones(len(positions))])
    guides /= np.maximum(guides.mean(axis=0), 1e-30)
    chosen = _chosen(positions, importance * np.maximum(guides.mean(axis=1), AMBIENT), most)
    light = marched.predict(chosen)
    grey = light.mean(axis=1)
    told = product(guides, _fitted(guides[chosen], grey)) + AMBIENT * max(float(grey.mean()), 1e-30)
    places = grid.places(positions)
    # Greys are averaged once.
    colours = [light[:, 0]] if np.ptp(light, axis=1).max() == 0.0 else list(light.T)
    *averages, base = grid.averaged(places[chosen], [*colours, told[chosen]], SPARSE)
    ratios = [(average / np.maximum(base, np.float32(1e-30))).reshape(-1)[places] for average in averages]
    found = np.stack([ratio * told for ratio in ratios] * (3 // len(ratios)), axis=1).astype(np.float32)
    # What is predicted is known.
    found[chosen] = light
    return found


def _chosen(positions: np.ndarray, importance: np.ndarray, most: float) -> np.ndarray:
    """Numbers of about so many points at positions (N, 3), by importance (N,), spread evenly in space.

    Every so much of the importance along a space-filling curve (Morton) one is chosen.
    """
    order = np.argsort(_morton(positions))
    share = importance[order] / max(float(importance.sum()), 1e-30)
    total = np.cumsum(np.minimum(share * most, 1.0)) + PLASTIC[0]
    chosen = order[np.flatnonzero(np.diff(np.floor(total), prepend=0.0))]
    return chosen if len(chosen) else order[:1]


def _morton(positions: np.ndarray) -> np.ndarray:
    """Numbers (N,) of positions (N, 3) along a curve through 1024^3 cells, of which neighbours are near each other."""
    low = positions.min(axis=0)
    cells = ((positions - low) * (1023.0 / max(float((positions - low).max()), 1e-30))).astype(np.int64)
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        cells = (cells | (cells << shift)) & mask
    return cells @ np.array([1, 2, 4])


def _fitted(guides: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Factors (C,), at least 0, with which guides (N, C) add up to light (N,), by relative errors.

    Multiplicative updates (Lee and Seung 2001) keep factors positive.
    """
    weight = 1.0 / np.maximum(light + 0.2 * light.mean(), 1e-30)
    matrix, target = guides * weight[:, None], light * weight
    squares, right = np.einsum("nc,nd->cd", matrix, matrix), np.einsum("nc,n->c", matrix, target)
    factors = np.full(guides.shape[1], max(float(light.mean()), 1e-30) / guides.shape[1])
    for _ in range(FIT_STEPS):
        factors *= right / np.maximum(squares @ factors, 1e-30)
    return factors
