# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depths from points out of the working cube, towards the directions in which it is known what is open.

Near a point the density of the finest levels of the pyramid counts, since in dense media nearly all light that reaches
a point comes through a few mean free paths, fewer than there are in a cell of the coarse transport. Beyond them the
depths of those cells are interpolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..grids.optical_depth_sweep import sun_optical_depth
from ..kernels.field_structures import OpenDepthSamples
from ..kernels.library import Kernels
from ..plan.resolution import LEVEL0_CELLS
from ..runtime.cancellation import NEVER, CancelToken
from .environment_light import DIRECTIONS

# The steps from a point outwards, in cells of level 0, and the level that gives the density of each.
ENDS = np.array([0.0, 1.0, 3.0, 6.0, 10.0, 15.0]) / LEVEL0_CELLS
LEVELS = (0, 0, 1, 1, 1)
MIDDLES, LENGTHS = (0.5 * (ENDS[1:] + ENDS[:-1])).astype(np.float32), np.diff(ENDS).astype(np.float32)
REACH = np.float32(ENDS[-1])


def direction_depths(coarse: np.ndarray, cancel: CancelToken = NEVER, kernels: Kernels | None = None) -> np.ndarray:
    """Optical depth float32 (50, n + 2, n + 2, n + 2) from each cell out towards DIRECTIONS, for sigma_hat = 1.

    coarse: a level of the density pyramid, float32 (n, n, n). The outermost cells are repeated once.
    kernels: compiled ones, or None. Raises Cancelled.
    """
    n = len(coarse)
    depths = np.empty((len(DIRECTIONS), n + 2, n + 2, n + 2), np.float32)
    for found, towards in zip(depths, DIRECTIONS):
        cancel.check()
        found[...] = np.pad(sun_optical_depth(coarse, towards, 1.0 / n, kernels), 1, mode="edge")
    return depths


@dataclass(frozen=True)
class OpenDepths:
    """Optical depths from points, for sigma_hat = 1.

    levels: the two finest levels of the density pyramid, float32 (n, n, n), rows of which are contiguous. lattice: of
    `direction_depths`. kernels: compiled ones, or None.
    """

    levels: Sequence[np.ndarray]
    lattice: np.ndarray
    kernels: Kernels | None = None

    def __call__(self, positions: np.ndarray) -> np.ndarray:
        """Depths float32 (N, 50) towards DIRECTIONS, from positions (N, 3) in the cube's frame."""
        at = np.ascontiguousarray(positions, np.float32)
        if self.kernels is None:
            return np.stack([self._towards(at, k) for k in range(len(DIRECTIONS))], axis=1)
        found = np.empty((len(at), len(DIRECTIONS)), np.float32)
        data = OpenDepthSamples(
            points=len(at),
            positions=at,
            directions=len(DIRECTIONS),
            towards=DIRECTIONS.astype(np.float32),
            samples=len(LEVELS),
            middles=MIDDLES,
            lengths=LENGTHS,
            sampled=np.array(LEVELS, np.int64),
            cells=np.array([len(level) for level in self.levels], np.int64),
            strides=np.array([[stride // level.itemsize for stride in level.strides[:2]] for level in self.levels]),
            reach=REACH,
            lattice=self.lattice,
            edge=self.lattice.shape[1],
            depths=found,
        )
        for k, level in enumerate(self.levels):
            data.levels[k] = level.ctypes.data
        self.kernels.prepare("sample_open_depths", data)
        return found

    def _towards(self, positions: np.ndarray, number: int) -> np.ndarray:
        """Depths (N,) in one direction."""
        towards, depths = DIRECTIONS[number].astype(np.float32), np.zeros(len(positions), np.float32)
        for middle, length, level in zip(MIDDLES, LENGTHS, LEVELS):
            density = self.levels[level]
            cells = np.floor((positions + middle * towards + np.float32(0.5)) * np.float32(len(density))).astype(int)
            inside = ((cells >= 0) & (cells < len(density))).all(axis=1)
            depths[inside] += length * density[tuple(cells[inside].T)]
        ends = positions + REACH * towards
        inside = (np.abs(ends) < 0.5).all(axis=1)
        depths[inside] += _interpolated(self.lattice[number], ends[inside])
        return depths


def _interpolated(values: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Trilinear values (N,) of a lattice (n + 2, n + 2, n + 2) at positions (N, 3) in the cube."""
    index = (positions + np.float32(0.5)) * np.float32(len(values) - 2) + np.float32(0.5)
    cell = index.astype(int)
    i, j, k = cell.T
    x, y, z = (index - cell).T
    rows = [(1 - z) * values[i + a, j + b, k] + z * values[i + a, j + b, k + 1] for a in (0, 1) for b in (0, 1)]
    return (1 - x) * ((1 - y) * rows[0] + y * rows[1]) + x * ((1 - y) * rows[2] + y * rows[3])
