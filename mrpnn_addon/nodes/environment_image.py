# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels of images, and equirectangular ones at the low resolution that lighting from all directions needs."""

import math
import os
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from ..textures.image import ImagePixels
from .colour_operations import from_rec709

ROWS = 128
# Colour spaces of linear Rec. 709, by their names in several versions, and those whose values are not converted.
REC709, AS_THEY_ARE = {"Linear Rec.709", "Linear"}, {"Non-Color", "Raw"}


def environment_image(image: "bpy.types.Image") -> Callable[[np.ndarray], np.ndarray]:
    """A function from directions (n, 3) to linear colours (n, 3) of an equirectangular image.

    Raises ValueError, with the reason, where the image cannot be read.
    """
    colours = linear_pixels(image)
    return sampler(_downsampled(_downsampled(colours, 0, ROWS), 1, 2 * ROWS).astype(np.float64))


def linear_pixels(image: "bpy.types.Image") -> np.ndarray:
    """Linear colours float32 (rows, columns, 3) of an image. Raises ValueError, with the reason, if it has none."""
    read = read_pixels(image)
    colours = read.pixels[..., :3]
    if read.srgb:
        colours = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    return colours @ read.from_file.astype(np.float32)


def require_readable(image: "bpy.types.Image | None") -> None:
    """Raises ValueError, with the reason, where `read_pixels` cannot read an image; without reading it, which takes
    time. Whether the file holds an image is not known before it is read.
    """
    if image is None:
        raise ValueError("the image is missing or empty")
    if image.source not in ("FILE", "GENERATED"):
        raise ValueError(f"an image of source {image.source}")
    space = image.colorspace_settings.name
    if space not in REC709 | AS_THEY_ARE | {"sRGB"} and not image.is_float:
        raise ValueError(f"color space {space}")
    stored = image.has_data or image.packed_file is not None or image.source == "GENERATED"
    if not stored and not os.path.isfile(bpy.path.abspath(image.filepath, library=image.library)):
        raise ValueError("the image is missing or empty")


def read_pixels(image: "bpy.types.Image") -> ImagePixels:
    """The pixels of an image. Raises ValueError, with the reason, if it has none."""
    require_readable(image)
    width, height = image.size
    if not width or not height:
        raise ValueError("the image is missing or empty")
    pixels = np.empty(width * height * image.channels, np.float32)
    values: Any = image.pixels
    values.foreach_get(pixels)
    pixels = pixels.reshape(height, width, image.channels)
    colours = pixels[..., :3] if image.channels >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    alpha = pixels[..., 3:] if image.channels == 4 else np.ones_like(colours[..., :1])
    space = image.colorspace_settings.name
    srgb = space == "sRGB" and not image.is_float
    # Blender converts images of floats when it reads them.
    converted = image.is_float or space in AS_THEY_ARE
    from_file = np.eye(3) if converted else from_rec709(np.eye(3))
    return ImagePixels(np.concatenate([colours, alpha], axis=2), srgb, from_file)


def sampler(small: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """A function from directions (n, 3) to bilinear samples (n, 3) of pixels (rows, columns, 3)."""

    def colour(directions: np.ndarray) -> np.ndarray:
        x, y, z = directions.T
        u = (0.5 - np.arctan2(y, x) / (2.0 * math.pi)) * small.shape[1] - 0.5
        v = (np.arctan2(z, np.hypot(x, y)) / math.pi + 0.5) * small.shape[0] - 0.5
        left, low = np.floor(u).astype(int), np.floor(v).astype(int)
        total = np.zeros((len(x), small.shape[2]))
        for i, share in ((left, 1.0 - (u - left)), (left + 1, u - left)):
            for j, part in ((low, 1.0 - (v - low)), (low + 1, v - low)):
                total = total + (share * part)[:, None] * small[np.clip(j, 0, len(small) - 1), i % small.shape[1]]
        return total

    return colour


def _downsampled(values: np.ndarray, axis: int, most: int) -> np.ndarray:
    """Box-filtered to at most `most` cells along an axis, so that no bright pixel is lost."""
    count = values.shape[axis]
    if count <= most:
        return values
    padded = np.concatenate(
        [np.zeros_like(np.take(values, [0], axis)), np.cumsum(values, axis=axis, dtype=np.float64)], axis=axis
    )
    place = np.linspace(0, count, most + 1)
    first = np.minimum(place.astype(int), count - 1)
    shape = [1] * values.ndim
    shape[axis] = -1
    rest = (place - first).reshape(shape)
    sums = np.take(padded, first, axis) + rest * np.take(values, first, axis)
    return np.diff(sums, axis=axis) * (most / count)
