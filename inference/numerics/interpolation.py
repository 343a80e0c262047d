# SPDX-License-Identifier: GPL-3.0-or-later
"""Trilinear interpolation of a grid that is 0 outside."""

import numpy as np


def pad_with_zeros(grid: np.ndarray) -> np.ndarray:
    """The grid surrounded by zeros: (nx + 3, ny + 3, nz + 3), voxel 0 at index 1."""
    return np.pad(grid, (1, 2))


def sample_padded(padded: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Trilinear interpolation at continuous indices of the unpadded grid; 0 from one voxel beyond it.

    padded: float32 from `pad_with_zeros`, or (nx + 3, ny + 3, nz + 3, K) of K values each. index: float32 (3, N), one
    row per axis. Returns float32 (N,) or (N, K).
    """
    base: np.ndarray | int = 0
    fractions = []
    for at, size in zip(index, padded.shape):
        # Indices beyond the padding are clamped onto it, where everything is 0.
        position = at + np.float32(1.0)
        np.clip(position, np.float32(0.0), np.float32(size - 2), out=position)
        cell = position.astype(np.int32)
        fractions.append(np.subtract(position, cell, out=position).reshape(-1, *[1] * (padded.ndim - 3)))
        base = base * np.intp(size) + cell
    fx, fy, fz = fractions
    flat = padded.reshape(-1, *padded.shape[3:])
    step_y, step_x = padded.shape[2], padded.shape[1] * padded.shape[2]

    def edge(offset: int) -> np.ndarray:
        low, high = flat[offset:].take(base, axis=0), flat[offset + 1 :].take(base, axis=0)
        return lerp_into(low, high, fz)

    y0 = lerp_into(edge(0), edge(step_y), fy)
    y1 = lerp_into(edge(step_x), edge(step_x + step_y), fy)
    return lerp_into(y0, y1, fx)


def lerp_into(low: np.ndarray, high: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """low + fraction * (high - low), computed in place in `high`."""
    high -= low
    high *= fraction
    high += low
    return high


def halved_means(values: np.ndarray) -> np.ndarray:
    """Means float32 of 2 x 2 x 2 values (nx, ny, nz), of any number along each axis; zeros are behind the last."""
    for axis in range(3):
        along = np.moveaxis(values, axis, 0)
        means = 0.5 * along[::2]
        means[: len(along) // 2] += 0.5 * along[1::2]
        values = np.moveaxis(means, 0, axis)
    return np.ascontiguousarray(values, np.float32)
