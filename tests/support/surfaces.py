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


def room(low, high, **options):
    """The walls of a closed box between two corners."""
    corners = np.array([(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    faces = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return Surface([corners[[a, b, c]] for f in faces for a, b, c in (f[:3], (f[0], *f[2:]))], "room", **options)
