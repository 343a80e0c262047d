# SPDX-License-Identifier: GPL-3.0-or-later
"""The error that is expected of what is predicted: of pixels, and of a whole picture.

Where a network tells the error of its predictions at points, the deviations of depth samples on one ray are added up,
times a factor for how far they are independent, and what comes of it, over the light, is interpolated between few
pixels, since it is smooth. Of what else is predicted the error is a measured constant. Constants without another source
are measured on procedural views by `python -m benchmarks.fidelity.calibration`; docs/trust/stated-error.md shows
how well they hold on others.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..plan.resolution import BAND
from ..runtime.report import ExpectedError
from ..scene.camera import Camera
from .framebuffer import add_at
from .layer import Layer

# Pixels from one in which the network for the error is evaluated to the next: a power of two, the largest that leaves
# so many of them along the picture's shorter edge, and no larger than the last.
LEAST_ACROSS, LARGEST_STRIDE = 16, 16
# Standard deviation of the sum of a ray's errors, over the sum of their standard deviations.
JOINED = 0.55
# Deviations within which half and 95 % of pixels' errors lie: more near and more far than of a normal distribution.
HALF_OF_PIXELS, MOST_OF_PIXELS = 0.95, 3.69
# A picture's error over the expected one: lowest and highest of the middle 50 % and 95 % of pictures.
HALF_OF_PICTURES, MOST_OF_PICTURES = (0.87, 1.15), (0.66, 1.51)
# Within which 95 % of pictures' biases lie, over the expected error.
BIAS = 0.68
# Relative errors of light from everywhere by albedo, at held-back points (docs/understand/weights.md), and of light
# that volumes emit and scatter.
ENVIRONMENT = ((0.0, 0.6, 0.9, 0.98, 1.0), (0.3, 0.139, 0.084, 0.066, 0.060))
SCATTERED_EMISSION = 0.1
# Pixels of less opacity do not count in a picture's error.
SHOWN_ALPHA = 0.02
# Opacity of pixels at the rim; share of the light that a part of the picture must hold to be named.
RIM_ALPHA, LEAST_LIGHT = 0.5, 0.05


class SparseDeviation:
    """Standard deviation of one source's light in a camera's window of P pixels.

    known: bool (P,), pixels in which it is evaluated, where the source's light is.
    """

    def __init__(self, camera: Camera):
        x0, y0, x1, y1 = camera.window
        across = max(min(camera.resolution) // LEAST_ACROSS, 1)
        stride = min(1 << (across.bit_length() - 1), LARGEST_STRIDE)
        self._bands = [_bands(y0, y1, stride), _bands(x0, x1, stride)]
        rows, columns = (np.arange(first, end) % BAND % stride == 0 for first, end in ((y0, y1), (x0, x1)))
        self._shape = y1 - y0, x1 - x0
        self.known = (rows[:, None] & columns).ravel()
        self._sum, self._told = np.zeros(self.known.size), np.zeros(self.known.size, bool)

    def add(self, pixel: np.ndarray, deviations: np.ndarray) -> None:
        """Add depth samples: their pixels int (N,), ascending, and the deviations (N,) of what they contribute."""
        add_at(self._sum, pixel, deviations)
        self._told[pixel] = True

    def everywhere(self, light: np.ndarray, typical: float) -> np.ndarray:
        """Standard deviation float32 (P,) in all pixels.

        light: (P,), of the source. typical: deviation over the light where it is known nowhere near.
        """
        values = np.stack([self._sum, np.maximum(light, 0.0) * self._told]).reshape(2, *self._shape)
        relative = np.full(self._shape, typical)
        # Bands by themselves, so that the image does not depend on the tiles.
        for rows, down in self._bands[0]:
            for columns, across in self._bands[1]:
                deviation, lit = down @ values[:, rows, columns] @ across.T
                relative[rows, columns] = np.where(lit > 0.0, deviation / np.maximum(lit, 1e-300), typical)
        return (JOINED * relative.ravel() * np.maximum(light, 0.0)).astype(np.float32)


def _bands(first: int, end: int, stride: int) -> list[tuple[slice, np.ndarray]]:
    """Each band of rows or columns [first, end): where it lies, and weights (n, n) of its places for each of them."""
    bands = []
    for start in range(first // BAND * BAND, end, BAND):
        places = np.arange(max(start, first), min(start + BAND, end))
        weights = np.exp(-0.5 * ((places[:, None] - places) / stride) ** 2)
        bands.append((slice(places[0] - first, places[-1] + 1 - first), weights))
    return bands


def environment_deviation(albedo: float) -> float:
    """Relative error of the light of environments for an albedo."""
    return float(np.interp(albedo, *ENVIRONMENT))


def expected_error(layer: Layer) -> ExpectedError | None:
    """What is expected of a whole picture's error; None where nothing in it is predicted."""
    if not layer.multiple.any():
        return None
    shown = layer.alpha > SHOWN_ALPHA
    if not shown.any():
        return None
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    ninths = [
        _Part.of(layer, _place(height, side), above, beside)
        for above, height in _thirds(rows, ("upper", "", "lower"))
        for beside, side in _thirds(columns, ("left", "", "right"))
    ]
    total, count, variance = (sum(getattr(part, name) for part in ninths) for name in ("light", "pixels", "variance"))
    if not total > 0.0:
        return None
    error = float(np.sqrt(variance * count) / total)
    low, high = (error * factor for factor in MOST_OF_PICTURES)
    # A ninth that holds hardly any light does not count.
    lit = [part for part in ninths if part.light > LEAST_LIGHT * total]
    worst = max(lit, key=lambda part: part.variance * part.pixels / part.light**2)
    at_rim = worst.at_rim > 0.5 * worst.variance
    return ExpectedError(error, low, high, BIAS * error, worst.name + (", at the rim" if at_rim else ""))


def _place(height: str, side: str) -> str:
    """A ninth of the picture in words."""
    if height and side:
        return f"{height} {side}"
    return f"{height or side} part" if height or side else "middle"


class _Part(NamedTuple):
    """Sums over the pixels of a part of the picture that show a volume: their number, their light, their variance, and
    that of those at the rim."""

    name: str
    pixels: int
    light: float
    variance: float
    at_rim: float

    @classmethod
    def of(cls, layer: Layer, name: str, rows: slice, columns: slice) -> "_Part":
        alpha = layer.alpha[rows, columns]
        shown = alpha > SHOWN_ALPHA
        # numpy is slow to sum along short axes.
        red, green, blue = (layer.rgb[rows, columns, c] for c in range(3))
        light = ((red + green + blue) / np.float32(3.0)).sum(where=shown, dtype=np.float64)
        variance = np.square(layer.uncertainty[rows, columns], dtype=np.float64)
        variance *= shown
        rim = variance.sum(where=alpha < RIM_ALPHA)
        return cls(name, np.count_nonzero(shown), float(light), float(variance.sum()), float(rim))


def _thirds(places: np.ndarray, names: Sequence[str]) -> list[tuple[slice, str]]:
    """Thirds of the rows or columns between the first and the last of places (n,), ascending."""
    first, end = places[0], places[-1] + 1
    ends = [first + round(k * (end - first) / 3) for k in range(4)]
    return [(slice(a, b), name) for a, b, name in zip(ends, ends[1:], names)]
