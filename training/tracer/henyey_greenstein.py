# SPDX-License-Identifier: GPL-3.0-or-later
"""Henyey-Greenstein's phase function in numba: evaluation and importance sampling."""

import math

import numba
import numpy as np

from .random_numbers import draw, two_uniforms

_F0, _F1, _F2 = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_TINY = np.float32(1e-9)
_INV_4PI = np.float32(0.25 / np.pi)


@numba.njit(cache=True, fastmath=True)
def phase_hg(cosine, g):
    """Phase function, 1/sr, of the cosine between the directions of light before and after."""
    d = _F1 + g * g - _F2 * g * cosine
    return _INV_4PI * (_F1 - g * g) / (d * math.sqrt(d))


@numba.njit(cache=True, fastmath=True)
def scatter(dx, dy, dz, g, state):
    """Sample a direction from the phase function around (dx, dy, dz): (x, y, z, state)."""
    state, bits = draw(state)
    u, _ = two_uniforms(bits)
    if abs(g) < np.float32(1e-3):
        cosine = _F1 - _F2 * u
    else:
        s = (_F1 - g * g) / (_F1 - g + _F2 * g * u)
        cosine = (_F1 + g * g - s * s) / (_F2 * g)
    return turn(dx, dy, dz, min(max(cosine, -_F1), _F1), state)


@numba.njit(cache=True, fastmath=True)
def turn(dx, dy, dz, cosine, state):
    """A direction at an angle of given cosine to (dx, dy, dz), of random azimuth: (x, y, z, state)."""
    sine = math.sqrt(_F1 - cosine * cosine)
    # Azimuth without trigonometry: a uniform point of the disc, projected to its rim.
    while True:
        state, bits = draw(state)
        a, b = two_uniforms(bits)
        a, b = _F2 * a - _F1, _F2 * b - _F1
        square = a * a + b * b
        if square <= _F1 and square > _TINY:
            break
    scale = sine / math.sqrt(square)
    a, b = a * scale, b * scale
    # Orthonormal basis around the direction (Duff et al. 2017).
    sign = _F1 if dz >= _F0 else -_F1
    p = -_F1 / (sign + dz)
    q = dx * dy * p
    x = a * (_F1 + sign * dx * dx * p) + b * q + cosine * dx
    y = a * sign * q + b * (sign + dy * dy * p) + cosine * dy
    z = -a * sign * dx - b * dy + cosine * dz
    length = _F1 / math.sqrt(x * x + y * y + z * z)
    return x * length, y * length, z * length, state
