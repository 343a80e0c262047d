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
from ..kernels.library import call
from ..plan.resolution import LEVEL0_CELLS
from ..runtime.cancellation import NEVER, CancelToken
from .environment_light import DIRECTIONS

# The steps from a point outwards, in cells of level 0, and the level that gives the density of each.
ENDS = np.array([0.0, 1.0, 3.0, 6.0, 10.0, 15.0]) / LEVEL0_CELLS
LEVELS = (0, 0, 1, 1, 1)
MIDDLES, LENGTHS = (0.5 * (ENDS[1:] + ENDS[:-1])).astype(np.float32), np.diff(ENDS).astype(np.float32)
REACH = np.float32(ENDS[-1])


def direction_depths(coarse: np.ndarray, cancel: CancelToken = NEVER) -> np.ndarray:
    """Optical depth float32 (50, n + 2, n + 2, n + 2) from each cell out towards DIRECTIONS, for sigma_hat = 1.

    coarse: a level of the density pyramid, float32 (n, n, n). The outermost cells are repeated once. Raises Cancelled.
    """
    n = len(coarse)
    depths = np.empty((len(DIRECTIONS), n + 2, n + 2, n + 2), np.float32)
    for depth, towards in zip(depths, DIRECTIONS):
        cancel.check()
        sun_optical_depth(coarse, towards, 1.0 / n, depth[1:-1, 1:-1, 1:-1])
        for axis in range(3):
            ends = np.moveaxis(depth, axis, 0)
            ends[0], ends[-1] = ends[1], ends[-2]
    return depths


@dataclass(frozen=True)
class OpenDepths:
    """Optical depths from points, for sigma_hat = 1.

    levels: the two finest levels of the density pyramid, float32 (n, n, n), rows of which are contiguous. lattice: of
    `direction_depths`.
    """

    levels: Sequence[np.ndarray]
    lattice: np.ndarray

    def __call__(self, positions: np.ndarray) -> np.ndarray:
        """Depths float32 (N, 50) towards DIRECTIONS, from positions (N, 3) in the cube's frame."""
        at = np.ascontiguousarray(positions, np.float32)
        depths = np.empty((len(at), len(DIRECTIONS)), np.float32)
        call(
            "sample_open_depths",
            points=len(at),
            positions=at,
            directions=len(DIRECTIONS),
            towards=DIRECTIONS.astype(np.float32),
            samples=len(LEVELS),
            middles=MIDDLES,
            lengths=LENGTHS,
            sampled=np.array(LEVELS, np.int64),
            levels=tuple(level.ctypes.data for level in self.levels),
            cells=np.array([len(level) for level in self.levels], np.int64),
            strides=np.array([[stride // level.itemsize for stride in level.strides[:2]] for level in self.levels]),
            reach=REACH,
            lattice=self.lattice,
            edge=self.lattice.shape[1],
            depths=depths,
        )
        return depths
