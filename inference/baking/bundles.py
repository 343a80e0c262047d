# SPDX-License-Identifier: GPL-3.0-or-later
"""Light at the points of a coarse grid towards one direction, from a picture of the volume along that direction.

A bundle of rays is marched through the volume. It tells what is known of the light at its depth samples before that is
predicted (`Estimator.guides`). The light is predicted at some samples. There a sum of the guides is fitted to it, and
the ratio of the light to this sum varies little from point to point. It is interpolated, and the guides tell the rest:
a ratio estimator, whose control variate is the sum of the guides.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..marching.ray_steps import RayBatch
from ..numerics.quadrature import PLASTIC
from ..numerics.small_matmul import product
from .directional_factor import BakedView
from .lattice import BakeLattice

# A viewer nearer to the volume's middle than this share of the width that a bundle covers sees it under a wide angle,
# and its bundle covers no more.
NEAREST = 0.25
# Light that guides do not tell, as a share of the mean.
AMBIENT = 0.02
# Steps of the fit of guides.
FIT_STEPS = 60
# Directions in which light is known already that guide predictions along the next.
NEAR = 3
# Samples of a point's neighbourhood that count as much as those of one that is twice as wide.
DENSE, SPARSE = 0.1, 0.2


@dataclass(frozen=True)
class Bundle:
    """Rays that show a volume: parallel ones along a unit direction (3,), or from a position (3,)."""

    direction: np.ndarray | None = None
    position: np.ndarray | None = None

    def directions(self, positions: np.ndarray) -> np.ndarray:
        """Unit directions (N, 3) in which it shows world positions (N, 3)."""
        found = BakedView(self.position, self.direction).directions(positions)
        assert found is not None
        return found

    def rays(self, lattice: BakeLattice, spacing: float) -> RayBatch:
        """Rays through the lattice's box, so far apart on a plane through its middle."""
        shape = np.array(lattice.density.shape)
        corners = lattice.positions(np.array(list(np.ndindex(2, 2, 2))) * (shape - 1))
        middle = corners.mean(axis=0)
        reach = float(np.linalg.norm(corners - middle, axis=1).max())
        axis = self.direction
        if axis is None:
            axis = middle - self.position
            axis = axis / max(np.linalg.norm(axis), 1e-30) if np.any(axis) else np.array([0.0, 0.0, -1.0])
        across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        across /= np.linalg.norm(across)
        plane = np.stack([across, np.cross(axis, across)])
        seen = corners - middle
        if self.position is not None:
            # The corners, as they are seen on the plane.
            away = max(float((middle - self.position) @ axis), NEAREST * reach)
            start = middle - away * axis
            depth = np.maximum((corners - start) @ axis, NEAREST * away)
            seen = (corners - start) * (away / depth)[:, None]
        seen = seen @ plane.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        counts = np.maximum(np.ceil((high - low) / spacing), 1).astype(int)
        steps = [low[a] + (high[a] - low[a]) * (np.arange(counts[a]) + 0.5) / counts[a] for a in range(2)]
        places = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2) @ plane + middle
        far = np.full(len(places), np.inf)
        if self.position is None:
            return RayBatch(places - 2.0 * reach * axis, np.tile(axis, (len(places), 1)), np.zeros(len(places)), far)
        directions = places - self.position
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        directions = np.where(length > 0.0, directions / np.maximum(length, 1e-30), axis)
        return RayBatch(np.tile(self.position, (len(places), 1)), directions, np.zeros(len(places)), far)


@dataclass(frozen=True)
class BundlePoints:
    """N points of a volume that a bundle shows.

    positions: (N, 3) in the world. weight: (N,), in the picture. guides: (N, C), as of Estimator. predict: light (M, 3)
    at some of them, by number. It may raise Cancelled.
    """

    positions: np.ndarray
    weight: np.ndarray
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
class Effort:
    """What a picture takes: distance of its rays, over that of the grid's points, and the number of predictions."""

    spacing: float
    predictions: int


@dataclass(frozen=True)
class Pictures:
    """Pictures of one volume.

    seen: points that rays show. predict: light (N, 3) at world positions (N, 3) along unit directions (N, 3). Both may
    raise Cancelled. every: whether light is predicted at every point, without pictures. known: along other directions.
    """

    lattice: BakeLattice
    seen: Callable[[RayBatch], list[BundlePoints]]
    predict: Callable[[np.ndarray, np.ndarray], np.ndarray]
    every: bool
    known: list[KnownLight]

    @property
    def middle(self) -> np.ndarray:
        """(3,) in the world, of the lattice's box."""
        return self.lattice.positions(0.5 * (np.array(self.lattice.density.shape) - 1.0)[None])[0]

    def light(self, grid: PointGrid, places: np.ndarray, bundle: Bundle, effort: Effort) -> np.ndarray:
        """Light (N, 3) at points int (N, 3) of a grid along a bundle, which guides further pictures."""
        if self.every:
            positions = grid.positions(places)
            return self.predict(positions, bundle.directions(positions))
        [along] = bundle.directions(self.middle[None])
        near = sorted(self.known, key=lambda known: -float(known.direction @ along))[:NEAR]
        light = np.zeros((3, *grid.shape), np.float32)
        for seen in self.seen(bundle.rays(self.lattice, effort.spacing * grid.spacing)):
            light += light_at_points(grid, seen, near, effort.predictions)
        self.known.append(KnownLight(along, grid, light.mean(axis=0)))
        return light[(slice(None), *places.T)].T


def light_at_points(grid: PointGrid, seen: BundlePoints, known: Sequence[KnownLight], most: int) -> np.ndarray:
    """Light float32 (3, nx, ny, nz) at the points of a grid, predicted at about so many points of a bundle.

    known: along other directions.
    """
    if not len(seen.positions):
        return np.zeros((3, *grid.shape), np.float32)
    guides = np.column_stack([seen.guides, *(one.at(seen.positions) for one in known), np.ones(len(seen.weight))])
    guides /= np.maximum(guides.mean(axis=0), 1e-30)
    chosen = _chosen(seen.positions, seen.weight * np.maximum(guides.mean(axis=1), AMBIENT), most)
    light = seen.predict(chosen)
    grey = light.mean(axis=1)
    told = product(guides, _fitted(guides[chosen], grey)) + AMBIENT * max(float(grey.mean()), 1e-30)
    places = grid.places(seen.positions)
    [dense] = grid.averaged(places, [told], DENSE)
    # Greys are averaged once.
    colours = [light[:, 0]] if np.ptp(light, axis=1).max() == 0.0 else list(light.T)
    *averages, base = grid.averaged(places[chosen], [*colours, told[chosen]], SPARSE)
    found = [average * (dense / np.maximum(base, np.float32(1e-30))) for average in averages]
    return np.stack(found if len(found) == 3 else found * 3)


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
