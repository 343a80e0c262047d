# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes, a sun and a camera for renders by `inference`."""

import numpy as np

from inference import Camera, Medium, Sun, Volume

SUN = Sun((0.4, 0.3, 0.8), 2.0)
BLACK = Medium(3.0, 0.0)


def box(size=(1.0, 1.0, 1.0), voxels=32, density=1.0, name="box"):
    """A homogeneous box around the origin: its rays have optical depth density x length exactly."""
    shape = tuple(voxels for _ in size)
    matrix = np.diag([*(np.array(size) / voxels), 1.0])
    matrix[:3, 3] = -0.5 * np.array(size) + 0.5 * np.array(size) / voxels
    return Volume(np.full(shape, density, np.float32), matrix, name)


def cloud(seed=0, voxels=24):
    """A lumpy cloud with empty corners, in a unit cube."""
    random = np.random.default_rng(seed)
    axis = np.linspace(-1, 1, voxels)
    r = np.sqrt(sum(a**2 for a in np.meshgrid(axis, axis, axis, indexing="ij")))
    density = np.maximum(1.0 - r, 0.0) * random.random((voxels,) * 3)
    matrix = np.diag([1 / voxels] * 3 + [1.0])
    matrix[:3, 3] = 0.5 / voxels - 0.5
    return Volume(density.astype(np.float32), matrix, "cloud")


def camera(distance=3.0, **options):
    """Looks along -Z at the origin."""
    matrix = np.eye(4)
    matrix[2, 3] = distance
    return Camera(matrix, **{"resolution": (24, 16), "fov": 0.5, **options})


def integrals_of_density(grid, points, ends, count=1500):
    """Integrals (N,) of the density between points (N, 3) and ends, one or (N, 3)."""
    way = ends - points
    # Only the part within twice the volume.
    length = np.minimum(np.linalg.norm(way, axis=1), 2.0)
    way *= (length / np.linalg.norm(way, axis=1))[:, None]
    share = (np.arange(count) + 0.5) / count
    index = grid.index((points[:, None] + share[:, None] * way[:, None]).reshape(-1, 3)).T.astype(np.float32)
    return grid.sample_density(index).reshape(len(points), count).mean(axis=1) * length
