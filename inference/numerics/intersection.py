# SPDX-License-Identifier: GPL-3.0-or-later
"""Intersection of rays with boxes, and places in triangles."""

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


def barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Shares (N, 3) of corners (N, 3, 3) in points (N, 3) of their triangles."""
    a, b, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    aa, ab, bb = (np.einsum("nc,nc->n", *pair) for pair in ((a, a), (a, b), (b, b)))
    pa, pb = (np.einsum("nc,nc->n", p, side) for side in (a, b))
    area = np.maximum(aa * bb - ab * ab, 1e-12 * aa * bb + 1e-300)
    second, third = (bb * pa - ab * pb) / area, (aa * pb - ab * pa) / area
    return np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, 1.0)
