# SPDX-License-Identifier: GPL-3.0-or-later
"""Intersection of rays with boxes."""

import numpy as np

# A coordinate of a corner, the same on all axes or one per axis.
Bound = np.ndarray | float


def box_interval(origins: np.ndarray, directions: np.ndarray, low: Bound, high: Bound) -> tuple[np.ndarray, np.ndarray]:
    """Distances (...) at which rays enter and leave axis-aligned boxes; entry > exit where a ray misses its box.

    origins, directions: (..., 3); low, high: corners of the boxes, (..., 3) or scalar; all broadcast.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / directions
        a = (low - origins) * inverse
        b = (high - origins) * inverse
    # A ray within the plane of a face divides 0 by 0; that axis does not bound it, since these pass over NaN.
    first, last = np.moveaxis(np.minimum(a, b), -1, 0), np.moveaxis(np.maximum(a, b), -1, 0)
    return np.fmax(np.fmax(first[0], first[1]), first[2]), np.fmin(np.fmin(last[0], last[1]), last[2])
