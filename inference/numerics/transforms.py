# SPDX-License-Identifier: GPL-3.0-or-later
"""Transforms between keys."""

import numpy as np


def transform_at(keys: np.ndarray, place: float) -> np.ndarray:
    """The transform float64 (4, 4) at a place in [0, 1] among keys (K, 4, 4) that are evenly spaced.

    Rotations turn about one axis from key to key, at constant speed; translation and stretch are linear.
    """
    number = min(int(place * (len(keys) - 1)), max(len(keys) - 2, 0))
    fraction = place * (len(keys) - 1) - number
    if fraction == 0.0 or np.array_equal(keys[number], keys[number + 1]):
        return np.array(keys[number], np.float64)
    (turn, stretch), (last_turn, last_stretch) = (_polar(key[:3, :3]) for key in keys[number : number + 2])
    found = (1.0 - fraction) * keys[number] + fraction * keys[number + 1]
    found[:3, :3] = (
        turn @ _fraction_of(turn.T @ last_turn, fraction) @ ((1 - fraction) * stretch + fraction * last_stretch)
    )
    return found


def _polar(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A rotation and a symmetric stretch, (3, 3) each, whose product a matrix is; mirrors are in the stretch."""
    left, sizes, right = np.linalg.svd(matrix)
    if np.linalg.det(left @ right) < 0.0:
        left, sizes = -left, -sizes
    return left @ right, (right.T * sizes) @ right


def _fraction_of(rotation: np.ndarray, fraction: float) -> np.ndarray:
    """A rotation (3, 3) by a fraction of the angle of another, about its axis (Rodrigues' formula)."""
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    sine, cosine = 0.5 * np.linalg.norm(axis), 0.5 * (np.trace(rotation) - 1.0)
    if sine < 1e-9 and cosine < 0.0:
        # By half a turn: the axis is the column of rotation + 1 that is longest.
        columns = rotation + np.eye(3)
        axis = columns[:, np.linalg.norm(columns, axis=0).argmax()]
    angle, length = fraction * np.arctan2(sine, cosine), np.linalg.norm(axis)
    if not length > 0.0:
        return np.eye(3)
    x, y, z = axis / length
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
