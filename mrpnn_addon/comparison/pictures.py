# SPDX-License-Identifier: GPL-3.0-or-later
"""Images encoded as PNG in memory by Blender."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..output.layer_image import save_view_transformed


def view_png(values: np.ndarray, scene: "bpy.types.Scene") -> bytes:
    """Linear premultiplied (H, W, 4), rows from the top, with the scene's view transform and alpha."""
    image = _image(values, float_buffer=True)
    image.alpha_mode = "PREMUL"
    return _file(image, lambda path: save_view_transformed(image, path, scene))


def display_png(colours: np.ndarray) -> bytes:
    """Display colours (H, W, 3) in [0, 1], rows from the top, unchanged."""
    opaque = np.concatenate([colours, np.ones((*colours.shape[:2], 1))], axis=-1)
    image = _image(opaque, float_buffer=False)
    image.file_format = "PNG"
    return _file(image, lambda path: image.save(filepath=path))


def _image(values: np.ndarray, float_buffer: bool) -> "bpy.types.Image":
    height, width = values.shape[:2]
    image = bpy.data.images.new("mrpnn picture", width, height, alpha=True, float_buffer=float_buffer)
    pixels: Any = image.pixels
    pixels.foreach_set(np.ascontiguousarray(values[::-1], np.float32).ravel())
    return image


def _file(image: "bpy.types.Image", save: Callable[[str], Any]) -> bytes:
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "picture.png"
            save(str(path))
            return path.read_bytes()
    finally:
        bpy.data.images.remove(image)
