"""FLIP, NVIDIA's perceptual difference, where its package is installed; the extension does not bring it."""

from typing import Optional

import numpy as np

try:
    import flip_evaluator
except ImportError:
    flip_evaluator = None


def flip(image: np.ndarray, reference: np.ndarray) -> Optional[float]:
    """Mean HDR-FLIP of linear images (H, W, 3), 0 to 1, or None. A reference's noise counts as difference."""
    if flip_evaluator is None:
        return None
    pair = (np.ascontiguousarray(np.maximum(values, 0.0), np.float32) for values in (reference, image))
    return float(flip_evaluator.evaluate(*pair, "HDR")[1])
