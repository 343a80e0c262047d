# SPDX-License-Identifier: GPL-3.0-or-later
"""The images that a render accumulates."""

from dataclasses import dataclass, fields

import numpy as np


@dataclass
class Framebuffer:
    """Images of P pixels, row by row.

    single, multiple, emission: float32 (P, 3). alpha, depth, uncertainty: float32 (P,). As in `layer.Layer`, except
    that depth is the sum of distance times opacity.
    """

    single: np.ndarray
    multiple: np.ndarray
    emission: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    uncertainty: np.ndarray

    @classmethod
    def black(cls, pixels: int) -> "Framebuffer":
        """A framebuffer of zeros."""
        return cls(*np.zeros((3, pixels, 3), np.float32), *np.zeros((3, pixels), np.float32))

    def part(self, pixels: slice) -> "Framebuffer":
        """Some of the pixels, sharing memory."""
        return Framebuffer(*(getattr(self, field.name)[pixels] for field in fields(self)))


def add_at(image: np.ndarray, pixel: np.ndarray, values: np.ndarray) -> None:
    """Add values (N,), N > 0, to an image (P,) at pixels int (N,), ascending; values of equal pixels accumulate."""
    added = np.bincount(pixel - pixel[0], values)
    image[pixel[0] : pixel[0] + len(added)] += added
