# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance in voxels, predicted only where it is not smooth and interpolated in between."""

from collections.abc import Callable

import numpy as np

# Edges of the cells at whose corners radiance is predicted, in voxels, coarsest first.
STRIDES = (8, 4, 2)
# Difference of the radiance at a cell's corners, over its mean, and optical thickness of a cell, up to which it is
# interpolated.
SMOOTH, THIN = 0.2, 4.0

CORNERS = [np.array(corner) for corner in np.ndindex(2, 2, 2)]


def radiance_in_voxels(
    wanted: np.ndarray, thickness: np.ndarray, predict: Callable[[np.ndarray], np.ndarray], interpolate: bool
) -> tuple[np.ndarray, int]:
    """Radiance float32 (nx, ny, nz, 3) in the wanted voxels, 0 in others, and the number of voxels predicted.

    wanted: bool (nx, ny, nz). thickness: float32 (nx, ny, nz), optical, of voxels. predict: radiance (3, N) of voxels
    int (N, 3). interpolate: whether cells of smooth light are interpolated.
    """
    radiance = np.zeros((*wanted.shape, 3), np.float32)
    known, left = np.zeros_like(wanted), wanted.copy()

    def evaluate(some: np.ndarray) -> None:
        voxels = np.argwhere(some)
        if len(voxels):
            radiance[some] = predict(voxels).T
            known[some] = True
            left[some] = False

    for stride in STRIDES if interpolate else ():
        cells = _open_cells(wanted, left, thickness, stride)
        if not len(cells):
            continue
        corners = np.stack([(cells + corner) * stride for corner in CORNERS])
        needed = np.zeros_like(wanted)
        needed[tuple(corners.reshape(-1, 3).T)] = True
        evaluate(needed & ~known)
        at_corners = radiance[tuple(np.moveaxis(corners, -1, 0))]
        grey = at_corners.mean(axis=-1)
        smooth = grey.max(axis=0) - grey.min(axis=0) <= SMOOTH * grey.mean(axis=0)
        _fill(radiance, left, cells[smooth] * stride, at_corners[:, smooth], stride)
    evaluate(left.copy())
    return radiance, int(known.sum())


def _open_cells(wanted: np.ndarray, left: np.ndarray, thickness: np.ndarray, stride: int) -> np.ndarray:
    """Cells int (N, 3), optically thin and with all corners wanted, that hold voxels without radiance."""
    nodes = wanted[::stride, ::stride, ::stride]
    count = [n - 1 for n in nodes.shape]
    if min(count) < 1:
        return np.zeros((0, 3), int)
    inside = np.ones(count, bool)
    for corner in CORNERS:
        inside &= nodes[tuple(slice(c, c + n) for c, n in zip(corner, count))]
    ends = [slice(0, n * stride) for n in count]
    blocks = [part for n in count for part in (n, stride)]
    inside &= left[tuple(ends)].reshape(blocks).any(axis=(1, 3, 5))
    inside &= thickness[tuple(ends)].reshape(blocks).max(axis=(1, 3, 5)) * np.float32(stride) <= THIN
    return np.argwhere(inside)


def _fill(radiance: np.ndarray, left: np.ndarray, first: np.ndarray, corners: np.ndarray, stride: int) -> None:
    """Interpolate in cells; first: int (N, 3), their lowest voxels. corners: (8, N, 3), radiance at their corners."""
    for offset in np.ndindex(*[stride + 1] * 3):
        place = first + np.array(offset)
        at = tuple(place.T)
        some = np.flatnonzero(left[at])
        if not len(some):
            continue
        share = np.array(offset) / stride
        values = np.zeros((len(some), 3), np.float32)
        for corner, radiance_there in zip(CORNERS, corners):
            weight = np.prod(np.where(corner == 1, share, 1.0 - share))
            if weight > 0.0:
                values += np.float32(weight) * radiance_there[some]
        chosen = tuple(place[some].T)
        radiance[chosen] = values
        left[chosen] = False
