# SPDX-License-Identifier: GPL-3.0-or-later
"""Intersection of rays with boxes."""

import numpy as np

# A coordinate of a corner, the same on all axes or one per axis.
Bound = np.ndarray | float


def box_interval(origins: np.ndarray, directions: np.ndarray, low: Bound, high: Bound) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,) at which rays enter and leave an axis-aligned box; entry > exit where a ray misses it.

    origins, directions: (N, 3), or either (1, 3); low, high: corners of the box, (3,) or scalar.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / directions
        a = (low - origins) * inverse
        b = (high - origins) * inverse
    # A ray within the plane of a face divides 0 by 0; that axis does not bound it, since these pass over NaN.
    first, last = np.minimum(a, b).T, np.maximum(a, b).T
    return np.fmax(np.fmax(first[0], first[1]), first[2]), np.fmin(np.fmin(last[0], last[1]), last[2])
