# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells that hold density, and those around them."""

import numpy as np


def box_of(density: np.ndarray, margin: int = 0) -> tuple[slice, ...]:
    """Slices along each axis around the cells that hold density: at least two cells, and a margin on each side.

    density: (x, y, z), with two cells or more along each axis. margin: in cells, cut at the edges of the array.
    """
    box = []
    for axis, count in enumerate(density.shape):
        filled = np.flatnonzero(density.max(axis=tuple(a for a in range(3) if a != axis)) > 0.0)
        first, end = (int(filled[0]), int(filled[-1]) + 1) if len(filled) else (0, 2)
        first = min(first, count - 2)
        box.append(slice(max(first - margin, 0), min(max(end, first + 2) + margin, count)))
    return tuple(box)


def with_neighbours(filled: np.ndarray) -> np.ndarray:
    """Filled cells and the 26 neighbours of each: bool (x, y, z)."""
    near = np.pad(filled, 1)
    for axis in range(3):
        moved = np.moveaxis(near, axis, 0)
        near = np.moveaxis(moved[:-2] | moved[1:-1] | moved[2:], 0, axis)
    return near
