# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depth from every cell of a grid towards the sun, in one sweep.

Slices across the sun's dominant axis are visited from the sun's side. Each slice is sheared once along the sun's
direction, added to running columns, and the columns are sheared back to the cells. Interpolation never accumulates, and
the cost is a few passes over the grid for any direction.
"""

from collections.abc import Callable

import numpy as np

from ..kernels.library import call
from ..plan.sun_columns import BEFORE, MORE, Shear
from ..runtime.cancellation import NEVER, CancelToken

# Weights of four neighbours at fractions between the middle two.
Weights = Callable[[np.ndarray], list[np.ndarray]]
# Cells that one call of the kernel sweeps.
CELLS_PER_CALL = 1 << 21


def linear(f: np.ndarray) -> list[np.ndarray]:
    """Linear interpolation: weights of four neighbours in a row at points `f` beyond the second."""
    return [0 * f, 1 - f, f, 0 * f]


def cubic(f: np.ndarray) -> list[np.ndarray]:
    """Catmull-Rom interpolation, arguments as for `linear`.

    It reproduces parabolas, so that only the later linear interpolation blurs.
    """
    return [
        0.5 * f * (-1 + f * (2 - f)),
        1 + 0.5 * f * f * (3 * f - 5),
        0.5 * f * (1 + f * (4 - 3 * f)),
        0.5 * f * f * (f - 1),
    ]


def sun_optical_depth(
    density: np.ndarray, index_direction: np.ndarray, step_length: float = 1.0, out: np.ndarray | None = None
) -> np.ndarray:
    """Optical depth from each cell centre towards the sun, for extinction = density.

    density: float32 (nx, ny, nz), 0 outside. index_direction: (3,) towards the sun in index units, d(index)/d(length).
    step_length: factor of that length; 1 for a direction that maps world units to indices. out: what is filled, float32
    (nx, ny, nz), or None. Returns it.
    """
    main = int(np.abs(index_direction).argmax())
    depth = np.empty_like(density, dtype=np.float32) if out is None else out
    sweep(density, index_direction, step_length, linear, np.moveaxis(depth, main, 0))
    return depth


def sweep(
    density: np.ndarray,
    index_direction: np.ndarray,
    step_length: float,
    weights: Weights,
    depths: np.ndarray,
    cancel: CancelToken = NEVER,
) -> np.ndarray:
    """Sweep from slice to slice across the sun's main axis; returns two fractions of each, float32 (slices, 2).

    Every column follows a ray through all slices. It meets a slice at the fractions beyond b - BEFORE and c - BEFORE.
    The other arguments are as for `sun_optical_depth`. weights: `linear` or `cubic`; with `cubic`, depths beside sharp
    edges may fall slightly below 0. depths: float32 with the sun's main axis first, filled with depths at the cells or,
    if it is MORE larger along the other axes, with depths of columns, at least 0. Raises Cancelled.
    """
    shear = Shear(density.shape, index_direction)
    slices = np.moveaxis(np.ascontiguousarray(density, np.float32), shear.main, 0)
    order = np.array(shear.towards_sun(0, len(slices)))
    starts, taps, fractions = column_placement(shear, order, weights)
    columns = np.zeros(shear.size, np.float32)
    scratch = np.empty((slices.shape[1] + MORE) * (slices.shape[2] + MORE) + slices.shape[2] + 2 * MORE, np.float32)
    slices_per_call = max(CELLS_PER_CALL // slices[0].size, 1)
    for start in range(0, len(order), slices_per_call):
        cancel.check()
        batch = slice(start, start + slices_per_call)
        call(
            "sweep_columns",
            density=slices.ctypes.data,
            shape=np.array(slices.shape),
            strides=elements(slices),
            count=len(order[batch]),
            slices=order[batch],
            starts=starts[batch],
            weights=taps[batch],
            fractions=fractions[batch] if depths.shape == slices.shape else None,
            half_step=shear.half_step * step_length,
            columns=columns,
            size=np.array(shear.size),
            depths=depths.ctypes.data,
            depth_strides=elements(depths),
            scratch=scratch,
        )
    by_slice = np.empty_like(fractions)
    by_slice[order] = fractions
    return by_slice


def column_placement(shear: Shear, slices: np.ndarray, weights: Weights) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where slices meet the columns: first column int (n, 2), weights float32 (n, 2, 4) and fractions (n, 2)."""
    whole, fractions = shear.shift(slices)
    return -whole - BEFORE - shear.first, np.stack(weights(fractions), axis=2), fractions


def elements(view: np.ndarray) -> np.ndarray:
    """Strides of an array in elements."""
    return np.array(view.strides) // view.itemsize
