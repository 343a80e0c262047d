# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells twice as large, and half as large."""

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


def doubled(coarse: np.ndarray) -> np.ndarray:
    """Values float32 (x, y, z) on cells half as large, linear between the centres of the large ones."""
    fine = np.empty([2 * n for n in coarse.shape], np.float32)
    call(
        "refine",
        coarse=np.ascontiguousarray(coarse, np.float32),
        size=np.array(coarse.shape),
        fine=fine,
        scratch=np.empty((coarse.shape[1] + 1, coarse.shape[2]), np.float32),
    )
    return fine
