# SPDX-License-Identifier: GPL-3.0-or-later
"""Intersection of rays with boxes."""

import numpy as np

# A coordinate of a corner, the same on all axes or one per axis.
Bound = np.ndarray | float


def box_interval(origins: np.ndarray, directions: np.ndarray, low: Bound, high: Bound) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,) at which rays enter and leave an axis-aligned box; entry > exit where a ray misses it.

    origins, directions: (N, 3), or one of them (1, 3); low, high: corners of the box, (3,) or scalar.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / directions
        a = (low - origins) * inverse
        b = (high - origins) * inverse
    # A ray within the plane of a face divides 0 by 0; that axis does not bound it.
    near = np.where(np.isnan(a) | np.isnan(b), -np.inf, np.minimum(a, b)).max(axis=1)
    far = np.where(np.isnan(a) | np.isnan(b), np.inf, np.maximum(a, b)).min(axis=1)
    return near, far
