"""What the descriptors read: the density pyramid and the scaled transmittance fields.

Mip m has n = 2^(8 - m) cells along the cube's edge. Its density is level m of the
pyramid; its transmittance is field i = max(m - 1, 0), which integrates through level
i + 1. Both are kept on a lattice that reaches as far beyond the cube as the mip's stencil
points do: density is 0 there, and the optical depth towards the sun through the cube is
what A.3's redirection to the boundary would give.
"""

from dataclasses import dataclass
from typing import List

import numpy as np

from .stencil import LEVEL0_CELLS, MIPS, Stencil
from .transmittance import sun_optical_depth

# beta of the scaled transmittance: field i holds exp(-beta^(i + 1) tau).
BETA = 0.578
# Density features are log(1 + sigma_hat * density / 64).
DENSITY_SCALE = 64.0
# Cells of the lookup lattice per cell of a mip: one lookup of the nearest fine cell stands
# for a trilinear one.
FINE = (1, 2, 2, 2, 4, 8, 16, 16)


def density_pyramid(level0: np.ndarray) -> List[np.ndarray]:
    """Levels 0..8 by 2x2x2 means, float32; level m has 2^(8 - m) cells along an edge."""
    levels = [level0]
    while levels[-1].shape[0] > 1:
        fine = levels[-1]
        pairs = fine[0::2] + fine[1::2]
        pairs = pairs[:, 0::2] + pairs[:, 1::2]
        levels.append((pairs[:, :, 0::2] + pairs[:, :, 1::2]) * np.float32(0.125))
    return levels


def margins(stencil: Stencil) -> List[int]:
    """Cells that each mip's lattice needs beyond every face of the cube."""
    cells = [LEVEL0_CELLS >> m for m in range(MIPS)]
    reach = [stencil.reach(m) for m in range(MIPS)]
    # Mips 0 and 1 share field 0, which needs mip 1's margin.
    return [int(np.ceil(r * n)) + 1 for r, n in zip(reach, cells)]


def padded_levels(pyramid: List[np.ndarray], stencil: Stencil) -> List[np.ndarray]:
    """Levels 0..7 with their margins of zeros."""
    return [np.pad(level, margin) for level, margin in zip(pyramid, margins(stencil))]


def unit_optical_depths(padded: List[np.ndarray], direction: np.ndarray) -> List[np.ndarray]:
    """Optical depth towards the sun through levels 1..7 for sigma_hat = 1, on the padded lattices.

    direction: (3,) unit vector towards the sun in the cube's frame.
    """
    return [
        sun_optical_depth(level, direction, step_length=1.0 / (LEVEL0_CELLS >> m))
        for m, level in enumerate(padded[1:], start=1)
    ]


@dataclass
class Lattice:
    """Features of one mip, ready for one lookup a point.

    packed: complex64 (s, s, s); real part the density feature, imaginary part the scaled
        transmittance, at fine-cell centres.
    origin: cube coordinate of the lattice's lower corner, the same on every axis.
    scale: fine cells per cube edge.
    """

    packed: np.ndarray
    origin: float
    scale: float


def _refine(grid: np.ndarray, factor: int, cells: np.ndarray) -> np.ndarray:
    """Linear interpolation at the centres of fine cells, separably; clamped at the rim.

    cells: (s,) positions of fine-cell centres in cells of the grid, centres at integers.
    """
    if factor == 1 and cells.size == grid.shape[0]:
        return grid
    n = grid.shape[0]
    position = np.clip(cells, 0.0, n - 1.0)
    below = np.minimum(position.astype(int), n - 2)
    weights = np.zeros((cells.size, n), np.float32)
    rows = np.arange(cells.size)
    weights[rows, below] = 1.0 - (position - below)
    weights[rows, below + 1] = position - below
    # One matrix product an axis, none of which moves the grid in memory.
    grid = (weights @ grid.reshape(n, -1)).reshape(-1, n, n)
    return np.matmul(np.matmul(weights, grid), weights.T)


def fine_centres(m: int, margin: int, n_from: int, margin_from: int) -> np.ndarray:
    """Centres of mip m's fine cells, in cells of a lattice with n_from cells along the cube's edge."""
    n, factor = LEVEL0_CELLS >> m, FINE[m]
    count = (n + 2 * margin) * factor
    cube = (np.arange(count) + 0.5) / (n * factor) - margin / n
    return cube * n_from + margin_from - 0.5


def build_lattices(padded, unit_depths, sigma_hat: float, stencil: Stencil, mapper=map) -> List[Lattice]:
    """Lattices of mips 0..7 for one optical density and one sun.

    padded: from `padded_levels`; unit_depths: from `unit_optical_depths`. The density is
    interpolated before the logarithm and the optical depth before the exponential.
    mapper: `map`, or an executor's, to build mips side by side.
    """
    margin = margins(stencil)

    def build(m: int) -> Lattice:
        n, source = LEVEL0_CELLS >> m, max(m, 1)
        feature = _refine(padded[m], FINE[m], fine_centres(m, margin[m], n, margin[m]))
        # Level 0 is not refined and must not be written to.
        feature = np.multiply(feature, np.float32(sigma_hat / DENSITY_SCALE), out=None if FINE[m] == 1 else feature)
        packed = np.empty(feature.shape, np.complex64)
        packed.real = np.log1p(feature, out=feature)
        centres = fine_centres(m, margin[m], LEVEL0_CELLS >> source, margin[source])
        feature = _refine(unit_depths[source - 1], 2, centres)
        feature *= np.float32(-sigma_hat * BETA**source)
        packed.imag = np.exp(feature, out=feature)
        return Lattice(packed, -0.5 - margin[m] / n, float(n * FINE[m]))

    return list(mapper(build, range(MIPS)))
