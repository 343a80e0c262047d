# SPDX-License-Identifier: GPL-3.0-or-later
"""Small volumes, cameras and lights for the cases."""

import numpy as np

from inference import Camera, Sun, Volume

SUN = Sun((0.4, 0.3, 0.8))


def placed(density, size=1.0, name="volume") -> Volume:
    """A grid centred at the origin whose longest side is `size`."""
    density = np.asarray(density, np.float32)
    voxel = size / max(density.shape)
    matrix = np.diag([voxel, voxel, voxel, 1.0])
    matrix[:3, 3] = -0.5 * voxel * (np.array(density.shape) - 1.0)
    return Volume(density, matrix, name)


def blob(cells=16, seed=3) -> np.ndarray:
    """A lumpy density in [0, 1) that fades to 0 at its bounds, float32 (cells,) * 3."""
    axis = (np.arange(cells) + 0.5) / cells * 2.0 - 1.0
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    fade = np.clip(1.0 - np.sqrt(x**2 + y**2 + z**2), 0.0, None)
    return (fade * np.random.default_rng(seed).uniform(0.5, 1.0, fade.shape)).astype(np.float32)


def moved(volume: Volume, matrix) -> Volume:
    """The volume with a (4, 4) or (3, 3) transform on top of its own."""
    whole = np.eye(4)
    whole[: len(matrix), : len(matrix)] = matrix
    return Volume(volume.density, whole @ volume.world_from_index, volume.name)


def rotation(angle: float, axis=(0.3, 0.5, 0.8)) -> np.ndarray:
    """(3, 3) by an angle in radians."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)


def camera(position=(1.7, -1.3, 2.1), pixels=10, fov=0.6, target=(0.0, 0.0, 0.0), **options) -> Camera:
    """Square image from a position towards a target."""
    position, target = np.asarray(position, np.float64), np.asarray(target, np.float64)
    back = (position - target) / np.linalg.norm(position - target)
    up = np.array([0.0, 1.0, 0.0]) if abs(back[1]) < 0.99 else np.array([1.0, 0.0, 0.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    matrix[:3, 3] = position
    return Camera(matrix, **{"resolution": (pixels, pixels), "fov": fov, **options})


def along(direction, distance=3.0, **options) -> Camera:
    """An orthographic camera that looks at the origin along a direction."""
    direction = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    return camera(-distance * direction, projection="orthographic", **{"ortho_scale": 1.3, **options})
