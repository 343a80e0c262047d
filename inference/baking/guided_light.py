# SPDX-License-Identifier: GPL-3.0-or-later
"""Light at the points of a coarse grid along one direction, of which the network predicts a few.

Guides tell roughly what the light is at every point before it is predicted: what arrives unscattered, what arrives from
ahead (`light_ahead`), and the light along other directions. The light is predicted at some of the points, and a sum of
the guides is fitted to it. The ratio of the light to this sum varies little from point to point. It is interpolated
(`kriging`), and the guides tell the rest: a ratio estimator, whose control variate is the sum of the guides.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..numerics.quadrature import PLASTIC
from ..numerics.small_matmul import inverse, product
from .directional_factor import BakedView
from .kriging import krige
from .lattice import BakeLattice, block_means
from .light_ahead import light_ahead

# Light that guides do not tell, as a share of the mean.
AMBIENT = 0.02
# Powers of the light that arrives unscattered, which falls faster than that which has scattered.
DIFFUSE = (0.33, 0.1)
# Share with which means of a wider neighbourhood count beside a narrower one that holds values.
HARDLY = np.float32(1e-6)
# Steps of the fit of guides.
FIT_STEPS = 60
# Directions in which light is known already that guide predictions along the next.
NEAR = 3
# Least ratio of light to what guides tell, over its mean.
LEAST_RATIO = 0.05


@dataclass(frozen=True)
class LightPart:
    """Some of the lights of one volume, which are predicted at the same points.

    predict: light float32 (N, 3) at world positions (N, 3) along unit directions (N, 3). unscattered: light (N,) that
    arrives at positions without scattering, about. share: of predictions that it needs. Both may raise Cancelled.
    """

    predict: Callable[[np.ndarray, np.ndarray], np.ndarray]
    unscattered: Callable[[np.ndarray], np.ndarray]
    share: float = 1.0


@dataclass(frozen=True)
class PointGrid:
    """A grid of points, to which values at scattered positions are averaged.

    stride: voxels of the lattice from one to the next. world_from_index: (4, 4).
    """

    shape: tuple[int, ...]
    stride: int
    world_from_index: np.ndarray

    @staticmethod
    def over(lattice: BakeLattice, stride: int) -> "PointGrid":
        """A point in the middle of each block of stride^3 voxels."""
        frame = lattice.world_from_index.copy()
        frame[:3, :3] *= stride
        frame[:3, 3] = lattice.positions(np.full((1, 3), 0.5 * (stride - 1)))[0]
        return PointGrid(tuple(-(-n // stride) for n in lattice.density.shape), stride, frame)

    @property
    def spacing(self) -> float:
        """Distance of neighbours in world units, the longest."""
        return float(np.linalg.norm(self.world_from_index[:3, :3], axis=0).max())

    def positions(self, places: np.ndarray) -> np.ndarray:
        """World positions (N, 3) of points int (N, 3)."""
        return product(places.astype(np.float64), self.world_from_index[:3, :3].T) + self.world_from_index[:3, 3]

    def nearest(self, other: "PointGrid") -> tuple[np.ndarray, ...]:
        """Places in this grid that are nearest to all points of another of the same lattice, for `np.ix_`."""
        ratio = other.stride / self.stride
        return tuple(
            np.clip(((np.arange(count) + 0.5) * ratio).astype(np.int64), 0, size - 1)
            for count, size in zip(other.shape, self.shape)
        )

    def spread(self, places: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values (N, K) of points int (N, 3) on the whole grid, (nx, ny, nz, K): others take means of those near by.

        Neighbourhoods of 2^3 points are doubled until they hold values.
        """
        halves = [-(-n // 2) for n in self.shape]
        x, y, z = places.T // 2
        blocks = (x * halves[1] + y) * halves[2] + z
        size = int(np.prod(halves))
        sums = np.stack([np.bincount(blocks, one, size) for one in (*values.T, np.ones(len(places)))])
        means = _filled(sums.astype(np.float32).reshape(-1, *halves))
        for axis, count in enumerate(self.shape, 1):
            means = _doubled(means, axis, count) if count > 1 else means
        found = np.ascontiguousarray(np.moveaxis(means, 0, -1))
        found[tuple(places.T)] = values
        return found


def _filled(sums: np.ndarray) -> np.ndarray:
    """Means (K, nx, ny, nz) of sums (K + 1, nx, ny, nz), of which the last counts the samples."""
    shape = sums.shape[1:]
    if max(shape) == 1:
        return sums[:-1] / np.maximum(sums[-1:], np.float32(1e-30))
    coarse = np.pad(sums, [(0, 0), *((0, n % 2 if n > 1 else 0) for n in shape)])
    for axis in (1, 2, 3):
        if coarse.shape[axis] > 1:
            even, odd = (coarse[(slice(None),) * axis + (slice(start, None, 2),)] for start in (0, 1))
            coarse = even + odd
    wide = _filled(coarse)
    for axis, size in enumerate(shape, 1):
        wide = _doubled(wide, axis, size) if size > 1 else wide
    wide *= HARDLY
    wide += sums[:-1]
    wide /= sums[-1:] + HARDLY
    return wide


def _doubled(values: np.ndarray, axis: int, size: int) -> np.ndarray:
    """Values between the middles of blocks of two, along an axis, of `size` points."""
    found = np.empty([2 * n if a == axis else n for a, n in enumerate(values.shape)], np.float32)
    pairs, near = np.moveaxis(found, axis, 0), np.moveaxis(np.float32(0.75) * values, axis, 0)
    far = np.moveaxis(np.float32(0.25) * values, axis, 0)
    pairs[0], pairs[-1] = near[0] + far[0], near[-1] + far[-1]
    np.add(near[1:], far[:-1], out=pairs[2::2])
    np.add(near[:-1], far[1:], out=pairs[1:-1:2])
    return found[(slice(None),) * axis + (slice(size),)]


@dataclass(frozen=True)
class KnownLight:
    """Light (nx, ny, nz) at the points of a grid, mean over the colours, about along a unit direction (3,)."""

    direction: np.ndarray
    grid: PointGrid
    light: np.ndarray

    def on(self, grid: PointGrid) -> "KnownLight":
        """The same at the points of another grid."""
        if self.grid is grid:
            return self
        return KnownLight(self.direction, grid, self.light[np.ix_(*self.grid.nearest(grid))].astype(np.float32))


@dataclass(frozen=True)
class GuidedLight:
    """Light of one volume at points of grids.

    extinction: of the lattice's voxels, float32 (nx, ny, nz) per world unit. every: whether light is predicted at every
    point. known: along other directions.
    """

    lattice: BakeLattice
    extinction: np.ndarray
    parts: Sequence[LightPart]
    every: bool
    known: list[KnownLight] = field(default_factory=list)

    @property
    def middle(self) -> np.ndarray:
        """(3,) in the world, of the volume."""
        middle: np.ndarray = self.lattice.positions(0.5 * (np.array(self.lattice.density.shape) - 1.0)[None])[0]
        return middle

    def at(self, stride: int, places: np.ndarray) -> "LightAtPoints":
        """Light at points int (N, 3) in blocks of stride^3 voxels. Raises Cancelled."""
        return LightAtPoints(self, stride, places)


class LightAtPoints:
    """Light of one volume at some points of a grid, along one direction after the other."""

    def __init__(self, light: GuidedLight, stride: int, places: np.ndarray) -> None:
        """The arguments are those of `GuidedLight.at`."""
        self.grid, self._light, self._at = PointGrid.over(light.lattice, stride), light, tuple(places.T)
        self._places, self._positions = np.ravel_multi_index(self._at, self.grid.shape), self.grid.positions(places)
        self._extinction = block_means(light.extinction, stride)
        self._middle = light.middle
        filled = np.argwhere(self._extinction > 0.0)
        positions = self.grid.positions(filled)
        arriving = [] if light.every else [part.unscattered(positions) for part in light.parts]
        self._unscattered = [
            self.grid.spread(filled, one[:, None])[..., 0] / np.float32(max(float(one.mean()), 1e-30))
            for one in arriving
        ]
        # Guides that are the same along all directions.
        self._steady = [[one, *(one**power for power in DIFFUSE)] for one in self._unscattered]
        self._order = np.argsort(_morton(self._positions))

    def __call__(self, view: BakedView, importance: np.ndarray, most: int) -> np.ndarray:
        """Light float32 (N, 3) at the points along the rays of a view, which guides further predictions.

        importance: (N,), at least 0; at points without any, light is not predicted. most: how many are, about.
        Raises Cancelled.
        """
        if not importance.any():
            return np.zeros((len(importance), 3), np.float32)
        along = view.directions(self._middle[None])
        assert along is not None
        if self._light.every:
            return self._predicted_everywhere(view, importance)
        known = self._light.known
        known[:] = sorted(known, key=lambda one: -float(one.direction @ along[0]))
        known[:NEAR] = [one.on(self.grid) for one in known[:NEAR]]
        near = [one.light / np.float32(max(float(one.light.mean()), 1e-30)) for one in known[:NEAR]]
        scattered = [sum(near) / np.float32(len(near))] if near else []
        sources = np.stack([*self._unscattered, *scattered])
        index_direction = inverse(self.grid.world_from_index[:3, :3]) @ along[0]
        ahead, through = light_ahead(self._extinction, sources, index_direction)
        shared = [through, *near, np.ones_like(through)]
        if near:
            shared += list(ahead[-1])
        found, grey = np.zeros((len(importance), 3), np.float32), np.zeros(self.grid.shape, np.float32)
        for part, steady, arriving in zip(self._light.parts, self._steady, ahead):
            guides = [one.reshape(-1) for one in (*steady, *arriving, *shared)]
            light, mean = self._ratio_estimate(part, guides, view, importance, most)
            found += light
            grey += mean
        known.append(KnownLight(along[0], self.grid, grey))
        return found

    def _predicted_everywhere(self, view: BakedView, importance: np.ndarray) -> np.ndarray:
        some = np.flatnonzero(importance)
        light = np.sum([self._predicted(part, view, some) for part in self._light.parts], axis=0)
        found: np.ndarray = self.grid.spread(np.argwhere(self._mask(some)), light[np.argsort(self._places[some])])
        return found[self._at]

    def _predicted(self, part: LightPart, view: BakedView, some: np.ndarray) -> np.ndarray:
        """Light of one part (M, 3) at some of the points, int (M,)."""
        directions = view.directions(self._positions[some])
        assert directions is not None
        return part.predict(self._positions[some], directions)

    def _mask(self, some: np.ndarray) -> np.ndarray:
        mask = np.zeros(self.grid.shape, bool)
        mask.reshape(-1)[self._places[some]] = True
        return mask

    def _ratio_estimate(
        self, part: LightPart, guides: list[np.ndarray], view: BakedView, importance: np.ndarray, most: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Light float32 (N, 3), and mean over the colours (nx, ny, nz) on the whole grid.

        guides: float32 (cells,) each. Others: see the call.
        """
        told = guides[0].copy()
        for one in guides[1:]:
            told += one
        guide = told[self._places]
        chosen = _chosen(self._order, importance * np.maximum(guide, AMBIENT * guide.mean()), part.share * most)
        light = self._predicted(part, view, chosen)
        grey, places = grey_of(light), self._places[chosen]
        factors = _fitted(np.stack([one[places] for one in guides], axis=1).astype(np.float64), grey)
        told[:] = AMBIENT * max(float(grey.mean()), 1e-30)
        for factor, one in zip(factors.astype(np.float32), guides):
            if factor > 0.0:
                told += factor * one
        # Greys are estimated once.
        same = np.array_equal(light[:, 0], light[:, 1]) and np.array_equal(grey, light[:, 2])
        columns = grey[:, None] if same else np.column_stack([grey, light])
        mean = columns.sum(axis=0) / told[places].sum()
        # Where nobody looks, the fit is near enough.
        unknown = importance > 0.0
        unknown[chosen] = False
        cells = self._places[unknown]
        ratios = krige(self.grid.shape, places, columns / told[places, None], mean, cells)
        estimates = np.maximum(ratios, LEAST_RATIO * mean) * told[cells, None]
        found = np.empty((len(importance), 3), np.float32)
        found[:] = told[self._places, None] * mean[-3:]
        found[unknown], found[chosen] = estimates[:, -3:], light
        told *= mean[0]
        told[cells], told[places] = estimates[:, 0], grey
        return found, told.reshape(self.grid.shape)


def grey_of(light: np.ndarray) -> np.ndarray:
    """Mean (...) over the colours of light (..., 3); numpy is slow to reduce an axis of length 3."""
    mean: np.ndarray = (light[..., 0] + light[..., 1] + light[..., 2]) / np.float32(3.0)
    return mean


def _chosen(order: np.ndarray, importance: np.ndarray, most: float) -> np.ndarray:
    """Numbers of about so many points, by importance (N,), spread evenly in space.

    order: (N,), of points along a space-filling curve (Morton). Every so much of the importance on it one is chosen.
    """
    share = importance[order] / max(float(importance.sum()), 1e-30)
    total = np.cumsum(np.minimum(share * most, 1.0)) + PLASTIC[0]
    chosen = order[np.flatnonzero(np.diff(np.floor(total), prepend=0.0))]
    return chosen if len(chosen) else order[importance[order].argmax()][None]


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
