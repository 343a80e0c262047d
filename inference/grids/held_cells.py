# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells that hold something, and those around them."""

import numpy as np


def box_of(density: np.ndarray, margin: int = 0) -> tuple[slice, ...]:
    """Along each axis the cells between the first and the last that hold density, at least two, and some around them.

    density: (x, y, z), with two cells or more along each axis. margin: cells on each side, as far as there are any.
    """
    parts = []
    for axis, count in enumerate(density.shape):
        held = np.flatnonzero(density.max(axis=tuple(other for other in range(3) if other != axis)) > 0.0)
        first, end = (int(held[0]), int(held[-1]) + 1) if len(held) else (0, 2)
        first = min(first, count - 2)
        parts.append(slice(max(first - margin, 0), min(max(end, first + 2) + margin, count)))
    return tuple(parts)


def with_neighbours(held: np.ndarray) -> np.ndarray:
    """Cells bool (x, y, z) that are held or touch one that is, be it by a corner."""
    near = np.pad(held, 1)
    for axis in range(3):
        moved = np.moveaxis(near, axis, 0)
        near = np.moveaxis(moved[:-2] | moved[1:-1] | moved[2:], 0, axis)
    return near
