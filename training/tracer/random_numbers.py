# SPDX-License-Identifier: GPL-3.0-or-later
"""Counter-based random numbers for numba kernels: splitmix64 (Steele, Lea and Flood 2014).

The state, a uint64, is handed from call to call, so that a path depends on nothing but where its state began, whatever
the number of threads.
"""

import numba
import numpy as np

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1, _MIX2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_U22, _U27, _U30, _U31 = np.uint64(22), np.uint64(27), np.uint64(30), np.uint64(31)
_U40, _U43 = np.uint64(40), np.uint64(43)
_MASK24, _MASK21 = np.uint64(0xFFFFFF), np.uint64(0x1FFFFF)
_TO24, _TO21 = np.float32(2.0**-24), np.float32(2.0**-21)
_HALF = np.float32(0.5)


@numba.njit(cache=True, fastmath=True)
def seed_state(seed, index):
    """The first state, uint64, of item `index` of a run with `seed`."""
    z = np.uint64(seed) * _MIX1 + np.uint64(index) * _MIX2 + _GOLDEN
    z = (z ^ (z >> _U30)) * _MIX1
    z = (z ^ (z >> _U27)) * _MIX2
    return z ^ (z >> _U31)


@numba.njit(cache=True, fastmath=True)
def draw(state):
    """The next state and 64 random bits."""
    state = state + _GOLDEN
    z = (state ^ (state >> _U30)) * _MIX1
    z = (z ^ (z >> _U27)) * _MIX2
    return state, z ^ (z >> _U31)


@numba.njit(cache=True, fastmath=True)
def two_uniforms(bits):
    """Two independent float32 in (0, 1), of 24 bits each."""
    a = (np.float32(np.int32(bits >> _U40)) + _HALF) * _TO24
    b = (np.float32(np.int32(bits & _MASK24)) + _HALF) * _TO24
    return a, b


@numba.njit(cache=True, fastmath=True)
def three_uniforms(bits):
    """Three independent float32 in [0, 1), of 21 bits each."""
    a = np.float32(np.int32(bits >> _U43)) * _TO21
    b = np.float32(np.int32((bits >> _U22) & _MASK21)) * _TO21
    c = np.float32(np.int32(bits & _MASK21)) * _TO21
    return a, b, c
