"""Pixels that get their multiple scattering from their neighbours: it is smooth across the image.

The image is cut into squares. The network looks at their corners and middles first. Where a square's corners say of
its middle what the network says, the pixels between are interpolated: not their light, but its mean over the ray's
opacity, which is known of every pixel and keeps edges as sharp as they are. Elsewhere the network looks at all pixels.
"""

import numpy as np

# Pixels from a square's corner to the next.
STRIDE = 4
# Squares lie in bands of so many rows of the image, and no square reaches into the next band, so that images do not depend
# on the tiles, whole bands, that they are rendered in.
BAND = 8 * STRIDE + 1
# A square's middle may differ from what its corners say by this share of the light there, over the root of the number of
# depth samples: less than these leave.
DIFFERENCE = 0.06
# Where the diffused light along pixels' rays is known, it may stray from what is interpolated so many times as far.
HINT = 3.0

_ROWS, _COLUMNS = (axis.ravel() for axis in np.mgrid[0 : STRIDE + 1, 0 : STRIDE + 1])
# Of a square's places, the corners and the middle.
_KNOWN = [(0, 0), (0, STRIDE), (STRIDE, 0), (STRIDE, STRIDE), (STRIDE // 2, STRIDE // 2)]


def _weights() -> np.ndarray:
    """(places, 5) weights of corners and middle at a square's places: bilinear, with a pyramid over the middle."""
    down, right = _ROWS / STRIDE, _COLUMNS / STRIDE
    pyramid = np.minimum(1.0 - np.abs(2.0 * down - 1.0), 1.0 - np.abs(2.0 * right - 1.0))
    corners = np.stack([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right], axis=1)
    return np.column_stack([corners - 0.25 * pyramid[:, None], pyramid])


_WEIGHTS = _weights()


class Squares:
    """The squares that lie wholly in a window (x0, y0, x1, y1) of an image; pixels (P,) are the window's."""

    def __init__(self, window):
        x0, y0, x1, y1 = window
        width = x1 - x0
        columns = np.arange(-(-x0 // STRIDE) * STRIDE, x1 - STRIDE, STRIDE)
        rows = np.arange(y0, max(y1 - STRIDE, y0))
        rows = rows[(rows % BAND % STRIDE == 0) & (rows % BAND + STRIDE < BAND)]
        first = ((rows - y0)[:, None] * width + (columns - x0)).reshape(-1, 1)
        self.pixels, self.size = first + _ROWS * width + _COLUMNS, width * (y1 - y0)
        self.known = first + np.array([row * width + column for row, column in _KNOWN])

    def first_look(self) -> np.ndarray:
        """bool (P,): corners, middles and what lies in no square."""
        look = np.ones(self.size, bool)
        look[self.pixels] = False
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
        for place, weights in enumerate(_WEIGHTS):
            at = self.pixels[:, place]
            off = np.abs(values[at] - sum(weight * column for weight, column in zip(weights, known)))
            np.maximum(most, off * opacity[at], out=most)
            total += values[at] * opacity[at]
        return most / np.maximum(total / len(_WEIGHTS), np.float32(1e-30))

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
        for place, weights in enumerate(_WEIGHTS):
            at = self.pixels[shared, place]
            wanted = pixels[at]
            # Summed one after another: the same whatever other squares there are.
            values[at[wanted]] = sum(weight * column for weight, column in zip(weights, known[wanted].T))


def agreeing(squares, mean, opacity, once, ahead, depth_samples: int):
    """bool (S,), the squares in which pixels may share, and how far their middles are from the mean of their corners, (S,).

    mean: (P,) multiple scattering over opacity, where it is known; opacity: (P,); once: (P,) light scattered once; ahead:
    (P,) mean over opacity of the diffused light along a pixel's ray, or None.
    """
    most = np.float32(DIFFERENCE / np.sqrt(depth_samples))
    surprise = squares.surprise(mean)
    light = squares.middles(once + mean * opacity)
    shared = squares.whole(opacity > 0.0) & (surprise * squares.middles(opacity) < most * light)
    if ahead is not None:
        shared &= squares.straying(ahead, opacity) < HINT * most
    return shared, surprise
