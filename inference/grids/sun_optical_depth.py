"""Optical depth from any point of a grid towards one sun.

Each slice keeps the columns of the sweep where they pass it, along the sun's own rays. Columns read the density by
cubic interpolation. A point's ray then meets a slice between four columns, and one linear interpolation is all that
blurs a shadow's edge. Where voxels are optically thick that is too much, and the first slices are integrated instead.
"""

import numpy as np

from ..numerics.interpolation import between
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.sparse_grid import SparseGrid
from .dense_columns import DenseColumns
from .sparse_columns import SparseColumns

# Optical depth from slice to slice above which slices are integrated; how many, for each unit of it, and at most.
THIN_SLICE = 0.35
SLICES_PER_DEPTH, SLICES_MOST = 4.0, 4
# Optical depth from slice to slice above which everything is integrated, and that exactly; below, what seems lit and seen:
# optical depths towards the sun and the camera together up to this.
STEEP_SLICE, UNLIT = 4.0, 6.0
# Optical depth beyond which a way is not followed.
DARK = 30.0
# Gauss's two places in an interval: exact for the cubic that the density is between planes of voxel centres.
GAUSS = (np.float32(0.5 - 0.5 / np.sqrt(3.0)), np.float32(0.5 + 0.5 / np.sqrt(3.0)))


class SunOpticalDepth:
    """Of one DenseGrid or SparseGrid towards one sun, for an extinction of 1 per unit density and world unit.

    direction: (3,) the sun's direction, d(index)/d(world unit). Raises Cancelled.
    """

    def __init__(self, grid, direction: np.ndarray, cancel: CancelToken = NEVER):
        self.grid, self.direction, self.main = grid, direction, int(np.abs(direction).argmax())
        self.peak = grid.peak
        self.others = [axis for axis in range(3) if axis != self.main]
        self.step = 1 if direction[self.main] > 0.0 else -1
        # From slice to slice: the way in indices, and its length in world units.
        self.move = (direction / abs(direction[self.main])).astype(np.float32)
        self.length = np.float32(1.0 / abs(direction[self.main]))
        sparse = isinstance(grid, SparseGrid)
        self.columns = SparseColumns(grid, direction, cancel) if sparse else DenseColumns(grid.padded, direction, cancel)

    def __call__(self, index: np.ndarray, sigma_t: float, seen_through=np.float32(0.0)) -> np.ndarray:
        """Optical depth float32 (N,) at continuous indices float32 (3, N).

        seen_through: (N,) optical depth between the point and the camera: where it is large the depth need not be as exact.
        """
        sigma_t, thickest = np.float32(sigma_t), self.peak * sigma_t * float(self.length)
        place = index + np.float32(1.0)
        along = place[self.main]
        slice_below = np.floor(along)
        ahead = slice_below + np.float32(1.0) - along if self.step > 0 else along - slice_below
        following = slice_below.astype(np.int32) + (1 if self.step > 0 else 0)
        if thickest < STEEP_SLICE:
            # Linear between the slices before and after.
            after = self._on_slice(place, ahead, following)
            before = self._on_slice(place, ahead - np.float32(1.0), following - self.step)
            depth = between(after, before, ahead)
            depth *= sigma_t
            if thickest < THIN_SLICE:
                return depth
            left = np.flatnonzero((depth > 0.0) & (depth + seen_through < UNLIT))
            if not len(left):
                return depth
            slices = int(np.ceil(min(SLICES_PER_DEPTH * thickest, SLICES_MOST)))
        else:
            # What is dark behind the slices that would be integrated is dark.
            slices = SLICES_MOST
            ahead_of_last, last = ahead + np.float32(slices - 1), following + self.step * (slices - 1)
            depth = self._on_slice(place, ahead_of_last, last, lowest=True) * sigma_t
            left = np.flatnonzero(depth < DARK)
        depth[left] = 0.0
        start, way = place[:, left], ahead[left]
        highest = np.array(self.grid.shape, np.float32)[:, None] + 1
        for _ in range(slices):
            depth[left] += self._through(start, way, thickest > STEEP_SLICE) * sigma_t
            start = start + way * self.move[:, None]
            # What begins on a face that the sun's rays enter by is not past the grid.
            past = np.where(self.move[:, None] > 0.0, start >= highest, start <= 0.0).any(axis=0)
            follow = ~past & (depth[left] < DARK)
            left, start = left[follow], start[:, follow]
            way = np.ones(len(left), np.float32)
        number = following[left] + self.step * (slices - 1)
        depth[left] += self._on_slice(start, np.float32(0.0), number) * sigma_t
        return depth

    def _through(self, start, way, steep: bool):
        """Integral of the density (N,) along the sun's rays from places (3, N) to the next slice, `way` slices on.

        steep: whether to cut the way at planes of voxel centres, between which the density is smooth.
        """
        cuts = [np.zeros_like(way), way]
        for axis in self.others if steep else ():
            slope = self.move[axis]
            if slope != 0.0:
                at = start[axis]
                plane = np.floor(at) + np.float32(1.0) if slope > 0.0 else np.ceil(at) - np.float32(1.0)
                cuts.append(np.minimum((plane - at) / slope, way))
        cuts = np.sort(cuts, axis=0)
        total = np.zeros_like(way)
        for first, last in zip(cuts[:-1], cuts[1:]):
            part = last - first
            for share in GAUSS:
                place = start + (first + share * part) * self.move[:, None]
                total += self.grid.sample(place - np.float32(1.0)) * part
        return total * (np.float32(0.5) * self.length)

    def _on_slice(self, place, ahead, number, lowest=False):
        """Depth (N,) where rays from places (3, N) meet slices number (N,), `ahead` slices on.

        lowest: that of the least deep of the four columns around, not what lies between them.
        """
        number = self.columns.slices(number)
        cells, parts = [], []
        for column, (axis, size) in enumerate(zip(self.others, self.columns.size)):
            at = ahead * self.move[axis] + place[axis]
            at += self.columns.offsets[:, column].take(number)
            np.clip(at, np.float32(0.0), np.float32(size - 1), out=at)
            cell = np.minimum(at.astype(np.int32), size - 2)
            parts.append(np.subtract(at, cell, out=at))
            cells.append(cell)
        corners, (u, v) = self.columns.corners(number, *cells), parts
        if lowest:
            return np.min(corners, axis=0)
        return between(between(corners[0], corners[1], v), between(corners[2], corners[3], v), u)
