# SPDX-License-Identifier: GPL-3.0-or-later
"""A layer in the frame of Blender's images."""

from dataclasses import replace
from typing import Any

import numpy as np

from ...inference.image.layer import Layer
from ...inference.scene import Camera

# Cycles' depth where nothing scatters; infinity would break sums in a compositor.
NO_DEPTH = 1e10
# What passes have where there is nothing; 0 in others.
NOTHING = {"Median Depth": np.inf, "Shadow": 1.0}


def in_frame(layer: Layer, camera: Camera, crop: bool) -> Layer:
    """The layer at the size of its region if `crop`, else in the full frame."""
    if crop or camera.region is None:
        return layer
    width, height = camera.resolution
    x0, y0, x1, y1 = camera.region

    def placed(array: np.ndarray, background: Any) -> np.ndarray:
        full = np.full((height, width) + array.shape[2:], background, dtype=np.float32)
        full[y0:y1, x0:x1] = array
        return full

    return replace(
        layer,
        rgb=placed(layer.rgb, 0.0),
        alpha=placed(layer.alpha, 0.0),
        depth=placed(layer.depth, np.inf),
        single=placed(layer.single, 0.0),
        multiple=placed(layer.multiple, 0.0),
        uncertainty=placed(layer.uncertainty, 0.0),
        emission=placed(layer.emission, 0.0),
        sampling_error=None,
        groups={name: placed(rgb, 0.0) for name, rgb in layer.groups.items()},
        deep=layer.deep and layer.deep.in_window((x0, y0, x1, y1), (width, height)),
        passes={name: placed(values, NOTHING.get(name, 0.0)) for name, values in layer.passes.items()},
    )


def finite_depth(layer: Layer) -> np.ndarray:
    """float32 (H, W): depth, NO_DEPTH where it is infinite."""
    return finite(layer.depth)


def finite(depth: np.ndarray) -> np.ndarray:
    """Depths float32, NO_DEPTH where they are infinite; other passes are finite as they are."""
    return np.where(np.isfinite(depth), depth, np.float32(NO_DEPTH))


def rgba(layer: Layer) -> np.ndarray:
    """float32 (H, W, 4): premultiplied colour and alpha."""
    return np.concatenate([layer.rgb, layer.alpha[..., None]], axis=2)
