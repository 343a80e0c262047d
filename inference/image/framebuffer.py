# SPDX-License-Identifier: GPL-3.0-or-later
"""The images that a render accumulates."""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields

import numpy as np

from ..blur.reconstruction import join, sharpness_where_swept

# (x0, y0, x1, y1): upper left pixel inclusive, lower right exclusive.
Window = tuple[int, int, int, int]


@dataclass
class Framebuffer:
    """Images of P pixels, row by row.

    single, multiple, emission: float32 (P, 3). alpha, depth: float32 (P,). As in `layer.Layer`, except that depth is
    the sum of distance times opacity. sharpness: float32 (P, 4), of blurred pictures, as of `blur.reconstruction`;
    swept: the same, of surfaces that move, where these end rays.
    uncertainty, deviation: float32 (P,), standard errors of `multiple`, mean over the channels, due to depth sampling
    and interpolation, and of what predicts it.
    """

    single: np.ndarray
    multiple: np.ndarray
    emission: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    uncertainty: np.ndarray
    deviation: np.ndarray
    sharpness: np.ndarray
    swept: np.ndarray

    @classmethod
    def black(cls, pixels: int, mapper: Callable[..., Iterable[None]] = map) -> "Framebuffer":
        """A framebuffer of zeros; mapper: maps a function over the images, possibly in parallel."""
        colours, numbers = np.empty((2, pixels, 3), np.float32), np.empty((4, pixels), np.float32)
        # Written to at once: numpy asks the system for large pages then, which take less time than many small ones.
        deque(mapper(lambda image: image.fill(0.0), [*colours, *numbers]), maxlen=0)
        # Where nothing emits, its memory is never written to, and takes neither time nor space.
        single, multiple = colours
        emission, sharpness, swept = (np.zeros((pixels, values), np.float32) for values in (3, 4, 4))
        return cls(*[single, multiple, emission, *numbers, sharpness, swept])

    def joined(self, window: Window, mapper: Callable[..., Iterable[None]]) -> "Framebuffer":
        """The framebuffer of a blurred picture, with pixels joined that show the same."""
        *images, sharpness, swept = self._images(window)
        sharpness = sharpness_where_swept(sharpness, swept)
        joined = [*join(images, sharpness, mapper), sharpness, swept]
        return Framebuffer(*(image.reshape(-1, *image.shape[2:]) for image in joined))

    def radiances(self) -> list[np.ndarray]:
        """Its images that are in proportion to the light: all but alpha and depth."""
        return [self.single, self.multiple, self.emission, self.uncertainty, self.deviation]

    def part(self, window: Window, part: Window) -> "Framebuffer":
        """A copy of the pixels in a part of this one's window."""
        return Framebuffer(
            *(np.array(image[_place(window, part)]).reshape(-1, *image.shape[2:]) for image in self._images(window))
        )

    def add(self, window: Window, other: "Framebuffer", part: Window) -> None:
        """Add what another framebuffer holds to a part of this one's window."""
        for image, more in zip(self._images(window), other._images(part)):
            if more.any():
                image[_place(window, part)] += more

    def _images(self, window: Window) -> list[np.ndarray]:
        """Views with rows and columns."""
        x0, y0, x1, y1 = window
        images = (getattr(self, field.name) for field in fields(self))
        return [image.reshape(y1 - y0, x1 - x0, *image.shape[1:]) for image in images]


def _place(window: Window, part: Window) -> tuple[slice, slice]:
    return slice(part[1] - window[1], part[3] - window[1]), slice(part[0] - window[0], part[2] - window[0])


def add_at(image: np.ndarray, pixel: np.ndarray, values: np.ndarray) -> None:
    """Add values (N,), N > 0, to an image (P,) at pixels int (N,), ascending; values of equal pixels accumulate."""
    added = summed(pixel, values)
    image[pixel[0] : pixel[0] + len(added)] += added


def summed(pixel: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums float64 of values (N,) of equal pixels int (N,), ascending, from the first pixel to the last."""
    return np.bincount(pixel - pixel[0], values)
