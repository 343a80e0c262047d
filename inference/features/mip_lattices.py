# SPDX-License-Identifier: GPL-3.0-or-later
"""The density pyramid, and lattices of it that the descriptors read.

Mip m has n = 2^(8 - m) cells along the edge of the cube. Its density is level m of the pyramid. Its lattice extends as
far beyond the cube as the mip's stencil points; density is 0 there.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..grids.halving import halve
from ..grids.working_cube import Cube, extent, mean_density
from ..kernels import structures
from ..kernels.library import call
from ..plan.resolution import LEVEL0_CELLS
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Volume
from .stencil import MIPS, Stencil

# The density feature is log(1 + sigma_hat * density / DENSITY_SCALE).
DENSITY_SCALE = 64.0
# Fine cells of the lookup lattice per cell of a mip, 1 for the finest that is read: a lookup of the nearest fine cell
# replaces a trilinear lookup.
FINE = (1, 2, 2, 2, 4, 8, 16, 16)
# Features are quantized to 16 bits: this many steps up to the largest value.
QUANTA = 65535
# Fine cells that one task builds.
CELLS_PER_TASK = 1 << 21


def density_pyramid(level0: np.ndarray) -> list[np.ndarray]:
    """Levels 0 to 8 by 2 x 2 x 2 means, float32; level m has 2^(8 - m) cells along an edge."""
    levels = [level0]
    while levels[-1].shape[0] > 1:
        levels.append(np.empty([n // 2 for n in levels[-1].shape], np.float32))
        halve(levels[-2], levels[-1])
    return levels


def margins(stencil: Stencil) -> list[int]:
    """Cells that the lattice of each mip needs beyond every face of the cube."""
    # Mips 0 and 1 share field 0, which needs the margin of mip 1.
    return [int(np.ceil(reach * (LEVEL0_CELLS >> m))) + 1 for m, reach in enumerate(stencil.reaches)]


def fine_cells(m: int, stencil: Stencil) -> int:
    """Fine cells per cell of mip m, along an edge."""
    return 1 if m == stencil.finest else FINE[m]


def padded_levels(pyramid: Sequence[np.ndarray], stencil: Stencil) -> list[np.ndarray]:
    """Levels 0 to 7, padded with their margins of zeros."""
    return [np.pad(level, margin) for level, margin in zip(pyramid, margins(stencil))]


def padded_pyramid(volume: Volume, cube: Cube, stencil: Stencil, cancel: CancelToken = NEVER) -> list[np.ndarray]:
    """As `padded_levels` of a volume's density, without copies of the levels, and empty below the finest that is read.

    Raises Cancelled.
    """
    padded = [
        np.zeros(((LEVEL0_CELLS >> m) + 2 * margin if m >= stencil.finest else 0,) * 3, np.float32)
        for m, margin in enumerate(margins(stencil))
    ]
    mean_density(volume, cube, cancel, inner_cells(padded[stencil.finest], stencil.finest, stencil))
    # Of the others, what the volume reaches alone.
    reached = _reached(extent(volume, cube))
    for m in range(stencil.finest + 1, len(padded)):
        cancel.check()
        first, end = reached[0] >> m, -(-reached[1] >> m)
        fine, coarse = (inner_cells(padded[of], of, stencil) for of in (m - 1, m))
        halve(fine[_box(2 * first, 2 * end)], coarse[_box(first, end)])
    return padded


def _reached(extent: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Cells of level 0 that a volume of an extent, as of `density_lattices`, reaches: first (3,), last (3,) + 1."""
    # A cell more on either side, for rounding.
    first, end = np.floor((extent[0] + 0.5) * LEVEL0_CELLS) - 1.0, np.ceil((extent[1] + 0.5) * LEVEL0_CELLS) + 1.0
    return tuple(np.clip(cells, 0, LEVEL0_CELLS).astype(int) for cells in (first, end))


def _box(first: np.ndarray, end: np.ndarray) -> tuple[slice, ...]:
    return tuple(map(slice, first, end))


def inner_cells(padded: np.ndarray, m: int, stencil: Stencil) -> np.ndarray:
    """The cells of level m that lie in the cube, a view of the padded level."""
    return padded[(slice(margins(stencil)[m], -margins(stencil)[m]),) * 3]


@dataclass
class Lattice:
    """A feature of one mip, ready for one lookup per point.

    values: uint16 (sx, sy, sz), at fine-cell centres in quantization steps. origin: cube coordinate of fine cell 0, the
    same on every axis. scale: fine cells per cube edge. first: int (3,), the fine cell at values[0, 0, 0].
    """

    values: np.ndarray
    origin: float
    scale: float
    first: np.ndarray


@dataclass
class Lattices:
    """Lattices of mips 0 to 7.

    values: of all lattices, one after another. step: of their quantization.
    """

    values: np.ndarray
    levels: list[Lattice]
    step: np.float32

    def read(self, index: np.ndarray, features: np.ndarray) -> None:
        """Fill features, float32 (N, k); index: (N, k), into `values`."""
        # The lattices contain every cell that a stencil can read; clipping is cheaper than checking.
        features[...] = self.values.take(index, mode="clip")
        features *= self.step


class ThinnerLattices(Lattices):
    """Lattices of the density feature, read for a fraction of the optical thickness for which they were built."""

    def __init__(self, built: Lattices, fraction: float):
        super().__init__(built.values, built.levels, built.step)
        self.built, self.fraction = built, np.float32(fraction)

    def read(self, index: np.ndarray, features: np.ndarray) -> None:
        """As of Lattices."""
        super().read(index, features)
        np.expm1(features, out=features)
        features *= self.fraction
        np.log1p(features, out=features)


def _fine_span(m: int, stencil: Stencil, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fine cells of mip m that stencils around points from low to high (3,) can read: first, last + 1."""
    if m < stencil.finest:
        return np.zeros(3, int), np.zeros(3, int)
    fine = fine_cells(m, stencil)
    margin, reach, scale = margins(stencil)[m], stencil.reaches[m], (LEVEL0_CELLS >> m) * fine
    cells = scale + 2 * margin * fine
    # A cell more on either side, for rounding.
    first = np.floor((low - reach + 0.5) * scale).astype(int) + margin * fine - 1
    last = np.floor((high + reach + 0.5) * scale).astype(int) + margin * fine + 2
    return np.clip(first, 0, cells - 1), np.clip(last, 1, cells)


@dataclass(frozen=True)
class Between:
    """Where fine cells lie between the cells of a grid, along each axis.

    below: int32, the cell below each fine cell. fraction: float32, of the way to the next cell.
    """

    below: list[np.ndarray]
    fraction: list[np.ndarray]

    @classmethod
    def of(cls, centres: Sequence[np.ndarray], shape: Sequence[int]) -> "Between":
        """From centres of fine cells, in cells of the grid, whose centres are integers; clamped at the border."""
        below, fraction = [], []
        for position, count in zip(centres, shape):
            # Round, so that fine centres that coincide with a cell's centre do so exactly.
            position = np.clip(np.round(position, 6), 0.0, count - 1.0)
            below.append(np.minimum(position.astype(np.int32), count - 2))
            fraction.append((position - below[-1]).astype(np.float32))
        return cls(below, fraction)

    def described(self, grid: np.ndarray) -> structures.Shared:
        """For the kernel."""
        return structures.Refinement(
            values=np.ascontiguousarray(grid, np.float32),
            shape=np.array(grid.shape),
            below=tuple(self.below),
            fraction=tuple(self.fraction),
        )


@dataclass(frozen=True)
class FineCells:
    """Centres of some fine cells of a mip's lattice; centres: along each axis, in cube edges from the cube's corner."""

    mip: int
    centres: list[np.ndarray]
    stencil: Stencil

    def between(self, mip: int) -> Between:
        """Where they lie between the cells of the padded level of a mip."""
        cells, margin = LEVEL0_CELLS >> mip, margins(self.stencil)[mip]
        return Between.of([centre * cells + margin - 0.5 for centre in self.centres], [cells + 2 * margin] * 3)


#: What `fill_lattice` fills fine cells from: fields of its structure by name.
Filling = Callable[[FineCells], dict[str, Any]]


def fill_lattices(
    stencil: Stencil,
    extent: tuple[np.ndarray | float, np.ndarray | float],
    step: np.float32,
    filling: Filling,
    mapper: Callable[..., Iterable[None]] = map,
) -> Lattices:
    """Lattices of mips 0 to 7, in quantization steps.

    extent: lowest and highest (3,), in the cube's frame, of the points to describe; cells beyond the reach of their
    stencils are not built. mapper: `map`, or `Tasks.each` for several threads.
    """
    margin = margins(stencil)
    low, high = (np.broadcast_to(end, 3) for end in extent)
    spans = [_fine_span(m, stencil, low, high) for m in range(MIPS)]
    ends = np.cumsum([np.prod(last - first) for first, last in spans])
    values = np.empty(ends[-1], np.uint16)
    levels = [
        Lattice(
            values[end - np.prod(last - first) : end].reshape(last - first),
            -0.5 - margin[m] / (LEVEL0_CELLS >> m),
            float((LEVEL0_CELLS >> m) * fine_cells(m, stencil)),
            first,
        )
        for m, (end, (first, last)) in enumerate(zip(ends, spans))
    ]

    def build(m: int, start: int) -> None:
        """Planes of a mip from `start` on."""
        n, (first, last) = LEVEL0_CELLS >> m, spans[m]
        block = levels[m].values[start : start + planes[m]]
        centres = [(np.arange(a, b) + 0.5) / (n * fine_cells(m, stencil)) - margin[m] / n for a, b in zip(first, last)]
        centres[0] = centres[0][start : start + planes[m]]
        most = max((LEVEL0_CELLS >> of) + 2 * margin[of] for of in (m, max(m, 1)))
        scratch = np.empty(2 * block.shape[2] + most, np.float32)
        fields = filling(FineCells(m, centres, stencil))
        call("fill_lattice", shape=np.array(block.shape), packed=block, scratch=scratch, **fields)

    # Small blocks, so that a cancelled render ends soon.
    read = range(stencil.finest, MIPS)
    planes = {m: max(CELLS_PER_TASK // levels[m].values[0].size, 1) for m in read}
    tasks = [(m, start) for m in read for start in range(0, len(levels[m].values), planes[m])]
    list(mapper(lambda task: build(*task), tasks))
    return Lattices(values, levels, step)


def density_lattices(
    padded: Sequence[np.ndarray],
    sigma_hat: float,
    stencil: Stencil,
    extent: tuple[np.ndarray | float, np.ndarray | float] = (-0.5, 0.5),
    mapper: Callable[..., Iterable[None]] = map,
) -> Lattices:
    """Lattices of the density feature for one optical thickness.

    padded: from `padded_pyramid`. sigma_hat: extinction per unit density times the cube's edge. extent, mapper: as for
    `fill_lattices`. Density is interpolated before taking the logarithm.
    """
    scale = np.float32(sigma_hat / DENSITY_SCALE)
    # No mean exceeds the largest of its terms.
    step = max(np.log(np.float32(1.0) + scale * padded[stencil.finest].max()) / np.float32(QUANTA), np.float32(1e-12))

    def filling(cells: FineCells) -> dict[str, Any]:
        density = cells.between(cells.mip).described(padded[cells.mip])
        return {"density": density, "density_scale": float(scale), "density_step": float(step)}

    return fill_lattices(stencil, extent, step, filling, mapper)
