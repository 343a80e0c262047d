# SPDX-License-Identifier: GPL-3.0-or-later
"""Interpolation of multiple scattering between pixels, where it is smooth across the image.

The image is divided into squares, and the network is evaluated at their corners and centres first. Where the corners of
a square predict its centre, the pixels in between are interpolated: not their radiance but its mean over the ray's
opacity, which is known in every pixel and preserves edges. Elsewhere the same is tried with smaller squares, and what
remains is evaluated pixel by pixel.
"""

import copy
import functools
from dataclasses import dataclass

import numpy as np

from ..plan.resolution import BAND

# Edge of a square in pixels, and the difference of its centre to what its corners predict that is tolerated, as a
# fraction of the light there over the root of the number of depth samples. In smaller squares a difference concerns
# fewer pixels.
LEVELS = ((8, 0.0), (4, 0.03), (2, 0.07))
# The same for squares as large as a voxel, by their edge in pixels, in proportion for smaller and larger ones: nothing
# within a voxel varies so much, but for the noise of depth sampling. Most pixels are in the largest squares, whose
# differences are what flickers in films.
VOXEL_DIFFERENCE = {8: 0.06, 4: 0.08, 2: 0.06}
# The standard error of depth sampling is tolerated on top, times NOISE and up to MAX_NOISE times that fraction:
# neighbours cannot predict noise.
NOISE, MAX_NOISE = 0.7, 2.0
# Fraction of the difference of a centre that counts as the error of the pixels around it, for the same reason.
CENTRE_ERROR = 0.5
# Pixels of less opacity than this may be as wrong as if they had it: beside opaque ones they add nothing to a picture's
# error, and what shows behind them outshines them.
FAINT = 0.3
# Width in pixels of a voxel below which all pixels are evaluated: hardly any would agree with its neighbours, and one
# large call takes less time than several small ones.
LEAST_VOXEL = 0.5
# What is known of all pixels may deviate from its interpolation by so many times as much.
GUIDE_TOLERANCE = 3.0
# Where that is the distance at which light scatters: differences are relative to so many voxels.
DISTANCE_VOXELS = 200.0


@functools.cache
def _weights(stride: int) -> np.ndarray:
    """(places, 5) weights of corners and centre at the pixels of a square: bilinear, with a pyramid over the centre."""
    down, right = (axis.ravel() / stride for axis in np.mgrid[0 : stride + 1, 0 : stride + 1])
    pyramid = np.minimum(1.0 - np.abs(2.0 * down - 1.0), 1.0 - np.abs(2.0 * right - 1.0))
    corners = np.stack([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right], axis=1)
    return np.column_stack([corners - 0.25 * pyramid[:, None], pyramid])


def _in_band(first: int, end: int) -> np.ndarray:
    """Places of rows or columns in their bands."""
    return np.arange(first, end) % BAND


@dataclass(frozen=True)
class Guide:
    """What is known of all P pixels and varies across the image where their light does.

    values: (P,). scale: (P,), what differences are relative to.
    """

    values: np.ndarray
    scale: np.ndarray


class Squares:
    """Squares of one size that lie entirely in a window (x0, y0, x1, y1) of an image; pixels (P,) are the window's.

    known: int (5, S), corners and centre of each square. seen: bool (5, S), which of these show a volume; the others
    count as the mean of those.
    """

    def __init__(self, window: tuple[int, int, int, int], stride: int):
        x0, y0, x1, y1 = window
        width = x1 - x0
        columns, rows = (
            first + np.flatnonzero((_in_band(first, end) % stride == 0) & (_in_band(first, end) + stride < BAND))
            for first, end in ((x0, max(x1 - stride, x0)), (y0, max(y1 - stride, y0)))
        )
        first = ((rows - y0)[:, None] * width + (columns - x0)).ravel()
        self._within = np.arange(stride + 1)[:, None] * width + np.arange(stride + 1)
        centre = self._within[stride // 2, stride // 2]
        self.stride, self.width, self.size = stride, width, width * (y1 - y0)
        self.known = np.append(self._within[::stride, ::stride], centre)[:, None] + first
        self.seen = np.ones(self.known.shape, bool)

    @functools.cached_property
    def pixels(self) -> np.ndarray:
        """int (places, S), of each square. What is reduced over comes first, which numpy does many at a time."""
        return self._within.reshape(-1, 1) + self.known[0]

    def of(self, shown: np.ndarray) -> "Squares":
        """The squares in which a pixel shows a volume, of an image in which those of a mask (P,) do."""
        # Summed over rows and columns, which takes four lookups per square.
        sums = np.zeros((self.size // self.width + 1, self.width + 1), np.int32)
        np.cumsum(np.cumsum(shown.reshape(-1, self.width), axis=0, dtype=np.int32), axis=1, out=sums[1:, 1:])
        row, column = np.divmod(self.known[0], self.width)
        below, right = row + self.stride + 1, column + self.stride + 1
        shown_pixels = sums[below, right] - sums[row, right] - sums[below, column] + sums[row, column]
        some = self.some(np.flatnonzero(shown_pixels))
        some.seen = shown[some.known]
        return some

    def without(self, excluded: np.ndarray) -> "Squares":
        """The squares none of whose corners and centres is in a mask (P,)."""
        return self.some(np.flatnonzero(~excluded[self.known].any(axis=0)))

    def some(self, chosen: np.ndarray) -> "Squares":
        """Some of the squares; chosen: their numbers, or a mask (S,)."""
        some = copy.copy(self)
        some.__dict__.pop("pixels", None)
        some.known, some.seen = self.known[:, chosen], self.seen[:, chosen]
        return some

    def known_pixels(self) -> np.ndarray:
        """bool (P,): corners and centres."""
        known = np.zeros(self.size, bool)
        known[self.known] = True
        return known

    def known_values(self, values: np.ndarray) -> np.ndarray:
        """(5, S), values (P,) at corners and centres."""
        known = values[self.known]
        if self.seen.all():
            return known
        count = np.maximum(self.seen.sum(axis=0), 1).astype(values.dtype)
        return np.where(self.seen, known, (known * self.seen).sum(axis=0) / count)

    def judged(self) -> np.ndarray:
        """bool (S,): whether the centre and at least two corners show a volume, so that they tell what lies between."""
        return self.seen[4] & (self.seen[:4].sum(axis=0) >= 2)

    def centres(self, values: np.ndarray) -> np.ndarray:
        """(S,), values (P,) at the centres."""
        return values[self.known[4]]

    def centre_error(self, values: np.ndarray) -> np.ndarray:
        """(S,), difference between the centre of each square and the mean of its corners; values: (P,)."""
        known = self.known_values(values)
        return np.abs(known[4] - known[:4].mean(axis=0))

    def deviation(self, guide: Guide, opacity: np.ndarray) -> np.ndarray:
        """(S,), largest error of interpolating the guide's values, times opacity (P,), relative to its mean scale.

        The mean is as if no opacity were below FAINT.
        """
        values, seen = guide.values[self.pixels], opacity[self.pixels]
        largest = (np.abs(values - self._interpolated(guide.values)) * seen).max(axis=0, initial=0.0)
        scale = guide.scale[self.pixels] * np.maximum(seen, np.float32(FAINT))
        return largest / np.maximum(scale.mean(axis=0), 1e-30)

    def any(self, chosen: np.ndarray) -> np.ndarray:
        """bool (S,): whether any pixel of each square is in a mask (P,)."""
        return chosen[self.pixels].any(axis=0)

    def interior(self, smooth: np.ndarray) -> np.ndarray:
        """bool (P,): pixels of some squares (S,), except those of other squares and known pixels."""
        inner = np.zeros(self.size, bool)
        inner[self.pixels[:, smooth]] = True
        inner[self.pixels[:, ~smooth]] = False
        inner[self.known] = False
        return inner

    def fill(self, values: np.ndarray, pixels: np.ndarray) -> None:
        """Interpolate values (P,) in place at the pixels of these squares that are in a mask (P,)."""
        wanted = pixels[self.pixels]
        values[self.pixels[wanted]] = self._interpolated(values)[wanted]

    def _interpolated(self, values: np.ndarray) -> np.ndarray:
        """(places, S), from values (P,) at corners and centres."""
        # Added one after another: the same result whatever other squares there are.
        weights = _weights(self.stride).astype(values.dtype).T
        return sum(value * weight[:, None] for value, weight in zip(self.known_values(values), weights))


def interpolable(
    squares: Squares,
    mean: np.ndarray,
    error: np.ndarray,
    opacity: np.ndarray,
    single: np.ndarray,
    guide: Guide,
    difference: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Which squares may be interpolated, bool (S,), and the differences (S,) between their centres and corners.

    mean: (P,), multiple scattering over opacity in known pixels. error: (P,), its standard error. opacity: (P,).
    single: (P,), single scattering. difference: (P,), tolerated error of a centre, as a fraction of the light there.
    """
    fraction, seen = squares.centres(difference), squares.centres(opacity)
    centre_error = squares.centre_error(mean)
    light = squares.centres(single) + squares.centres(mean) * seen
    tolerance = fraction * light * np.maximum(FAINT / np.maximum(seen, np.float32(1e-30)), 1.0)
    noise = NOISE * np.sqrt((error[squares.known] ** 2).mean(axis=0)) * seen
    allowed = tolerance + np.minimum(noise, MAX_NOISE * tolerance)
    smooth = squares.judged() & (centre_error * seen < allowed)
    return smooth & (squares.deviation(guide, opacity) < GUIDE_TOLERANCE * fraction), centre_error
