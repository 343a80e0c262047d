# SPDX-License-Identifier: GPL-3.0-or-later
"""Random numbers and directions of many paths at once; the twin of inference/kernels/random.h."""

import numpy as np

#: Powers of the reciprocal of the plastic number: multiples of them, less their whole parts, are spread evenly over a
#: square (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018).
PLASTIC = np.array([0.7548776662466927, 0.5698402909980532])
# Of the generator (Steele, Lea and Flood, "Fast Splittable Pseudorandom Number Generators", 2014).
_GOLDEN, _FIRST, _SECOND = (np.uint64(n) for n in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))


class PathRandom:
    """Random numbers of N paths, each with a sequence of its own, which its number tells.

    numbers: int64 (N,).
    """

    def __init__(self, numbers: np.ndarray):
        self._states = _mixed((numbers + 1).astype(np.uint64) * _GOLDEN)

    def bits(self, which: np.ndarray) -> np.ndarray:
        """The next 64 bits of some paths, uint64."""
        self._states[which] += _GOLDEN
        return _mixed(self._states[which])

    def draw(self, which: np.ndarray) -> np.ndarray:
        """The next numbers of some paths, in [0, 1)."""
        return (self.bits(which) >> np.uint64(11)).astype(np.float64) * 2.0**-53


def _mixed(x: np.ndarray) -> np.ndarray:
    x = (x ^ (x >> np.uint64(30))) * _FIRST
    x = (x ^ (x >> np.uint64(27))) * _SECOND
    return x ^ (x >> np.uint64(31))


def turned(along: np.ndarray, cosine: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3) turned by angles of a cosine (N,), about themselves by other angles (N,)."""
    sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
    x, y, z = along.T
    # A frame without a case to tell apart (Duff et al., "Building an Orthonormal Basis, Revisited", 2017).
    sign = np.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y * y * a, -y], axis=1)
    aside = (sine * np.cos(angle))[:, None] * first + (sine * np.sin(angle))[:, None] * second
    return aside + cosine[:, None] * along


def scattering_cosine(anisotropy: np.ndarray | float, u: np.ndarray) -> np.ndarray:
    """Cosines (N,) of angles of Henyey and Greenstein's phase function of mean cosines (N,); u: (N,) in [0, 1)."""
    peaked = np.abs(anisotropy) > 1e-4
    g = np.where(peaked, anisotropy, 0.5)
    root = (1.0 - g * g) / (1.0 - g + 2.0 * g * u)
    return np.where(peaked, (1.0 + g * g - root * root) / (2.0 * g), 1.0 - 2.0 * u)
