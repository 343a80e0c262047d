# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depth from every cell of a grid towards the sun, in one sweep.

Slices across the sun's dominant axis are visited from the sun's side. Each slice is sheared once along the sun's
direction, added to running columns, and the columns are sheared back to the cells. Interpolation never accumulates, and
the cost is a few passes over the grid for any direction.
"""

from collections.abc import Callable, Iterator

import numpy as np

from ..kernels.field_structures import ColumnSweep
from ..kernels.library import Kernels
from ..plan.sun_columns import BEFORE, MORE, Shear
from ..runtime.cancellation import NEVER, CancelToken

# Weights of four neighbours at a fraction between the middle two.
Fraction = float | np.float32
Weights = Callable[[Fraction], list[Fraction]]
# Cells that one call of the kernel sweeps.
CELLS_PER_CALL = 1 << 22


def linear(f: Fraction) -> list[Fraction]:
    """Linear interpolation: weights of four neighbours in a row at a point `f` beyond the second."""
    return [0.0, 1 - f, f, 0.0]


def cubic(f: Fraction) -> list[Fraction]:
    """Catmull-Rom interpolation, arguments as for `linear`.

    It reproduces parabolas, so that only the later linear interpolation blurs.
    """
    return [
        0.5 * f * (-1 + f * (2 - f)),
        1 + 0.5 * f * f * (3 * f - 5),
        0.5 * f * (1 + f * (4 - 3 * f)),
        0.5 * f * f * (f - 1),
    ]


def shift_up(planes: np.ndarray, f_b: Fraction, f_c: Fraction, weights: Weights) -> np.ndarray:
    """Resample planes (..., b, c), 0 outside, at points a fraction beyond each cell.

    f_b, f_c: fractions along b and c, which grow by MORE, from BEFORE cells before the first. weights: `linear` or
    `cubic`.
    """
    for axis, fraction in ((-2, f_b), (-1, f_c)):
        count = planes.shape[axis] + MORE
        beside = [(0, 0)] * planes.ndim
        beside[axis] = (MORE, MORE)
        padded = np.moveaxis(np.pad(planes, beside), axis, 0)
        taps = [np.float32(weight) * padded[i : i + count] for i, weight in enumerate(weights(fraction)) if weight]
        planes = np.moveaxis(sum(taps[1:], taps[0]), 0, axis)
    return planes


def _shift_back(columns: np.ndarray, f_b: Fraction, f_c: Fraction) -> np.ndarray:
    """Depths at the cells, from columns placed as by `shift_up`."""
    first, end = BEFORE, len(columns) - MORE + BEFORE
    b = columns[first:end] * (1 - f_b) + columns[first - 1 : end - 1] * f_b
    end = columns.shape[1] - MORE + BEFORE
    return b[:, first:end] * (1 - f_c) + b[:, first - 1 : end - 1] * f_c


def sun_optical_depth(
    density: np.ndarray, index_direction: np.ndarray, step_length: float = 1.0, kernels: Kernels | None = None
) -> np.ndarray:
    """Optical depth from each cell centre towards the sun, for extinction = density.

    density: float32 (nx, ny, nz), 0 outside. index_direction: (3,) towards the sun in index units, d(index)/d(length).
    step_length: factor of that length; 1 for a direction that maps world units to indices. kernels: compiled ones, or
    None. Returns float32 (nx, ny, nz).
    """
    main = int(np.abs(index_direction).argmax())
    depth = np.empty_like(density, dtype=np.float32)
    out = np.moveaxis(depth, main, 0)
    if kernels is not None:
        compiled_sweep(kernels, density, index_direction, step_length, linear, out)
        return depth
    for index, columns, f_b, f_c in sweep(density, index_direction, step_length):
        out[index] = _shift_back(columns, f_b, f_c)
    return depth


def sweep(
    density: np.ndarray, index_direction: np.ndarray, step_length: float = 1.0, weights: Weights = linear
) -> Iterator[tuple[int, np.ndarray, np.float32, np.float32]]:
    """Yield for each slice across the sun's main axis: its index, optical depths and two fractions.

    Arguments as for `sun_optical_depth`. The depths, float32 (b + MORE, c + MORE), are those from the slice to the sun
    at points that lie by the fractions beyond b - BEFORE and c - BEFORE: every column follows one ray through all
    slices. weights: of `shift_up`; with `cubic`, depths beside sharp edges may fall slightly below 0. The array is
    reused for the next slice.
    """
    shear = Shear(density.shape, index_direction)
    slices = np.moveaxis(density, shear.main, 0)
    nb, nc = slices.shape[1:]
    # Half the length through a slice: each slice adds to the points before and after it.
    half_step = np.float32(shear.half_step * step_length)
    columns = np.zeros(shear.size, np.float32)
    for index in shear.towards_sun(0, len(slices)):
        (whole_b, whole_c), (f_b, f_c) = shear.shift(index)
        # Column p meets the slice at p + slope * k, so cell 0 touches columns from -whole - BEFORE.
        start_b, start_c = -whole_b - BEFORE - shear.first[0], -whole_c - BEFORE - shear.first[1]
        window = columns[start_b : start_b + nb + MORE, start_c : start_c + nc + MORE]
        half_slice = shift_up(slices[index], f_b, f_c, weights)
        half_slice *= half_step
        window += half_slice
        yield index, window, f_b, f_c
        window += half_slice


def compiled_sweep(
    kernels: Kernels,
    density: np.ndarray,
    index_direction: np.ndarray,
    step_length: float,
    weights: Weights,
    depths: np.ndarray,
    cancel: CancelToken = NEVER,
) -> np.ndarray:
    """The whole of a `sweep`; returns the fractions, float32 (slices, 2).

    depths: float32 with the sun's main axis first, filled with those at the cells or, where it is MORE larger along the
    other axes, those of columns, at least 0. Raises Cancelled.
    """
    shear = Shear(density.shape, index_direction)
    slices = np.moveaxis(np.ascontiguousarray(density, np.float32), shear.main, 0)
    order = np.array(shear.towards_sun(0, len(slices)))
    starts, taps, fractions = column_placement(shear, order, weights)
    columns = np.zeros(shear.size, np.float32)
    scratch = np.empty((slices.shape[1] + MORE) * (slices.shape[2] + MORE) + slices.shape[2] + 2 * MORE, np.float32)
    each = max(CELLS_PER_CALL // slices[0].size, 1)
    for start in range(0, len(order), each):
        cancel.check()
        part = slice(start, start + each)
        data = ColumnSweep(
            shape=np.array(slices.shape),
            strides=elements(slices),
            count=len(order[part]),
            slices=order[part],
            starts=starts[part],
            weights=taps[part],
            fractions=fractions[part] if depths.shape == slices.shape else None,
            half_step=shear.half_step * step_length,
            columns=columns,
            size=np.array(shear.size),
            depth_strides=elements(depths),
            scratch=scratch,
        )
        data.density, data.depths = slices.ctypes.data, depths.ctypes.data
        kernels.prepare("sweep_columns", data)
    by_slice = np.empty_like(fractions)
    by_slice[order] = fractions
    return by_slice


def column_placement(shear: Shear, slices: np.ndarray, weights: Weights) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where slices meet the columns: first column int (n, 2), weights float32 (n, 2, 4) and fractions (n, 2)."""
    shifts = [shear.shift(int(index)) for index in slices]
    starts = np.array([[-whole - BEFORE - first for whole, first in zip(w, shear.first)] for w, _ in shifts], np.int64)
    taps = np.array([[weights(fraction) for fraction in f] for _, f in shifts], np.float32)
    return starts, taps, np.array([f for _, f in shifts], np.float32)


def elements(view: np.ndarray) -> np.ndarray:
    """Strides of an array in elements."""
    return np.array(view.strides) // view.itemsize
