"""Trilinear interpolation of a grid with 0 outside."""

import numpy as np


def pad_with_zeros(grid: np.ndarray) -> np.ndarray:
    """The grid with zeros around it: (nx + 3, ny + 3, nz + 3), voxel 0 at index 1."""
    return np.pad(grid, (1, 2))


def locate(padded: np.ndarray, index: np.ndarray):
    """Flat offsets (N,) of the cells that hold continuous indices (N, 3), and fractions (N, 3) in them."""
    shape = np.array(padded.shape)
    # Indices beyond the padding are clamped onto it, where all is 0.
    position = np.clip(index + np.float32(1.0), np.float32(0.0), (shape - 2).astype(np.float32))
    cell = position.astype(np.int32)
    fraction = position - cell
    return (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2], fraction


def interpolate(padded: np.ndarray, base: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Trilinear interpolation in located cells: float32 (N,)."""
    flat = padded.reshape(-1)
    step_y, step_x = padded.shape[2], padded.shape[1] * padded.shape[2]
    fx, fy, fz = fraction[:, 0], fraction[:, 1], fraction[:, 2]

    def edge(offset):
        a = flat.take(base + offset)
        return a + fz * (flat.take(base + (offset + 1)) - a)

    y0 = edge(0)
    y0 = y0 + fy * (edge(step_y) - y0)
    y1 = edge(step_x)
    y1 = y1 + fy * (edge(step_x + step_y) - y1)
    return y0 + fx * (y1 - y0)


def sample_padded(padded: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Interpolate at continuous indices of the unpadded grid; 0 from one cell beyond it.

    padded: float32 from `pad_with_zeros`; index: float32 (N, 3). Returns float32 (N,).
    """
    return interpolate(padded, *locate(padded, index))


def occupied_cells(padded: np.ndarray) -> np.ndarray:
    """bool, the padded grid's shape: whether a cell has a corner above 0."""
    filled = padded > 0.0
    for axis in range(3):
        ahead = np.roll(filled, -1, axis)
        filled = filled | ahead
    return filled


def sample_trilinear(grid: np.ndarray, index: np.ndarray) -> np.ndarray:
    """As `sample_padded`, for a grid that is not padded."""
    return sample_padded(pad_with_zeros(grid), index)
