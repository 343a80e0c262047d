# SPDX-License-Identifier: GPL-3.0-or-later
"""A cube of fog, a wall and a camera for renders with opaque surfaces."""

import numpy as np

from inference import Camera, Surface, Volume


def camera(projection="perspective", resolution=(12, 8), **options):
    matrix = np.eye(4)
    matrix[2, 3] = 4.0
    return Camera(matrix, projection, resolution, **{"fov": 0.5, "ortho_scale": 1.0, **options})


def fog():
    """A cube of edge 2 around the origin."""
    matrix = np.diag([2.0 / 16] * 3 + [1.0])
    matrix[:3, 3] = 1.0 / 16 - 1.0
    return Volume(np.ones((16,) * 3, np.float32), matrix, "fog")


def rectangle(left, right, low, high, z):
    a, b, c, d = ((x, y, z) for x, y in ((left, low), (right, low), (right, high), (left, high)))
    return Surface([(a, b, c), (a, c, d)], "wall")
