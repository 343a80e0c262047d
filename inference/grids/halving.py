# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells twice as large."""

import numpy as np

from ..kernels.field_structures import Halving
from ..kernels.library import Kernels


def halve(fine: np.ndarray, coarse: np.ndarray, kernels: Kernels | None = None) -> None:
    """Fill coarse cells, float32 (x, y, z), with the means of 2 x 2 x 2 fine ones."""
    if kernels is None:
        pairs = fine[0::2] + fine[1::2]
        pairs = pairs[:, 0::2] + pairs[:, 1::2]
        np.multiply(pairs[:, :, 0::2] + pairs[:, :, 1::2], np.float32(0.125), out=coarse)
        return
    assert fine.strides[2] == coarse.strides[2] == fine.itemsize
    data = Halving(
        fine_strides=np.array(fine.strides[:2]) // fine.itemsize,
        coarse_strides=np.array(coarse.strides[:2]) // coarse.itemsize,
        size=np.array(coarse.shape),
    )
    data.fine, data.coarse = fine.ctypes.data, coarse.ctypes.data
    kernels.prepare("halve", data)
