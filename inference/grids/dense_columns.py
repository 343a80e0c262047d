# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depths towards one sun, stored on every slice of a grid."""

import numpy as np

from ..kernels.library import Kernels
from ..plan.sun_columns import BEFORE, MORE
from ..runtime.cancellation import NEVER, CancelToken
from .optical_depth_sweep import compiled_sweep, cubic, sweep


class DenseColumns:
    """Optical depths of one padded density on slices across the sun's main axis, in columns along its rays.

    padded: float32, from `pad_with_zeros`. direction: (3,) towards the sun, d(index)/d(world unit). kernels: compiled
    ones, or None. Raises Cancelled.

    offsets: float32 (slices, 2), added to a position in the padded grid on a slice gives its column. size: (2,)
    columns.
    """

    def __init__(
        self, padded: np.ndarray, direction: np.ndarray, cancel: CancelToken = NEVER, kernels: Kernels | None = None
    ):
        main = int(np.abs(direction).argmax())
        shape = [padded.shape[axis] + MORE for axis in range(3) if axis != main]
        # One more slice at either end, beyond which there is no density.
        self.depths = np.zeros((padded.shape[main] + 2, *shape), np.float32)
        self.offsets = np.ones((len(self.depths), 2), np.float32)
        self.size = shape
        if kernels is not None:
            beyond = compiled_sweep(kernels, padded, direction, 1.0, cubic, self.depths[1:-1], cancel)
            self.offsets[1:-1] = np.float32(BEFORE) - beyond
            return
        for number, columns, *fractions in sweep(padded, direction, weights=cubic):
            cancel.check()
            np.maximum(columns, 0.0, out=self.depths[number + 1])
            self.offsets[number + 1] = np.float32(BEFORE) - np.array(fractions)

    def slices(self, number: np.ndarray) -> np.ndarray:
        """Where slices of the padded grid, int (N,), are stored."""
        return np.clip(number + 1, 0, len(self.depths) - 1)

    def corners(self, number: np.ndarray, b: np.ndarray, c: np.ndarray) -> list[np.ndarray]:
        """Depths (N,) of columns (b, c), (b, c + 1), (b + 1, c) and (b + 1, c + 1) on slices from `slices`."""
        base = (number * np.intp(self.size[0]) + b) * np.intp(self.size[1]) + c
        flat, row = self.depths.reshape(-1), self.size[1]
        return [flat[offset:].take(base) for offset in (0, 1, row, row + 1)]
