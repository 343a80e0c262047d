# SPDX-License-Identifier: GPL-3.0-or-later
"""Gradient noise, and the fractals of the Noise Texture.

Perlin's improved gradient noise (SIGGRAPH 2002) in one to four dimensions, with lattice gradients chosen by a hash, as
in OSL and Cycles, and the fractals of Musgrave (Ebert and others, Texturing and Modeling).
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from .hashing import lookup3, uniform

# Normalises gradient noise of 1 to 4 dimensions to [-1, 1]: OSL's constants.
RANGE = 0.25, 0.6616, 0.982, 0.8344
MAX_DETAIL = 15.0
# Weights below this end a hybrid multifractal.
SPENT = 0.001


@dataclass
class Fractal:
    """Octaves of noise; numbers or (n, 1).

    kind: of the Noise Texture. detail: octaves beyond the first; a fraction fades in the last. normalize: whether fBM
    lies in [0, 1] instead of [-1, 1].
    """

    kind: str = "FBM"
    detail: np.ndarray | float = 0.0
    roughness: np.ndarray | float = 0.5
    lacunarity: np.ndarray | float = 2.0
    offset: np.ndarray | float = 0.0
    gain: np.ndarray | float = 1.0
    normalize: bool = True

    def at(self, points: np.ndarray) -> np.ndarray:
        """(n, 1) at points (n, d)."""
        self.detail = np.clip(self.detail, 0.0, MAX_DETAIL)
        self.roughness = np.maximum(self.roughness, 0.0)
        return KINDS[self.kind](self, np.asarray(points, np.float64))

    def _octaves(self, points: np.ndarray) -> Iterator[tuple[np.ndarray, Any]]:
        """Yield the noise (n, 1) of each octave, and the share of it that counts."""
        for number in range(int(np.ceil(np.max(self.detail))) + 1):
            yield gradient_noise(points), np.clip(self.detail - number + 1.0, 0.0, 1.0) if number else 1.0
            points = points * self.lacunarity

    def _fbm(self, points: np.ndarray) -> np.ndarray:
        total: Any = 0.0
        span: Any = 0.0
        amplitude: Any = 1.0
        result: Any = 0.0
        for noise, share in self._octaves(points):
            total, span = total + amplitude * noise, span + amplitude
            result = result + share * ((0.5 * total / span + 0.5 if self.normalize else total) - result)
            amplitude = amplitude * self.roughness
        return result

    def _multifractal(self, points: np.ndarray) -> np.ndarray:
        result: Any = 1.0
        power: Any = 1.0
        for noise, share in self._octaves(points):
            result = result * (share * power * noise + 1.0)
            power = power * self.roughness
        return result

    def _hetero_terrain(self, points: np.ndarray) -> np.ndarray:
        result: Any = 0.0
        power: Any = 1.0
        for number, (noise, share) in enumerate(self._octaves(points)):
            layer = noise + self.offset
            result = result + share * layer * power * result if number else layer
            power = power * self.roughness
        return result

    def _hybrid_multifractal(self, points: np.ndarray) -> np.ndarray:
        result: Any = 0.0
        power: Any = 1.0
        weight: Any = 1.0
        for noise, share in self._octaves(points):
            weight = np.where(weight > SPENT, np.minimum(weight, 1.0), 0.0)
            signal = (noise + self.offset) * power
            result = result + share * weight * signal
            weight = weight * self.gain * signal
            power = power * self.roughness
        return result

    def _ridged_multifractal(self, points: np.ndarray) -> np.ndarray:
        result: Any = 0.0
        power: Any = 1.0
        signal: Any = 0.0
        for number, (noise, share) in enumerate(self._octaves(points)):
            weight = np.clip(signal * self.gain, 0.0, 1.0) if number else 1.0
            signal = weight * (self.offset - np.abs(noise)) ** 2
            # The last octave does not fade in.
            result = result + np.where(share == 1.0, signal * power, 0.0)
            power = power * self.roughness
        return result


KINDS = {
    "FBM": Fractal._fbm,
    "MULTIFRACTAL": Fractal._multifractal,
    "HETERO_TERRAIN": Fractal._hetero_terrain,
    "HYBRID_MULTIFRACTAL": Fractal._hybrid_multifractal,
    "RIDGED_MULTIFRACTAL": Fractal._ridged_multifractal,
}


def noise_texture(
    points: np.ndarray, fractal: Fractal, distortion: np.ndarray | float = 0.0, coloured: bool = False
) -> np.ndarray:
    """(n, 1), or (n, 3) of a colour, at points (n, d), d of 1 to 4. distortion: a number or (n, 1)."""
    points = np.asarray(points, np.float64)
    d = points.shape[1]
    if np.any(distortion):
        moved = [gradient_noise(points + _offset(seed, d)) for seed in range(d)]
        points = points + distortion * np.concatenate(moved, axis=1)
    if not coloured:
        return fractal.at(points)
    return np.concatenate([fractal.at(points + offset) for offset in (0.0, _offset(d, d), _offset(d + 1, d))], axis=1)


def _offset(seed: int, dimensions: int) -> np.ndarray:
    """(d,) between 100 and 200, decorrelates seeds."""
    keys = [(float(seed),)] if dimensions == 1 else [(float(seed), float(axis)) for axis in range(dimensions)]
    return np.concatenate([100.0 + 100.0 * uniform(*key) for key in keys])


def gradient_noise(points: np.ndarray) -> np.ndarray:
    """(n, 1) in about [-1, 1] at points (n, d), d of 1 to 4."""
    # Cycles works in single precision; the lattice cell must be the same.
    points = np.asarray(points, np.float32)
    cell = np.floor(points)
    f = points - cell
    cell = cell.astype(np.int64).astype(np.uint32)
    u = f * f * f * (f * (f * 6.0 - 15.0) + 10.0)
    d = points.shape[1]
    result = np.zeros(len(points), np.float32)
    for corner in itertools.product((0, 1), repeat=d):
        key = lookup3(*(cell + np.array(corner, np.uint32)).T)
        weight = np.where(corner, u, 1.0 - u).prod(axis=1)
        result += weight * SLOPES[d - 1](key, *(f - np.array(corner, np.float32)).T)
    return (RANGE[d - 1] * result)[:, None].astype(np.float64)


# Dot product of the gradient that a hash selects with an offset.


def _signed(h: np.ndarray, bit: int, value: np.ndarray) -> np.ndarray:
    return np.where(h & bit, -value, value)


def _slope_1d(h: np.ndarray, x: np.ndarray) -> np.ndarray:
    return _signed(h, 8, 1.0 + (h & 7)) * x


def _slope_2d(h: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    near = (h & 7) < 4
    return _signed(h, 1, np.where(near, x, y)) + 2.0 * _signed(h, 2, np.where(near, y, x))


def _slope_3d(h: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The twelve edges of a cube, four of them twice."""
    h = h & 15
    u, v = np.where(h < 8, x, y), np.where(h < 4, y, np.where((h == 12) | (h == 14), x, z))
    return _signed(h, 1, u) + _signed(h, 2, v)


def _slope_4d(h: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, w: np.ndarray) -> np.ndarray:
    h = h & 31
    u, v, s = np.where(h < 24, x, y), np.where(h < 16, y, z), np.where(h < 8, z, w)
    return _signed(h, 1, u) + _signed(h, 2, v) + _signed(h, 4, s)


SLOPES = _slope_1d, _slope_2d, _slope_3d, _slope_4d
