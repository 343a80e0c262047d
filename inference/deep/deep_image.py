# SPDX-License-Identifier: GPL-3.0-or-later
"""Deep images: for each pixel the light and the opacity of a few intervals of depth.

Within a sample of opacity a, opacity grows as that of an even medium: 1 - (1 - a)^f after a fraction f of its depth.
Colour grows in proportion to it ("Interpreting OpenEXR Deep Pixels",
https://openexr.com/en/latest/InterpretingDeepPixels.html).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

# (x0, y0, x1, y1), as of a camera's region.
Window = tuple[int, int, int, int]


@dataclass
class DeepImage:
    """N samples of the pixels of an image, rows from the top, in each pixel from the nearest to the farthest.

    counts: int32 (H, W), samples of each pixel. front, back: float32 (N,), where each begins and ends: distances along
    the viewing axis, of panoramas along the ray; world units. rgba: float32 (N, 4), of each alone, premultiplied.
    """

    counts: np.ndarray
    front: np.ndarray
    back: np.ndarray
    rgba: np.ndarray

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> "DeepImage":
        """Without any sample; shape: (H, W)."""
        none = np.zeros(0, np.float32)
        return cls(np.zeros(shape, np.int32), none, none, np.zeros((0, 4), np.float32))

    @classmethod
    def joined(cls, window: Window, parts: Sequence[tuple[Window, "DeepImage"]]) -> "DeepImage":
        """The image of a window of which parts are known, none of them twice."""
        x0, y0, x1, y1 = window
        counts, pixels = np.zeros((y1 - y0, x1 - x0), np.int32), [np.zeros(0, np.int64)]
        number = np.arange(counts.size).reshape(counts.shape)
        for (left, top, right, bottom), part in parts:
            place = slice(top - y0, bottom - y0), slice(left - x0, right - x0)
            counts[place] = part.counts
            pixels.append(np.repeat(number[place].ravel(), part.counts.ravel()))
        images = [cls.empty((0, 0)), *(part for _, part in parts)]
        order = np.argsort(np.concatenate(pixels), kind="stable")
        front, back, rgba = (
            np.concatenate([getattr(one, name) for one in images])[order] for name in ("front", "back", "rgba")
        )
        return cls(counts, front, back, rgba)

    def in_window(self, window: Window, resolution: tuple[int, int]) -> "DeepImage":
        """The same as a window of an image of (width, height) that is empty elsewhere."""
        width, height = resolution
        return DeepImage.joined((0, 0, width, height), [(window, self)])

    def flat(self) -> np.ndarray:
        """float32 (H, W, 4), premultiplied: what the samples show together."""
        pixel, image = np.repeat(np.arange(self.counts.size), self.counts.ravel()), np.zeros((self.counts.size, 4))
        for some in self._layers():
            image[pixel[some]] += (1.0 - image[pixel[some], 3:]) * self.rgba[some]
        return image.reshape(*self.counts.shape, 4).astype(np.float32)

    def showing(self, rgb: np.ndarray) -> "DeepImage":
        """The same with each pixel's colours scaled to show together rgb, float32 (H, W, 3), where they show any."""
        flat = self.flat()[..., :3].reshape(-1, 3)
        factors = np.where(flat > 0.0, rgb.reshape(-1, 3) / np.where(flat > 0.0, flat, 1.0), 1.0)
        rgba = self.rgba.copy()
        rgba[:, :3] *= np.repeat(factors, self.counts.ravel(), axis=0)
        return DeepImage(self.counts, self.front, self.back, rgba)

    def _layers(self) -> Iterator[np.ndarray]:
        """Samples, by number, that are the first, second ... of their pixels."""
        counts = self.counts.ravel()
        number = np.arange(len(self.front)) - np.repeat(np.cumsum(counts) - counts, counts)
        for n in range(int(counts.max(initial=0))):
            yield np.flatnonzero(number == n)
