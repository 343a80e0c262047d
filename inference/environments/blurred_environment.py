# SPDX-License-Identifier: GPL-3.0-or-later
"""Environments blurred by Henyey-Greenstein's phase function, by spherical harmonics.

The phase function's moments are powers of its mean cosine, so that a blurred image is a sum over degrees l of g^l times
the image's part of that degree.
"""

import functools
from collections.abc import Sequence

import numpy as np

from ..scene.environment import pixel_directions, pixel_solid_angles

#: Highest degree; finer detail than about 4 degrees is left out.
DEGREES = 40


@functools.lru_cache(maxsize=2)
def _legendre(rows: int) -> np.ndarray:
    """Associated Legendre functions float64 (m, l, rows) up to DEGREES, normalised for integrals over the sphere."""
    z = pixel_directions(rows)[:, 0, 2]
    flat = np.sqrt(1.0 - z * z)
    legendre = np.zeros((DEGREES + 1, DEGREES + 1, rows))
    sectoral = np.full(rows, np.sqrt(0.25 / np.pi))
    for m in range(DEGREES + 1):
        if m:
            sectoral = sectoral * flat * np.sqrt((2.0 * m + 1.0) / (2.0 * m))
        legendre[m, m] = sectoral
        if m < DEGREES:
            legendre[m, m + 1] = z * np.sqrt(2.0 * m + 3.0) * sectoral
        for l in range(m + 2, DEGREES + 1):
            a = np.sqrt((4.0 * l * l - 1.0) / (l * l - m * m))
            b = np.sqrt(((l - 1.0) ** 2 - m * m) / (4.0 * (l - 1.0) ** 2 - 1.0))
            legendre[m, l] = a * (z * legendre[m, l - 1] - b * legendre[m, l - 2])
    return legendre


def blurred(image: np.ndarray, anisotropies: Sequence[float] | np.ndarray) -> np.ndarray:
    """An image (H, 2H, C) convolved with phase functions: float32 (H, 2H, B, C), for B mean cosines.

    Even light stays exactly even.
    """
    rows, columns, channels = image.shape
    legendre = _legendre(rows)
    orders = min(DEGREES, columns // 2 - 1) + 1
    waves = np.fft.rfft(image.astype(np.float64), axis=1)[:, :orders] * pixel_solid_angles(rows)[:, :, None]
    # Of each order m the coefficients of all degrees l.
    coefficients = np.einsum("mlr,rmc->mlc", legendre[:orders], waves)
    # Rows are not quite a quadrature of these functions; their mean is kept exactly.
    mean = (image * pixel_solid_angles(rows)[:, :, None]).sum(axis=(0, 1)) / (4.0 * np.pi)
    coefficients[0, 0] = 0.0
    degrees = np.arange(DEGREES + 1)
    images = np.empty((rows, columns, len(anisotropies), channels), np.float32)
    for b, g in enumerate(anisotropies):
        scaled = coefficients * (float(g) ** degrees)[None, :, None]
        filtered = np.zeros((rows, columns // 2 + 1, channels), complex)
        filtered[:, :orders] = np.einsum("mlr,mlc->rmc", legendre[:orders], scaled) * columns
        images[:, :, b] = np.fft.irfft(filtered, columns, axis=1) + mean
    return images


def read_image(image: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Bilinear values (N, ...) of an image (H, 2H, ...) in directions (N, 3)."""
    rows, columns = image.shape[:2]
    azimuth = np.arctan2(directions[:, 1], directions[:, 0]) * (columns / (2.0 * np.pi)) - 0.5
    row = (0.5 - np.arcsin(np.clip(directions[:, 2], -1.0, 1.0)) / np.pi) * rows - 0.5
    i, j = np.floor(row).astype(int), np.floor(azimuth).astype(int)
    shape = (-1,) + (1,) * (image.ndim - 2)
    u, v = ((value - whole).astype(np.float32).reshape(shape) for value, whole in ((row, i), (azimuth, j)))
    above, below = np.clip(i, 0, rows - 1), np.clip(i + 1, 0, rows - 1)
    left, right = j % columns, (j + 1) % columns
    top = (1.0 - v) * image[above, left] + v * image[above, right]
    bottom = (1.0 - v) * image[below, left] + v * image[below, right]
    return (1.0 - u) * top + u * bottom
