# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of object transforms."""

import numpy as np

# Range of lengths, in world units, whose squares and products single precision represents.
SMALLEST, LARGEST = 1e-9, 1e9
# Ratio of the shortest to the longest axis at which an object is flat.
FLAT = 1e-9


def placement_problem(matrix: np.ndarray) -> str:
    """The problem with an object-to-world matrix (4, 4) and its remedy, for a message; "" without one."""
    if not np.isfinite(matrix).all():
        return "its location, rotation or scale is not finite; check its drivers and constraints"
    if np.abs(matrix).max() > LARGEST:
        return f"its location or scale exceeds {LARGEST:g}; reduce it"
    return ""


def has_zero_scale(matrix: np.ndarray) -> bool:
    """Whether a finite matrix (4, 4) has an axis of scale 0, as animations often begin with."""
    lengths = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    return bool(lengths[2] <= max(FLAT * lengths[0], SMALLEST))
