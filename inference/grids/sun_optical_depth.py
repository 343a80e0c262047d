# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depth from any point of a grid towards one sun.

Each slice stores the columns of the sweep where they pass it, along the sun's own rays; the sweep reads the density by
cubic interpolation. The ray from a point meets a slice between four columns, and one linear interpolation is all that
blurs the edge of a shadow. Where voxels are optically thick even that is too much, and the first slices are integrated
instead.
"""

from dataclasses import dataclass

import numpy as np

from ..kernels.library import Kernels
from ..numerics.interpolation import lerp_into
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.sparse_grid import SparseGrid
from .dense_columns import DenseColumns
from .dense_grid import DenseGrid
from .sparse_columns import SparseColumns

# Optical thickness of a slice above which slices are integrated; number of slices per unit of it, and at most.
THIN_SLICE = 0.35
SLICES_PER_DEPTH, MAX_SLICES = 4.0, 4
# Optical thickness of a slice above which every point is integrated, split at voxel planes; below, only points whose
# optical depths to sun and camera sum to at most VISIBLE.
STEEP_SLICE, VISIBLE = 4.0, 6.0
# Optical depth beyond which rays are not followed.
MAX_DEPTH = 30.0
# The two Gauss-Legendre nodes in [0, 1]: exact for the cubic that the density is between planes of voxel centres.
GAUSS_NODES = (np.float32(0.5 - 0.5 / np.sqrt(3.0)), np.float32(0.5 + 0.5 / np.sqrt(3.0)))

ZERO = np.float32(0.0)


@dataclass(frozen=True)
class Integration:
    """How the optical depth is found where voxels have some optical thickness.

    slices: that are integrated, 0 for none. everywhere: whether at every point, or only where the sun and the camera
    are visible. steep: whether integrals are split at planes of voxel centres.
    """

    slices: int
    everywhere: bool
    steep: bool


class SunOpticalDepth:
    """Optical depth through one grid towards one sun, for an extinction of 1 per unit density and world unit.

    grid: DenseGrid or SparseGrid. direction: (3,) towards the sun, d(index)/d(world unit). kernels: compiled ones, or
    None. Raises Cancelled.
    """

    def __init__(
        self,
        grid: DenseGrid | SparseGrid,
        direction: np.ndarray,
        cancel: CancelToken = NEVER,
        kernels: Kernels | None = None,
    ):
        self.grid, self.direction, self.main = grid, direction, int(np.abs(direction).argmax())
        self.peak = grid.peak
        self.others = [axis for axis in range(3) if axis != self.main]
        self.step = 1 if direction[self.main] > 0.0 else -1
        # From one slice to the next: the displacement in indices, and its length in world units.
        self.move = (direction / abs(direction[self.main])).astype(np.float32)
        self.length = np.float32(1.0 / abs(direction[self.main]))
        self.columns: SparseColumns | DenseColumns
        if isinstance(grid, SparseGrid):
            self.columns = SparseColumns(grid, direction, cancel, kernels)
        else:
            self.columns = DenseColumns(grid.padded, direction, cancel, kernels)

    def integration(self, sigma_t: float) -> Integration:
        """How the optical depth is found for an extinction per unit density and world unit."""
        thickest = self.peak * sigma_t * float(self.length)
        if thickest < THIN_SLICE:
            return Integration(0, everywhere=False, steep=False)
        slices = int(np.ceil(min(SLICES_PER_DEPTH * thickest, MAX_SLICES)))
        return Integration(slices, everywhere=thickest >= STEEP_SLICE, steep=thickest > STEEP_SLICE)

    def __call__(self, index: np.ndarray, sigma_t: float, camera_depth: np.ndarray | np.float32 = ZERO) -> np.ndarray:
        """Optical depth float32 (N,) at continuous indices float32 (3, N).

        camera_depth: (N,) optical depth between the point and the camera; the larger it is, the less accurate the
        result needs to be.
        """
        extinction, integration = np.float32(sigma_t), self.integration(sigma_t)
        slices = integration.slices
        place = index + np.float32(1.0)
        along = place[self.main]
        slice_below = np.floor(along)
        ahead = slice_below + np.float32(1.0) - along if self.step > 0 else along - slice_below
        following = slice_below.astype(np.int32) + (1 if self.step > 0 else 0)
        if not integration.everywhere:
            # Linear between the adjacent slices.
            after = self._on_slice(place, ahead, following)
            before = self._on_slice(place, ahead - np.float32(1.0), following - self.step)
            depth = lerp_into(after, before, ahead)
            depth *= extinction
            if not slices:
                return depth
            left = np.flatnonzero((depth > 0.0) & (depth + camera_depth < VISIBLE))
            if not len(left):
                return depth
        else:
            # Points that are dark beyond the slices to integrate are dark.
            ahead_of_last, last = ahead + np.float32(slices - 1), following + self.step * (slices - 1)
            depth = self._on_slice(place, ahead_of_last, last, lowest=True) * extinction
            left = np.flatnonzero(depth < MAX_DEPTH)
        depth[left] = 0.0
        start, way = place[:, left], ahead[left]
        highest = np.array(self.grid.shape, np.float32)[:, None] + 1
        for _ in range(slices):
            depth[left] += self._through(start, way, integration.steep) * extinction
            start = start + way * self.move[:, None]
            # A ray that starts on a face by which the sun's rays enter has not left the grid.
            past = np.where(self.move[:, None] > 0.0, start >= highest, start <= 0.0).any(axis=0)
            follow = ~past & (depth[left] < MAX_DEPTH)
            left, start = left[follow], start[:, follow]
            way = np.ones(len(left), np.float32)
        number = following[left] + self.step * (slices - 1)
        depth[left] += self._on_slice(start, np.float32(0.0), number) * extinction
        return depth

    def _through(self, start: np.ndarray, way: np.ndarray, steep: bool) -> np.ndarray:
        """Integral of the density (N,) along the sun's rays from positions (3, N) to the next slice, `way` slices on.

        steep: whether to split the integral at planes of voxel centres, between which the density is smooth.
        """
        planes = [np.zeros_like(way), way]
        for axis in self.others if steep else ():
            slope = self.move[axis]
            if slope != 0.0:
                at = start[axis]
                plane = np.floor(at) + np.float32(1.0) if slope > 0.0 else np.ceil(at) - np.float32(1.0)
                planes.append(np.minimum((plane - at) / slope, way))
        cuts = np.sort(planes, axis=0)
        total = np.zeros_like(way)
        for first, last in zip(cuts[:-1], cuts[1:]):
            part = last - first
            for share in GAUSS_NODES:
                place = start + (first + share * part) * self.move[:, None]
                total += self.grid.sample(place - np.float32(1.0)) * part
        return total * (np.float32(0.5) * self.length)

    def _on_slice(
        self, place: np.ndarray, ahead: np.ndarray | np.float32, number: np.ndarray, lowest: bool = False
    ) -> np.ndarray:
        """Depth (N,) where rays from positions (3, N) meet slices number (N,), `ahead` slices on.

        lowest: the smallest depth of the four surrounding columns instead of the interpolated one.
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
        return lerp_into(lerp_into(corners[0], corners[1], v), lerp_into(corners[2], corners[3], v), u)
