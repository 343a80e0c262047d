# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that arrives at the points of a grid along one direction, in one sweep for all of them.

Parallel rays are marched together, slice by slice across the axis that they follow most. Slices are sheared to the rays
and back, so that interpolation never accumulates.
"""

import numpy as np

# Scales of extinction: forward scattering reaches further than direct light.
SCALES = (1.0, 0.334)


def light_ahead(
    extinction: np.ndarray, sources: np.ndarray, index_direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Integrals of exp(-a tau) S a d(tau) ahead of each point, for each scale a of SCALES, and exp(-tau).

    extinction: float32 (nx, ny, nz) per world unit. sources: float32 (K, nx, ny, nz), S. index_direction: (3,),
    d(index)/d(length) along rays. tau: optical depth from the point. Returns float32 (K, A, nx, ny, nz) and (nx, ny,
    nz).
    """
    main = int(np.abs(index_direction).argmax())
    values = np.moveaxis(np.concatenate([extinction[None], sources]), main + 1, 0)
    count = len(values)
    slopes = np.delete(index_direction, main) / index_direction[main]
    half = np.float32(-0.5 / abs(index_direction[main]))
    scales = np.array(SCALES, np.float32)[:, None, None] * half
    # Places of the first cells of each slice among the rays.
    offsets = -np.arange(count)[:, None] * slopes
    offsets -= np.floor(offsets.min(axis=0))
    firsts = offsets.astype(int)
    size = values.shape[2:] + firsts.max(axis=0) + 1
    rays = np.zeros((len(sources), len(SCALES), *size), np.float32)
    clear = np.ones(size, np.float32)
    found = np.empty((count, len(sources), len(SCALES), *values.shape[2:]), np.float32)
    through = np.empty((count, *values.shape[2:]), np.float32)
    for k in range(count)[:: -1 if index_direction[main] > 0 else 1]:
        fractions = (offsets[k] - firsts[k]).astype(np.float32)
        here, there = (slice(first, first + n + 1) for first, n in zip(firsts[k], values.shape[2:]))
        dense, *emitted = _to_rays(values[k], fractions)
        share, source = np.exp(scales * dense), np.array(emitted)[:, None]
        light = rays[..., here, there]
        light -= source
        light *= share
        found[k] = _to_cells(light + source, fractions)
        light *= share
        light += source
        clear[here, there] *= share[0]
        through[k] = _to_cells(clear[here, there], fractions)
        clear[here, there] *= share[0]
    return np.moveaxis(found, 0, main + 2), np.moveaxis(through, 0, main)


def _to_rays(values: np.ndarray, fractions: np.ndarray) -> np.ndarray:
    """Values (..., ny, nz) of cells at rays (..., ny + 1, nz + 1), which lie by fractions (2,) before them."""
    f, g = fractions
    wide = np.zeros((*values.shape[:-1], values.shape[-1] + 1), np.float32)
    wide[..., :-1] = (1 - g) * values
    wide[..., 1:] += g * values
    found = np.zeros((*values.shape[:-2], values.shape[-2] + 1, wide.shape[-1]), np.float32)
    found[..., :-1, :] = (1 - f) * wide
    found[..., 1:, :] += f * wide
    return found


def _to_cells(values: np.ndarray, fractions: np.ndarray) -> np.ndarray:
    """Values (..., ny + 1, nz + 1) of rays at cells (..., ny, nz), which lie by fractions (2,) behind them."""
    f, g = fractions
    narrow = (1 - f) * values[..., :-1, :] + f * values[..., 1:, :]
    found: np.ndarray = (1 - g) * narrow[..., :-1] + g * narrow[..., 1:]
    return found
