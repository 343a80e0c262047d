# SPDX-License-Identifier: GPL-3.0-or-later
"""Hash functions that textures draw their random numbers from.

Bob Jenkins' lookup3 of the bits of numbers, and the PCG hashes of vectors of integers (Jarzynski and Olano, Hash
Functions for GPU Rendering, JCGT 2020) in signed arithmetic.
"""

from typing import Any

import numpy as np

FACTOR, STEP = np.int32(1664525), np.int32(1013904223)


def lookup3(*keys: np.ndarray) -> np.ndarray:
    """uint32 (n,): lookup3 of one to four uint32 arrays (n,)."""
    start = np.uint32((0xDEADBEEF + (len(keys) << 2) + 13) & 0xFFFFFFFF)
    state = dict.fromkeys("abc", np.full(np.broadcast_shapes(*(key.shape for key in keys)), start))
    if len(keys) == 4:
        state = {name: state[name] + key for name, key in zip("abc", keys)}
        for turned, taken, added, bits in (
            ("a", "c", "b", 4),
            ("b", "a", "c", 6),
            ("c", "b", "a", 8),
            ("a", "c", "b", 16),
            ("b", "a", "c", 19),
            ("c", "b", "a", 4),
        ):
            state[turned] = (state[turned] - state[taken]) ^ _rotated(state[taken], bits)
            state[taken] = state[taken] + state[added]
        keys = keys[3:]
    state.update({name: state[name] + key for name, key in zip("abc", keys)})
    for turned, taken, bits in zip("cabcabc", "bcabcab", (14, 11, 25, 16, 4, 14, 24)):
        state[turned] = (state[turned] ^ state[taken]) - _rotated(state[taken], bits)
    return state["c"]


def _rotated(value: np.ndarray, bits: int) -> np.ndarray:
    return (value << np.uint32(bits)) | (value >> np.uint32(32 - bits))


def uniform(*numbers: Any) -> np.ndarray:
    """float64 (n,) in [0, 1] from the bits of one to four numbers, arrays (n,) or scalars."""
    keys = [np.atleast_1d(np.asarray(number, np.float32)).view(np.uint32) for number in numbers]
    return lookup3(*keys) / np.float64(0xFFFFFFFF)


def uniform_colour(*numbers: Any) -> np.ndarray:
    """float64 (n, 3) in [0, 1] from one to four numbers, as `uniform`."""
    if len(numbers) == 4:
        x, y, z, w = numbers
        keys = [(x, y, z, w), (z, x, w, y), (w, z, y, x)]
    else:
        keys = [numbers, (*numbers, 1.0), (*numbers, 2.0)]
    return np.stack([uniform(*key) for key in keys], axis=1)


def uniform_pair(*numbers: Any) -> np.ndarray:
    """float64 (n, 2) in [0, 1] from three or four numbers, as `uniform`."""
    x, y, z, *w = numbers
    return np.stack([uniform(*numbers), uniform(z, x, *w, y)], axis=1)


def cell_point(cell: np.ndarray, pcg: bool) -> np.ndarray:
    """(n, d) in [0, 1] for lattice cells (n, d), d of 1 to 4. pcg: which hash, where d is above 1."""
    d = cell.shape[1]
    if d > 1 and pcg:
        return _pcg(cell)
    if d == 4:
        return np.stack([uniform(*np.roll(cell, turn, axis=1).T) for turn in range(4)], axis=1)
    numbers = cell.T
    return np.stack([uniform(*numbers, *extra) for extra in ((), (1.0,), (2.0,))[:d]], axis=1)


def cell_colour(cell: np.ndarray, pcg: bool) -> np.ndarray:
    """(n, 3) in [0, 1] for lattice cells, as `cell_point`."""
    if cell.shape[1] == 1 or not pcg:
        return uniform_colour(*cell.T)
    if cell.shape[1] == 2:
        cell = np.concatenate([cell, np.zeros((len(cell), 1), cell.dtype)], axis=1)
    return _pcg(cell)[:, :3]


def _pcg(cells: np.ndarray) -> np.ndarray:
    """float32 (n, k) in [0, 1] from integers (n, k), for k of 2, 3 or 4."""
    v = list((cells.astype(np.int32) * FACTOR + STEP).T)
    _stir(v)
    v = [part ^ (part >> np.int32(16)) for part in v]
    _stir(v)
    return np.stack([(part & np.int32(0x7FFFFFFF)).astype(np.float32) for part in v], axis=1) * np.float32(2.0**-31)


def _stir(v: list) -> None:
    if len(v) == 2:
        v[0] = v[0] + v[1] * FACTOR
        v[1] = v[1] + v[0] * FACTOR
    elif len(v) == 3:
        v[0] = v[0] + v[1] * v[2]
        v[1] = v[1] + v[2] * v[0]
        v[2] = v[2] + v[0] * v[1]
    else:
        v[0] = v[0] + v[1] * v[3]
        v[1] = v[1] + v[2] * v[0]
        v[2] = v[2] + v[0] * v[1]
        v[3] = v[3] + v[1] * v[2]
