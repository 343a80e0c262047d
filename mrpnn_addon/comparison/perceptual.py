# SPDX-License-Identifier: GPL-3.0-or-later
"""FLIP, NVIDIA's perceptual difference, if its package is installed; the extension does not ship it."""

import numpy as np

try:
    import flip_evaluator
except ImportError:
    flip_evaluator = None


def flip(image: np.ndarray, reference: np.ndarray) -> float | None:
    """Mean HDR-FLIP of linear images (H, W, 3), 0 to 1, or None. The reference's noise counts as difference."""
    if flip_evaluator is None:
        return None
    pair = (np.ascontiguousarray(np.maximum(values, 0.0), np.float32) for values in (reference, image))
    return float(flip_evaluator.evaluate(*pair, "HDR")[1])
