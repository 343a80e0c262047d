"""Intersection of rays with boxes."""

import numpy as np


def box_interval(origins, directions, low, high):
    """Distances (N,) at which rays enter and leave an axis-aligned box; entry > exit on a miss."""
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / directions
        a = (low - origins) * inverse
        b = (high - origins) * inverse
    # A ray that runs inside a face's plane divides 0 by 0: that axis does not bound it.
    near = np.where(np.isnan(a) | np.isnan(b), -np.inf, np.minimum(a, b)).max(axis=1)
    far = np.where(np.isnan(a) | np.isnan(b), np.inf, np.maximum(a, b)).min(axis=1)
    return near, far
