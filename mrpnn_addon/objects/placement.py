"""Which transforms place an object in the world."""

import numpy as np

# Lengths beyond which squares and products of lengths leave the range of single precision, in world units.
SMALLEST, LARGEST = 1e-9, 1e9
# Ratio of the shortest to the longest axis of an object that is flat.
FLAT = 1e-9


def why_unplaced(matrix: np.ndarray) -> str:
    """What is wrong with an object's matrix (4, 4) to the world, and what to do; "" where nothing is."""
    if not np.isfinite(matrix).all():
        return "its location, rotation or scale is not a number; look at its drivers and constraints"
    if np.abs(matrix).max() > LARGEST:
        return f"its location or scale is above {LARGEST:g}; make it smaller"
    return ""


def scaled_to_nothing(matrix: np.ndarray) -> bool:
    """Whether a matrix (4, 4) of finite numbers leaves no volume: an axis is of scale 0, as where animations begin."""
    lengths = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    return bool(lengths[2] <= max(FLAT * lengths[0], SMALLEST))
