# SPDX-License-Identifier: GPL-3.0-or-later
"""The density that the tracer marches through, and its majorant grid.

Positions are in cells: [0, N]^3 is the cube, cell (i, j, k) has its centre at (i, j, k) + 0.5. Density is trilinear
between cell centres and 0 outside the cube.
"""

from typing import NamedTuple

import numba
import numpy as np

from .random_numbers import draw, three_uniforms

#: Edge of a block of the majorant grid, in cells.
BLOCK = 8

_HALF = np.float32(0.5)


class DensityGrid(NamedTuple):
    """A cubic density ready for tracking; numba kernels take it as it is.

    padded: float32 (N + 2, N + 2, N + 2), the cells with a layer of zeros around them.
    majorant: float32 (B, B, B), upper bound of the trilinear density in blocks of BLOCK cells.
    """

    padded: np.ndarray
    majorant: np.ndarray

    @property
    def cells(self) -> int:
        """N, cells per cube edge."""
        return self.padded.shape[0] - 2


def prepare(density) -> DensityGrid:
    """Pad a density (N, N, N) and bound it by blocks; a DensityGrid passes through.

    Raises ValueError where the grid is not cubic, not finite or negative.
    """
    if isinstance(density, DensityGrid):
        return density
    density = np.asarray(density, np.float32)
    if density.ndim != 3 or len(set(density.shape)) != 1:
        raise ValueError(f"density must be a cube of cells, not {density.shape}")
    if not (np.isfinite(density.min()) and np.isfinite(density.max())) or density.min() < 0:
        raise ValueError("density must be finite and not negative")
    padded = np.pad(density, 1)
    blocks = -(-density.shape[0] // BLOCK)
    # Interpolation in block b reads padded cells b * BLOCK to b * BLOCK + BLOCK + 1, both included.
    bound = padded
    for axis in range(3):
        bound = np.moveaxis(bound, axis, 0)
        slabs = [bound[b * BLOCK : b * BLOCK + BLOCK + 2].max(axis=0) for b in range(blocks)]
        bound = np.moveaxis(np.stack(slabs), 0, axis)
    # Rounding must never lift the interpolated density above its bound.
    return DensityGrid(padded, np.ascontiguousarray(bound * np.float32(1 + 1e-6)))


@numba.njit(cache=True, fastmath=True)
def interpolate(x, y, z, padded):
    """Trilinear density at a position in cells."""
    i, j, k = int(x + _HALF), int(y + _HALF), int(z + _HALF)
    u, v, w = x + _HALF - np.float32(i), y + _HALF - np.float32(j), z + _HALF - np.float32(k)
    a = padded[i, j, k] + w * (padded[i, j, k + 1] - padded[i, j, k])
    b = padded[i, j + 1, k] + w * (padded[i, j + 1, k + 1] - padded[i, j + 1, k])
    c = padded[i + 1, j, k] + w * (padded[i + 1, j, k + 1] - padded[i + 1, j, k])
    d = padded[i + 1, j + 1, k] + w * (padded[i + 1, j + 1, k + 1] - padded[i + 1, j + 1, k])
    a += v * (b - a)
    c += v * (d - c)
    return a + u * (c - a)


@numba.njit(cache=True, fastmath=True)
def stochastic_density(x, y, z, padded, state):
    """Density at one of the eight cells around a position, chosen with its trilinear weight; and the next state.

    Its expectation is the trilinear density and tracking is linear in the density: one read instead of eight, unbiased.
    """
    state, bits = draw(state)
    a, b, c = three_uniforms(bits)
    return padded[int(x + _HALF + a), int(y + _HALF + b), int(z + _HALF + c)], state
