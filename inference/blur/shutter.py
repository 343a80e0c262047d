# SPDX-License-Identifier: GPL-3.0-or-later
"""Times in a shutter, and where what moves is then."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..numerics.small_matmul import affine_inverse, product
from ..scene.camera import Camera, Shutter
from ..scene.description import Motion, Surface


def shutter_times(shutter: Shutter, u: np.ndarray) -> np.ndarray:
    """Times (N,) from 0, opening, to 1, closing: as much light comes before each as u (N,) says, fractions."""
    if not shutter.curve:
        return u
    curve = np.atleast_1d(shutter.curve)
    # Light that has come by evenly spaced times; the curve is linear in between.
    fine = np.linspace(0.0, 1.0, 16 * len(curve) + 1)
    openness = np.interp(fine, np.linspace(0.0, 1.0, len(curve)), curve)
    gathered = np.concatenate([[0.0], np.cumsum(openness[1:] + openness[:-1])])
    return np.asarray(np.interp(u * gathered[-1], gathered, fine))


def camera_at(camera: Camera, time: float) -> Camera:
    """The camera at a time of its shutter, without one."""
    shutter = camera.shutter
    if shutter is None:
        return camera
    matrix = matrix_at(shutter.world_matrices, time) if len(shutter.world_matrices) else camera.world_matrix
    # The edges of the image move evenly.
    edges = np.tan(0.5 * np.array(shutter.fovs or (camera.fov,)))
    edge = float(np.interp(time, np.linspace(0.0, 1.0, len(edges)), edges))
    return replace(camera, world_matrix=matrix, fov=2.0 * np.arctan(edge), shutter=None)


def moved_back(motion: Motion | None, times: np.ndarray) -> np.ndarray:
    """Places at the frame of places at times (E,) of the shutter, float64 (E, 3, 4); the same where nothing moves."""
    if motion is None:
        return np.broadcast_to(np.eye(4)[:3], (len(times), 3, 4))
    matrices = (matrix_at(motion.world_matrices, time) for time in times)
    return np.array([motion.world_matrix @ affine_inverse(matrix) for matrix in matrices])[:, :3]


def corners_at(surface: Surface, time: float) -> np.ndarray:
    """Corners float64 (T, 3, 3) of a surface at a time of the shutter; between two known times they move evenly."""
    if surface.deformed is not None:
        place = time * (len(surface.deformed) - 1)
        first = int(np.clip(np.floor(place), 0, len(surface.deformed) - 2))
        start, end = surface.deformed[first], surface.deformed[first + 1]
        return np.asarray(start + (place - first) * (end - start))
    if surface.motion is None:
        return surface.triangles
    matrix = matrix_at(surface.motion.world_matrices, time) @ affine_inverse(surface.motion.world_matrix)
    return np.asarray(product(surface.triangles, matrix[:3, :3].T) + matrix[:3, 3])


def matrix_at(matrices: Sequence[np.ndarray] | np.ndarray, time: float) -> np.ndarray:
    """The transform (4, 4) at a time from 0 to 1, of those at evenly spaced times (S, 4, 4).

    Between two of them the place and the scale change evenly, and the rotation turns about one axis.
    """
    place = time * (len(matrices) - 1)
    first = int(np.clip(np.floor(place), 0, len(matrices) - 2))
    fraction, (start, end) = place - first, (np.asarray(matrices[first + k], np.float64) for k in (0, 1))
    if np.array_equal(start, end):
        return start
    (turned, stretch), (turned_last, stretch_last) = (_polar(matrix[:3, :3]) for matrix in (start, end))
    found = start + fraction * (end - start)
    turn = _power(turned_last @ turned.T, fraction)
    found[:3, :3] = turn @ turned @ (stretch + fraction * (stretch_last - stretch))
    return found


def _polar(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rotation (3, 3) and the symmetric stretch (3, 3) whose product is a matrix; mirrored ones stretch."""
    u, sizes, v = np.linalg.svd(matrix)
    rotation = u @ v
    sign = 1.0 if np.linalg.det(rotation) > 0.0 else -1.0
    return sign * rotation, sign * (v.T * sizes) @ v


def _power(rotation: np.ndarray, fraction: float) -> np.ndarray:
    """A rotation (3, 3) about the same axis by a fraction of its angle."""
    # The axis is what symmetric and whole rotation keep; also after half a turn, where no side is told.
    axis = np.linalg.eigh(rotation + rotation.T)[1][:, 2]
    cross = np.cross(np.eye(3), axis).T
    sine, cosine = -0.5 * np.trace(cross @ rotation), 0.5 * (np.trace(rotation) - 1.0)
    angle = fraction * np.arctan2(sine, cosine)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)
