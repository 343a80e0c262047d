# SPDX-License-Identifier: GPL-3.0-or-later
"""A layer as an Image data-block, and as a display-ready file."""

import os
import tempfile
from typing import Any

import bpy
import numpy as np

from ...inference.image.layer import Layer
from ..runtime.text import reason
from .layer_frame import rgba

IMAGE_NAME = "MRPNN"
# What every complete PNG file ends with.
PNG_END = b"IEND\xaeB`\x82"


def show_in_image(layer: Layer, name: str = IMAGE_NAME) -> bpy.types.Image:
    """Show the layer in the float Image `name`, as `show_image`."""
    return show_image(rgba(layer), name)


def show_image(values: np.ndarray, name: str) -> bpy.types.Image:
    """Show float32 (H, W, 4), rows from the top, in the float Image `name`, which is made or resized as needed.

    The image is scene-linear RGBA with premultiplied alpha; Blender's rows start at the bottom.
    """
    height, width = values.shape[:2]
    image: Any = bpy.data.images.get(name)
    if image is not None and not (image.source == "GENERATED" and image.is_float):
        # A packed or reloaded image cannot be written to: replace it.
        image = _replaced(image, width, height)
    if image is None:
        image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=True)
    if tuple(image.size) != (width, height):
        image.scale(width, height)
    image.alpha_mode = "PREMUL"
    image.pixels.foreach_set(np.ascontiguousarray(values[::-1], np.float32).ravel())
    image.update()
    return image


def _replaced(old: "bpy.types.Image | None", width: int, height: int) -> "bpy.types.Image":
    name = old.name
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=True)
    old.user_remap(image)
    bpy.data.images.remove(old)
    image.name = name
    return image


def save_view_transformed(image: bpy.types.Image, path: str, scene: "bpy.types.Scene") -> None:
    """Save the image as PNG with the scene's view transform, alpha included.

    The file appears at `path` only when it is complete. Raises OSError where it cannot be written.
    """
    folder = os.path.dirname(os.path.abspath(path))
    if not os.path.isdir(folder):
        raise FileNotFoundError(f"folder not found: {folder}")
    settings = scene.render.image_settings
    wanted = {"file_format": "PNG", "color_mode": "RGBA", "color_depth": "8"}
    # media_type, new in 5.0, restricts file formats.
    if hasattr(settings, "media_type"):
        wanted = {"media_type": "IMAGE", **wanted}
    before = {name: getattr(settings, name) for name in wanted}
    try:
        with tempfile.TemporaryDirectory(prefix=".mrpnn-", dir=folder) as unfinished:
            part = os.path.join(unfinished, "image.png")
            try:
                for name, value in wanted.items():
                    setattr(settings, name, value)
                image.save_render(part, scene=scene)
            finally:
                for name, value in before.items():
                    setattr(settings, name, value)
            # Blender does not notice that a disk is full.
            with open(part, "rb") as file:
                if not file.read().endswith(PNG_END):
                    raise OSError("the file is incomplete; is the disk full?")
            os.replace(part, path)
    except RuntimeError as error:
        raise OSError(f"cannot write {path}: {reason(error)}") from error
    except OSError as error:
        raise OSError(f"cannot write {path}: {error.strerror or error}") from error
