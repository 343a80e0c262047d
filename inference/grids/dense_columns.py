# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depths towards one sun, stored on every slice of a grid."""

import numpy as np

from ..plan.sun_columns import BEFORE, MORE
from ..runtime.cancellation import NEVER, CancelToken
from .optical_depth_sweep import cubic, sweep


class DenseColumns:
    """Optical depths of one padded density on slices across the sun's main axis, in columns along its rays.

    padded: float32, from `pad_with_zeros`. direction: (3,) towards the sun, d(index)/d(world unit). Raises
    Cancelled.

    offsets: float32 (slices, 2), added to a position in the padded grid on a slice gives its column. size: (2,)
    columns. first: added to the number of a slice of the padded grid, where it is stored.
    """

    first = 1

    def __init__(self, padded: np.ndarray, direction: np.ndarray, cancel: CancelToken = NEVER):
        main = int(np.abs(direction).argmax())
        shape = [padded.shape[axis] + MORE for axis in range(3) if axis != main]
        # One more slice at either end, beyond which there is no density.
        self.depths = np.zeros((padded.shape[main] + 2, *shape), np.float32)
        self.offsets = np.ones((len(self.depths), 2), np.float32)
        self.size = shape
        beyond = sweep(padded, direction, 1.0, cubic, self.depths[1:-1], cancel)
        self.offsets[1:-1] = np.float32(BEFORE) - beyond
