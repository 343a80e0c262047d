# SPDX-License-Identifier: GPL-3.0-or-later
"""Validation shared by the descriptions of a scene."""

import numpy as np
from numpy.typing import ArrayLike

from .errors import SceneError


def rgb_triple(value: ArrayLike, name: str) -> np.ndarray:
    """One number or three as float64 (3,). Raises SceneError for other shapes and for values that are not finite."""
    rgb = np.asarray(value, dtype=np.float64)
    if rgb.shape not in ((), (1,), (3,)):
        raise SceneError(f"{name} must be one number or three, not shape {rgb.shape}")
    rgb = np.broadcast_to(rgb, (3,)).copy()
    if not np.all(np.isfinite(rgb)):
        raise SceneError(f"{name} must be finite, not {rgb.tolist()}")
    return rgb


def affine_matrix(matrix: ArrayLike, name: str) -> np.ndarray:
    """A matrix as float64 (4, 4). Raises SceneError unless it is finite and invertible."""
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.all(np.isfinite(matrix)):
        raise SceneError(f"{name} must be a finite 4x4 matrix")
    if abs(np.linalg.det(matrix[:3, :3])) == 0.0:
        raise SceneError(f"{name} is singular: the object is scaled to nothing")
    return matrix
