"""Validation shared by the scene's descriptions."""

import numpy as np

from .errors import SceneError


def rgb_triple(value, name: str) -> np.ndarray:
    """A scalar or three numbers as float64 (3,); refuses anything not finite."""
    rgb = np.asarray(value, dtype=np.float64)
    if rgb.shape not in ((), (1,), (3,)):
        raise SceneError(f"{name} must be one number or three, not shape {rgb.shape}")
    rgb = np.broadcast_to(rgb, (3,)).copy()
    if not np.all(np.isfinite(rgb)):
        raise SceneError(f"{name} must be finite, not {rgb.tolist()}")
    return rgb


def affine_matrix(matrix, name: str) -> np.ndarray:
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.all(np.isfinite(matrix)):
        raise SceneError(f"{name} must be a finite 4x4 matrix")
    if abs(np.linalg.det(matrix[:3, :3])) == 0.0:
        raise SceneError(f"{name} is singular: the object is scaled to nothing")
    return matrix
