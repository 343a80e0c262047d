"""Optical depth from every cell of a grid towards the sun, in one sweep.

Slices across the sun's dominant axis are visited from the sun's side. Each slice is
sheared along the sun's direction once, added to running columns, and the columns are
sheared back to the cells: interpolation never accumulates, and the cost is a few passes
over the grid whatever the direction.
"""

import numpy as np


def _split(offset: float):
    whole = int(np.floor(offset))
    return whole, np.float32(offset - whole)


def _shift_up(plane, f_b, f_c):
    """Resample a (b, c) plane at points `fraction` above each cell: shape grows by one."""
    b = np.pad(plane, 1)
    b = b[:-1] * (1 - f_b) + b[1:] * f_b
    return b[:, :-1] * (1 - f_c) + b[:, 1:] * f_c


def _shift_back(columns, f_b, f_c):
    """Inverse placement of `_shift_up`: columns (b + 1, c + 1) back at the cells (b, c)."""
    b = columns[1:] * (1 - f_b) + columns[:-1] * f_b
    return b[:, 1:] * (1 - f_c) + b[:, :-1] * f_c


def sun_optical_depth(density: np.ndarray, index_direction: np.ndarray, step_length: float = 1.0) -> np.ndarray:
    """Optical depth from each cell centre towards the sun, for extinction = density.

    density: float32 (nx, ny, nz), 0 outside. index_direction: (3,) the sun's direction in
    index units, d(index)/d(length); length is what `step_length` scales: world units for a
    direction that maps world to index. Returns float32 (nx, ny, nz).
    """
    main = int(np.abs(index_direction).argmax())
    depth = np.empty_like(density, dtype=np.float32)
    out = np.moveaxis(depth, main, 0)
    for index, columns, f_b, f_c in sweep(density, index_direction, step_length):
        out[index] = _shift_back(columns, f_b, f_c)
    return depth


def sweep(density, index_direction, step_length: float = 1.0):
    """Yield for each slice across the sun's main axis: its index, optical depths and two fractions.

    Arguments as for `sun_optical_depth`. The depths, float32 (b + 1, c + 1), are those from the slice to the sun,
    at places that lie by the fractions beyond b - 1 and c - 1: a column keeps to its own ray, whatever the slice.
    The array is used again for the next slice.
    """
    direction = np.asarray(index_direction, np.float64)
    main = int(np.abs(direction).argmax())
    b_axis, c_axis = (axis for axis in range(3) if axis != main)
    slices = np.moveaxis(density, main, 0)
    count, nb, nc = slices.shape
    # Half a slice's path length: each slice gives to the points before and after it.
    half_step = np.float32(0.5 * step_length / abs(direction[main]))
    slope_b = direction[b_axis] / abs(direction[main])
    slope_c = direction[c_axis] / abs(direction[main])
    # A column passes cell (b, c) of the k-th slice towards the sun at b = p + slope * k.
    span_b, span_c = slope_b * (count - 1), slope_c * (count - 1)
    first_b, first_c = int(np.floor(-max(span_b, 0.0))) - 1, int(np.floor(-max(span_c, 0.0))) - 1
    size_b = nb + int(np.ceil(abs(span_b))) + 4
    size_c = nc + int(np.ceil(abs(span_c))) + 4
    columns = np.zeros((size_b, size_c), np.float32)
    towards_sun = range(count - 1, -1, -1) if direction[main] > 0 else range(count)
    for index in towards_sun:
        k = index if direction[main] > 0 else count - 1 - index
        whole_b, f_b = _split(slope_b * k)
        whole_c, f_c = _split(slope_c * k)
        # Column p reads the slice at p + slope * k, so cells 0..n-1 lie at columns -whole-1..n-1-whole.
        start_b, start_c = -whole_b - 1 - first_b, -whole_c - 1 - first_c
        window = columns[start_b : start_b + nb + 1, start_c : start_c + nc + 1]
        half_slice = _shift_up(slices[index], f_b, f_c)
        half_slice *= half_step
        window += half_slice
        yield index, window, f_b, f_c
        window += half_slice
