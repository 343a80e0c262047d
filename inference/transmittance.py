"""Optical depth from every cell of a grid towards the sun, in one sweep.

Slices across the sun's dominant axis are visited from the sun's side. Each slice is
sheared along the sun's direction once, added to running columns, and the columns are
sheared back to the cells: interpolation never accumulates, and the cost is a few passes
over the grid whatever the direction.
"""

import numpy as np


class Shear:
    """Columns along the sun's rays through slices across its main axis.

    shape: (3,) cells; direction: (3,) the sun's, in index units; low, high: the lowest and the highest slice of the main
    axis; on the one farther from the sun columns lie on cells. All others may lie between them, alike wherever the
    cells begin. main, others: axes; slopes: of the columns, cells of
    the other axes a slice; first: the least column of each, over which columns are counted; size: how many; half_step:
    half a slice's way, in the direction's unit of length.
    """

    def __init__(self, shape, direction, low=None, high=None):
        direction = np.asarray(direction, np.float64)
        self.main = int(np.abs(direction).argmax())
        self.others = [axis for axis in range(3) if axis != self.main]
        self.rising, count = direction[self.main] > 0.0, shape[self.main]
        self.farthest = (low or 0) if self.rising else (count - 1 if high is None else high)
        self.half_step = 0.5 / abs(direction[self.main])
        # A column passes cell (b, c) of the k-th slice towards the sun at b = p + slope * k.
        self.slopes = [direction[axis] / abs(direction[self.main]) for axis in self.others]
        # Cells that columns shift by on the way through all slices.
        ends = [sorted(slope * self.number(index) for index in (0, count - 1)) for slope in self.slopes]
        self.first = [int(np.floor(-last)) - 1 for _, last in ends]
        self.size = [shape[axis] + int(np.ceil(last - first)) + 4 for axis, (first, last) in zip(self.others, ends)]

    def towards_sun(self, first: int, end: int) -> range:
        """Numbers from first to before end in the order in which the sun's light passes them."""
        return range(end - 1, first - 1, -1) if self.rising else range(first, end)

    def number(self, index: int) -> int:
        """Of a slice: by how many it is nearer to the sun than the farthest."""
        return index - self.farthest if self.rising else self.farthest - index

    def shift(self, index: int):
        """How far columns have moved on a slice: whole cells on both other axes, and fractions."""
        shifts = [slope * self.number(index) for slope in self.slopes]
        whole = [int(np.floor(shift)) for shift in shifts]
        return whole, [np.float32(shift - n) for shift, n in zip(shifts, whole)]


def shift_up(planes, f_b, f_c):
    """Resample planes (..., b, c) at points `fraction` above each cell: b and c grow by one."""
    b = np.pad(planes, [(0, 0)] * (planes.ndim - 2) + [(1, 1)] * 2)
    b = b[..., :-1, :] * (1 - f_b) + b[..., 1:, :] * f_b
    return b[..., :-1] * (1 - f_c) + b[..., 1:] * f_c


def _shift_back(columns, f_b, f_c):
    """Inverse placement of `shift_up`: columns (b + 1, c + 1) back at the cells (b, c)."""
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
    shear = Shear(density.shape, index_direction)
    slices = np.moveaxis(density, shear.main, 0)
    nb, nc = slices.shape[1:]
    # Half a slice's way: each slice gives to the points before and after it.
    half_step = np.float32(shear.half_step * step_length)
    columns = np.zeros(shear.size, np.float32)
    for index in shear.towards_sun(0, len(slices)):
        (whole_b, whole_c), (f_b, f_c) = shear.shift(index)
        # Column p reads the slice at p + slope * k, so cells 0..n-1 lie at columns -whole-1..n-1-whole.
        start_b, start_c = -whole_b - 1 - shear.first[0], -whole_c - 1 - shear.first[1]
        window = columns[start_b : start_b + nb + 1, start_c : start_c + nc + 1]
        half_slice = shift_up(slices[index], f_b, f_c)
        half_slice *= half_step
        window += half_slice
        yield index, window, f_b, f_c
        window += half_slice
