# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells twice as large."""

import numpy as np

from ..kernels.library import call


def halve(fine: np.ndarray, coarse: np.ndarray) -> None:
    """Fill coarse cells, float32 (x, y, z), with the means of 2 x 2 x 2 fine cells."""
    assert fine.strides[2] == coarse.strides[2] == fine.itemsize
    call(
        "halve",
        fine=fine.ctypes.data,
        fine_strides=np.array(fine.strides[:2]) // fine.itemsize,
        coarse=coarse.ctypes.data,
        coarse_strides=np.array(coarse.strides[:2]) // coarse.itemsize,
        size=np.array(coarse.shape),
    )
