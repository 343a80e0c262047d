# SPDX-License-Identifier: GPL-3.0-or-later
"""Values at cells of a grid from those that are known at some: simple kriging.

A value is the mean plus a weighted sum of what known ones near by differ from it. The weights are those of the least
expected square error where the covariance of two values is exp(-distance / RANGE) (Matheron 1963).
"""

import functools

import numpy as np

from ..kernels.library import call

# Cells within which values are alike, the part of their variance that has no neighbours, and cells that are looked at
# on each side.
RANGE, NOISE, REACH = 4.0, 0.05, 6


def krige(
    shape: tuple[int, ...], places: np.ndarray, known: np.ndarray, mean: np.ndarray, cells: np.ndarray
) -> np.ndarray:
    """Values float32 (M, V) at cells int (M,) of a grid (nx, ny, nz), in C order.

    known: (N, V), at different places int (N,). mean: (V,), expected far from all of these.
    """
    padded = [size + 2 * REACH for size in shape]
    row = np.array([padded[1] * padded[2], padded[2], 1])
    places, cells = (np.column_stack(np.unravel_index(n, shape)) @ row + REACH * row.sum() for n in (places, cells))
    numbers = np.full(padded, -1, np.int32)
    numbers.reshape(-1)[places] = np.arange(len(places))
    offsets, covariance = _neighbourhood()
    found = np.empty((len(cells), known.shape[1]), np.float32)
    call(
        "krige",
        values=known.shape[1],
        known=np.ascontiguousarray(known, np.float32),
        numbers=numbers,
        mean=np.ascontiguousarray(mean, np.float32),
        offsets=len(offsets),
        offset=offsets,
        step=offsets[:, :3].astype(np.int64) @ row,
        covariance=covariance,
        noise=NOISE,
        cells=len(cells),
        cell=cells.astype(np.int64),
        found=found,
    )
    return found


@functools.cache
def _neighbourhood() -> tuple[np.ndarray, np.ndarray]:
    """Steps to cells within reach and the squares of their lengths, int32 (O, 4), nearest first; the covariance,
    float32, by the square of a distance.
    """
    steps = np.indices((2 * REACH + 1,) * 3).reshape(3, -1).T - REACH
    squares = (steps**2).sum(axis=1)
    order = np.argsort(squares, kind="stable")
    order = order[squares[order] <= REACH**2]
    covariance = np.exp(-np.sqrt(np.arange((2 * REACH) ** 2 + 1)) / RANGE).astype(np.float32)
    return np.column_stack([steps, squares])[order].astype(np.int32), covariance
