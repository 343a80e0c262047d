# SPDX-License-Identifier: GPL-3.0-or-later
"""The Gabor Texture: sparse convolution noise (Lagae and others, SIGGRAPH 2009; Tavernier and others, Eurographics
2019), summed as phasors (Tricard and others, SIGGRAPH 2019).
"""

import itertools
from typing import Any

import numpy as np

from .hashing import uniform, uniform_colour, uniform_pair

# Kernels per cell.
IMPULSES = 8
# Integral of a squared kernel of high frequency in two and three dimensions.
SQUARED = {2: 0.25, 3: 1.0 / (4.0 * np.sqrt(2.0))}
LOWEST_FREQUENCY = 0.001


def gabor(
    points: np.ndarray, frequency: np.ndarray, anisotropy: np.ndarray, orientation: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value, phase and intensity (n, 1), at points (n, d).

    frequency, anisotropy: (n, 1) or (1, 1). orientation: an angle, (n, 1) or (1, 1), in two dimensions; a vector, (n,
    3) or (1, 3), in three.
    """
    points = np.asarray(points, np.float32)
    d = points.shape[1]
    isotropy, frequency = 1.0 - np.clip(anisotropy, 0.0, 1.0), np.maximum(frequency, LOWEST_FREQUENCY)
    if d == 3:
        orientation = orientation / np.maximum(np.linalg.norm(orientation, axis=1, keepdims=True), 1e-20)
    cell = np.floor(points)
    local = points - cell
    real, imaginary = np.zeros((2, len(points), 1))
    for offset in itertools.product((-1.0, 0.0, 1.0), repeat=d):
        neighbour = tuple((cell + np.array(offset, np.float32)).T)
        for n in range(IMPULSES):
            seed = 3.0 * n
            centre = (uniform_pair if d == 2 else uniform_colour)(*neighbour, seed + 1.0)
            away = local - np.array(offset, np.float32) - centre
            squared = (away * away).sum(axis=1, keepdims=True)
            sign = np.where(uniform(*neighbour, seed + 2.0) < 0.5, -1.0, 1.0)[:, None]
            envelope = np.exp(-np.pi * squared) * (0.5 + 0.5 * np.cos(np.pi * squared))
            weight = np.where(squared < 1.0, sign * envelope, 0.0)
            wave = (away * _direction((*neighbour, seed), isotropy, orientation)).sum(axis=1, keepdims=True)
            angle = 2.0 * np.pi * frequency * wave
            real, imaginary = real + weight * np.cos(angle), imaginary + weight * np.sin(angle)
    # Six standard deviations; the sign's second moment counts as one half.
    span = 6.0 * np.sqrt(IMPULSES * 0.5 * SQUARED[d])
    phase = (np.arctan2(imaginary, real) + np.pi) / (2.0 * np.pi)
    return imaginary / span * 0.5 + 0.5, phase, np.hypot(real, imaginary) / span


def _direction(seed: tuple[Any, ...], isotropy: np.ndarray, orientation: np.ndarray) -> np.ndarray:
    """Unit vectors (n, d) along which kernels of a seed oscillate."""
    if len(seed) == 3:
        angle = orientation + (uniform(*seed)[:, None] - 0.5) * np.pi * isotropy
        return np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    x, y, z = orientation[:, :1], orientation[:, 1:2], orientation[:, 2:]
    across = np.hypot(x, y)
    azimuth = np.sign(y) * np.arccos(np.clip(np.divide(x, across, out=np.zeros_like(x), where=across > 0.0), -1, 1))
    turned = uniform_pair(*seed) * np.pi * isotropy
    inclination, azimuth = np.arccos(np.clip(z, -1.0, 1.0)) + turned[:, :1], azimuth + turned[:, 1:]
    spherical = np.sin(inclination) * np.cos(azimuth), np.sin(inclination) * np.sin(azimuth), np.cos(inclination)
    return np.where(isotropy == 0.0, orientation, np.concatenate(spherical, axis=1))
