"""Pixels that get their multiple scattering from their neighbours: it is smooth across the image.

The image is cut into squares. The network looks at their corners and middles first. Where a square's corners say of
its middle what the network says, the pixels between are interpolated: not their light, but its mean over the ray's
opacity, which is known of every pixel and keeps edges as sharp as they are. Elsewhere the same is tried with smaller squares,
and what is left the network looks at pixel by pixel.
"""

import copy
import functools

import numpy as np

from ..plan.resolution import BAND

# Pixels from a square's corner to the next, and by which share of the light there, over the root of the number of depth
# samples, a square's middle may differ from what its corners say. The nearer the pixels that speak for one, the less is
# lost where they differ.
LEVELS = ((4, 0.03), (2, 0.07))
# So many times the depth samples' own error comes on top, up to so many times that share: it is nothing that neighbours
# could know.
NOISE, NOISE_MOST = 0.7, 2.0
# For the same reason a middle's difference counts by no more than this as the error of the pixels around it.
SURPRISE = 0.5
# Where the diffused light along pixels' rays is known, it may stray from what is interpolated so many times as far.
HINT = 3.0


@functools.cache
def _weights(stride: int) -> np.ndarray:
    """(places, 5) weights of corners and middle at a square's places: bilinear, with a pyramid over the middle."""
    down, right = (axis.ravel() / stride for axis in np.mgrid[0 : stride + 1, 0 : stride + 1])
    pyramid = np.minimum(1.0 - np.abs(2.0 * down - 1.0), 1.0 - np.abs(2.0 * right - 1.0))
    corners = np.stack([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right], axis=1)
    return np.column_stack([corners - 0.25 * pyramid[:, None], pyramid])


class Squares:
    """The squares of one size that lie wholly in a window (x0, y0, x1, y1) of an image; pixels (P,) are the window's.

    pixels: int (S, places) of each square, known: (S, 5), its corners and its middle.
    """

    def __init__(self, window, stride: int):
        x0, y0, x1, y1 = window
        width = x1 - x0
        columns = np.arange(-(-x0 // stride) * stride, x1 - stride, stride)
        rows = np.arange(y0, max(y1 - stride, y0))
        rows = rows[(rows % BAND % stride == 0) & (rows % BAND + stride < BAND)]
        first = ((rows - y0)[:, None] * width + (columns - x0)).reshape(-1, 1)
        within = np.arange(stride + 1)[:, None] * width + np.arange(stride + 1)
        middle = within[stride // 2, stride // 2]
        self.pixels, self.size, self.weights = first + within.ravel(), width * (y1 - y0), _weights(stride)
        self.known = first + np.append(within[::stride, ::stride], middle)

    def apart_from(self, settled: np.ndarray) -> "Squares":
        """Those squares of whose corners and middles none is settled, (P,)."""
        some, chosen = copy.copy(self), ~settled[self.known].any(axis=1)
        some.pixels, some.known = self.pixels[chosen], self.known[chosen]
        return some

    def first_look(self) -> np.ndarray:
        """bool (P,): corners and middles."""
        look = np.zeros(self.size, bool)
        look[self.known] = True
        return look

    def middles(self, values: np.ndarray) -> np.ndarray:
        """(S,) of values (P,)."""
        return values[self.known[:, 4]]

    def surprise(self, values: np.ndarray) -> np.ndarray:
        """(S,), how far each square's middle is from the mean of its corners; values (P,)."""
        known = values[self.known]
        return np.abs(known[:, 4] - known[:, :4].mean(axis=1))

    def straying(self, values: np.ndarray, opacity: np.ndarray) -> np.ndarray:
        """(S,), how far values (P,) stray at most from what is interpolated, times opacity (P,), relative to their mean."""
        known = values[self.known].T
        most, total = np.zeros((2, len(self.known)), np.float32)
        for place, weights in enumerate(self.weights):
            at = self.pixels[:, place]
            off = np.abs(values[at] - sum(weight * column for weight, column in zip(weights, known)))
            np.maximum(most, off * opacity[at], out=most)
            total += values[at] * opacity[at]
        return most / np.maximum(total / len(self.weights), np.float32(1e-30))

    def whole(self, chosen: np.ndarray) -> np.ndarray:
        """bool (S,): whether corners and middle are all chosen, (P,)."""
        return chosen[self.known].all(axis=1)

    def any(self, chosen: np.ndarray) -> np.ndarray:
        """bool (S,): whether any pixel of each square is chosen, (P,)."""
        return chosen[self.pixels].any(axis=1)

    def between(self, shared: np.ndarray) -> np.ndarray:
        """bool (P,): pixels of some squares, (S,), that are no other square's and neither corner nor middle."""
        found = np.zeros(self.size, bool)
        found[self.pixels[shared]] = True
        found[self.pixels[~shared]] = False
        found[self.known] = False
        return found

    def fill(self, values: np.ndarray, shared: np.ndarray, pixels: np.ndarray):
        """Interpolate values (P,) in some squares, (S,), at pixels chosen by `between`, in place."""
        known = values[self.known[shared]]
        for place, weights in enumerate(self.weights):
            at = self.pixels[shared, place]
            wanted = pixels[at]
            # Summed one after another: the same whatever other squares there are.
            values[at[wanted]] = sum(weight * column for weight, column in zip(weights, known[wanted].T))


def agreeing(squares, mean, error, opacity, once, ahead, difference: float):
    """bool (S,), the squares in which pixels may share, and how far their middles are from the mean of their corners, (S,).

    difference: by which share of the light a middle may differ. mean: (P,) multiple scattering over opacity, where it is
    known, and error: (P,) its standard error; opacity: (P,); once: (P,) light scattered once; ahead: (P,) mean over
    opacity of the diffused light along a pixel's ray, or None.
    """
    most = np.float32(difference)
    surprise = squares.surprise(mean)
    most_there = most * squares.middles(once + mean * opacity)
    noise = NOISE * np.sqrt((error[squares.known] ** 2).mean(axis=1)) * squares.middles(opacity)
    allowed = most_there + np.minimum(noise, NOISE_MOST * most_there)
    shared = squares.whole(opacity > 0.0) & (surprise * squares.middles(opacity) < allowed)
    if ahead is not None:
        shared &= squares.straying(ahead, opacity) < HINT * most
    return shared, surprise
