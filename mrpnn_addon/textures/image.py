# SPDX-License-Identifier: GPL-3.0-or-later
"""Images as textures, sampled as Cycles does on processors."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ImagePixels:
    """pixels: float32 (rows, columns, 4), rows from the bottom. srgb: whether colours are encoded as sRGB. from_file:
    float64 (3, 3), from the colours as rows, once they are linear, to scene linear ones.
    """

    pixels: np.ndarray
    srgb: bool
    from_file: np.ndarray

    # Compared by identity, since arrays are not true or false.
    __eq__, __hash__ = object.__eq__, object.__hash__


def project(points: np.ndarray, projection: str) -> np.ndarray:
    """Coordinates (n, 2) on an image of points (n, 3); projection: FLAT, SPHERE or TUBE."""
    if projection == "FLAT":
        return points[:, :2]
    x, y, z = (2.0 * points - 1.0).T
    around = np.where((x == 0.0) & (y == 0.0), 0.0, 0.5 * (1.0 - np.arctan2(x, y) / np.pi))
    if projection == "TUBE":
        return np.stack([around, 0.5 * (z + 1.0)], axis=1)
    length = np.sqrt(x * x + y * y + z * z)
    cosine = np.divide(z, length, out=np.zeros_like(z), where=length > 0.0)
    return np.stack([around, 1.0 - np.arccos(np.clip(cosine, -1.0, 1.0)) / np.pi], axis=1)


def sample(image: ImagePixels, uv: np.ndarray, interpolation: str, extension: str) -> np.ndarray:
    """Linear colours and alpha (n, 4) at coordinates (n, 2).

    interpolation: Closest, Linear, Cubic or Smart, which is cubic. extension: REPEAT, EXTEND, CLIP or MIRROR.
    """
    place = uv * np.array(image.pixels.shape[1::-1])
    if interpolation == "Closest":
        found = _texels(image.pixels, np.floor(place).astype(int), extension)
    else:
        cell = np.floor(place - 0.5).astype(int)
        weights = _linear if interpolation == "Linear" else _cubic
        (first, columns), (_, rows) = (weights(share) for share in (place - 0.5 - cell).T)
        found = np.zeros((len(uv), 4))
        for i, across in enumerate(columns, first):
            for j, up in enumerate(rows, first):
                found += (across * up)[:, None] * _texels(image.pixels, cell + (i, j), extension)
    if image.srgb:
        colours = found[:, :3]
        found[:, :3] = np.where(
            colours < 0.04045, np.maximum(colours, 0.0) / 12.92, ((np.maximum(colours, 0.0) + 0.055) / 1.055) ** 2.4
        )
    found[:, :3] = found[:, :3] @ image.from_file
    return found


def _linear(share: np.ndarray) -> tuple[int, list[np.ndarray]]:
    """Offset of the first texel, and weights (n,) of the texels from there."""
    return 0, [1.0 - share, share]


def _cubic(share: np.ndarray) -> tuple[int, list[np.ndarray]]:
    """As `_linear`, of the uniform cubic B-spline."""
    rest = 1.0 - share
    return -1, [
        rest**3 / 6.0,
        2.0 / 3.0 - share**2 * (1.0 - 0.5 * share),
        2.0 / 3.0 - rest**2 * (1.0 - 0.5 * rest),
        share**3 / 6.0,
    ]


def _texels(pixels: np.ndarray, index: np.ndarray, extension: str) -> np.ndarray:
    """Values (n, 4) of texels (n, 2), column and row, beyond the image too."""
    size = np.array(pixels.shape[1::-1])
    if extension == "REPEAT":
        index = index % size
    elif extension == "MIRROR":
        turned = index % (2 * size)
        index = np.where(turned < size, turned, 2 * size - 1 - turned)
    inside = ((index >= 0) & (index < size)).all(axis=1, keepdims=True)
    column, row = np.clip(index, 0, size - 1).T
    found = pixels[row, column].astype(np.float64)
    return np.where(inside, found, 0.0) if extension == "CLIP" else found
