# SPDX-License-Identifier: GPL-3.0-or-later
"""Signed distances of solids at points (M, 3), negative inside; and random rotations."""

import numba
import numpy as np

BOX, ELLIPSOID, TORUS, CAPSULE, CYLINDER = range(5)


@numba.njit(cache=True, fastmath=True)
def ball_union(points, centres, radii, blend):
    """Smooth union of balls (Quilez's polynomial minimum of width `blend`), float32 (M,)."""
    out = np.empty(points.shape[0], np.float32)
    for m in range(points.shape[0]):
        d = np.float32(1e3)
        for b in range(radii.shape[0]):
            x = points[m, 0] - centres[b, 0]
            y = points[m, 1] - centres[b, 1]
            z = points[m, 2] - centres[b, 2]
            e = np.sqrt(x * x + y * y + z * z) - radii[b]
            h = max(blend - abs(d - e), np.float32(0.0))
            d = min(d, e) - h * h / (np.float32(4.0) * blend)
        out[m] = d
    return out


@numba.njit(cache=True, fastmath=True)
def _solid(kind, x, y, z, a, b, c):
    """Distance (a bound for the ellipsoid) to one solid of half sizes a, b, c around 0."""
    if kind == BOX:
        x, y, z = abs(x) - a, abs(y) - b, abs(z) - c
        outside = np.sqrt(max(x, 0.0) ** 2 + max(y, 0.0) ** 2 + max(z, 0.0) ** 2)
        return outside + min(max(x, max(y, z)), 0.0)
    if kind == ELLIPSOID:
        k = np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)
        return (k - 1.0) * min(a, min(b, c))
    if kind == TORUS:
        ring = np.sqrt(x * x + y * y) - a
        return np.sqrt(ring * ring + z * z) - 0.4 * b
    if kind == CAPSULE:
        z -= max(-c, min(c, z))
        return np.sqrt(x * x + y * y + z * z) - 0.5 * a
    return max(np.sqrt(x * x + y * y) - a, abs(z) - c)


@numba.njit(cache=True, fastmath=True)
def constructive_solid(points, kinds, centres, frames, sizes, removed):
    """Union of the solids less those `removed`, float32 (M,).

    kinds (K,), centres (K, 3), frames (K, 3, 3) rotations whose rows are the solid's
    axes, sizes (K, 3) half sizes, removed (K,) bool.
    """
    out = np.empty(points.shape[0], np.float32)
    for m in range(points.shape[0]):
        d, cut = 1e3, 1e3
        for s in range(kinds.shape[0]):
            x = points[m, 0] - centres[s, 0]
            y = points[m, 1] - centres[s, 1]
            z = points[m, 2] - centres[s, 2]
            f = frames[s]
            e = _solid(
                kinds[s],
                f[0, 0] * x + f[0, 1] * y + f[0, 2] * z,
                f[1, 0] * x + f[1, 1] * y + f[1, 2] * z,
                f[2, 0] * x + f[2, 1] * y + f[2, 2] * z,
                sizes[s, 0],
                sizes[s, 1],
                sizes[s, 2],
            )
            if removed[s]:
                cut = min(cut, e)
            else:
                d = min(d, e)
        out[m] = max(d, -cut)
    return out


def random_rotation(rng):
    """A uniformly distributed rotation matrix (3, 3), float64."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q
