# SPDX-License-Identifier: GPL-3.0-or-later
"""The density pyramid and the scaled transmittance fields, which the descriptors read.

Mip m has n = 2^(8 - m) cells along the edge of the cube. Its density is level m of the pyramid; its transmittance is
field i = max(m - 1, 0), which integrates through level i + 1. Both are stored on a lattice that extends as far beyond
the cube as the mip's stencil points: density is 0 there, and the optical depth towards the sun through the cube equals
that of the redirection to the boundary in appendix A.3 of the paper.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..grids.halving import halve
from ..grids.optical_depth_sweep import sun_optical_depth
from ..grids.working_cube import Cube, level0_density
from ..kernels import structures
from ..kernels.library import call
from ..occluders.shadow_map import ShadowMap
from ..plan.resolution import LEVEL0_CELLS
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Volume
from .stencil import MIPS, Stencil

# beta of the scaled transmittance: field i stores exp(-beta^(i + 1) tau).
BETA = 0.578
# The density feature is log(1 + sigma_hat * density / DENSITY_SCALE).
DENSITY_SCALE = 64.0
# Fine cells of the lookup lattice per cell of a mip: a lookup of the nearest fine cell replaces a trilinear lookup.
FINE = (1, 2, 2, 2, 4, 8, 16, 16)
# Features are quantized to 16 bits: this many steps up to the largest value.
QUANTA = 65535
# Fine cells that one task builds.
CELLS_PER_TASK = 1 << 21
# Optical depth that stands for the shadow of surfaces in the scaled transmittance: no volume that the network was
# trained on makes its wider fields black.
MAX_SHADOW_DEPTH = 10.0
# Sample points along an edge of a cell of levels 1 to 7 for the visibility of the sun.
VISIBILITY_SAMPLES = (1, 1, 1, 2, 4, 4, 4)


def density_pyramid(level0: np.ndarray) -> list[np.ndarray]:
    """Levels 0 to 8 by 2 x 2 x 2 means, float32; level m has 2^(8 - m) cells along an edge."""
    levels = [level0]
    while levels[-1].shape[0] > 1:
        levels.append(np.empty([n // 2 for n in levels[-1].shape], np.float32))
        halve(levels[-2], levels[-1])
    return levels


def margins(stencil: Stencil) -> list[int]:
    """Cells that the lattice of each mip needs beyond every face of the cube."""
    cells = [LEVEL0_CELLS >> m for m in range(MIPS)]
    reach = [stencil.reach(m) for m in range(MIPS)]
    # Mips 0 and 1 share field 0, which needs the margin of mip 1.
    return [int(np.ceil(r * n)) + 1 for r, n in zip(reach, cells)]


def padded_levels(pyramid: Sequence[np.ndarray], stencil: Stencil) -> list[np.ndarray]:
    """Levels 0 to 7, padded with their margins of zeros."""
    return [np.pad(level, margin) for level, margin in zip(pyramid, margins(stencil))]


def padded_pyramid(volume: Volume, cube: Cube, stencil: Stencil, cancel: CancelToken = NEVER) -> list[np.ndarray]:
    """As `padded_levels` of a volume's density, without copies of the levels. Raises Cancelled."""
    padded = [
        np.zeros(((LEVEL0_CELLS >> m) + 2 * margin,) * 3, np.float32) for m, margin in enumerate(margins(stencil))
    ]
    levels = [inner_cells(values, m, stencil) for m, values in enumerate(padded)]
    level0_density(volume, cube, cancel, levels[0])
    for fine, coarse in zip(levels[:-1], levels[1:]):
        cancel.check()
        halve(fine, coarse)
    return padded


def inner_cells(padded: np.ndarray, m: int, stencil: Stencil) -> np.ndarray:
    """The cells of level m that lie in the cube, a view of the padded level."""
    return padded[(slice(margins(stencil)[m], -margins(stencil)[m]),) * 3]


def unit_optical_depths(padded: Sequence[np.ndarray], direction: np.ndarray) -> list[np.ndarray]:
    """Optical depth towards the sun through levels 1 to 7 for sigma_hat = 1, on the padded lattices.

    direction: (3,) unit vector towards the sun in the cube's frame.
    """
    return [
        sun_optical_depth(level, direction, 1.0 / (LEVEL0_CELLS >> m)) for m, level in enumerate(padded[1:], start=1)
    ]


def visibility_levels(stencil: Stencil, shadow_map: ShadowMap) -> list[np.ndarray]:
    """Visibility of the sun in the cells of levels 1 to 7, on the padded lattices.

    shadow_map: in the cube's frame.
    """
    return [
        shadow_map.cell_visibility(LEVEL0_CELLS >> m, margin, samples)
        for m, (margin, samples) in enumerate(zip(margins(stencil)[1:], VISIBILITY_SAMPLES), start=1)
    ]


@dataclass
class Lattice:
    """Features of one mip, ready for one lookup per point.

    packed: uint16 (sx, sy, sz), density feature at fine-cell centres in quantization steps; or uint32 with that in the
    lower half and the scaled transmittance in the upper half. origin: cube coordinate of fine cell 0, the same on every
    axis. scale: fine cells per cube edge. first: int (3,), the fine cell at packed[0, 0, 0].
    """

    packed: np.ndarray
    origin: float
    scale: float
    first: np.ndarray


@dataclass
class Lattices:
    """Lattices of mips 0 to 7.

    values: packed values of all lattices, one after another. density_step: quantization step of the density feature;
    the step of the transmittance is 1 / QUANTA.
    """

    values: np.ndarray
    levels: list[Lattice]
    density_step: np.float32

    @property
    def columns(self) -> int:
        """Features per cell: 1 for density alone, or 2."""
        return self.values.itemsize // 2

    def read(self, index: np.ndarray, features: np.ndarray) -> None:
        """Fill features, float32 (N, k, columns), with density and, if stored, transmittance.

        index: (N, k), into `values`.
        """
        # The lattices contain every cell that a stencil can read; clipping is cheaper than checking.
        steps = self.values.take(index, mode="clip").view(np.uint16)
        features = features.reshape(steps.shape)
        features[...] = steps
        if self.columns == 1:
            features *= self.density_step
        else:
            features *= np.tile(np.array([self.density_step, 1.0 / QUANTA], np.float32), index.shape[1])


def _fine_span(m: int, stencil: Stencil, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fine cells of mip m that stencils around points from low to high (3,) can read: first, last + 1."""
    margin, reach, scale = margins(stencil)[m], stencil.reach(m), (LEVEL0_CELLS >> m) * FINE[m]
    cells = scale + 2 * margin * FINE[m]
    # A cell more on either side, for rounding.
    first = np.floor((low - reach + 0.5) * scale).astype(int) + margin * FINE[m] - 1
    last = np.floor((high + reach + 0.5) * scale).astype(int) + margin * FINE[m] + 2
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

    def described(self, grid: np.ndarray | None) -> structures.Shared:
        """For the kernel; empty for None."""
        if grid is None:
            return structures.Refinement()
        return structures.Refinement(
            values=np.ascontiguousarray(grid, np.float32),
            shape=np.array(grid.shape),
            below=tuple(self.below),
            fraction=tuple(self.fraction),
        )


@dataclass(frozen=True)
class SunLevels:
    """Light of one sun on levels 1 to 7 of the padded pyramid.

    unit_depths: from `unit_optical_depths`. visibility: from `visibility_levels`, or None if no surface shadows the
    cube.
    """

    unit_depths: list[np.ndarray]
    visibility: list[np.ndarray] | None = None


def build_lattices(
    padded: Sequence[np.ndarray],
    sigma_hat: float,
    stencil: Stencil,
    sun: SunLevels | None = None,
    bounds: tuple[np.ndarray | float, np.ndarray | float] = (-0.5, 0.5),
    mapper: Callable[..., Iterable[None]] = map,
    earlier: Lattices | None = None,
) -> Lattices:
    """Lattices of mips 0 to 7 for one optical thickness and one sun.

    padded: from `padded_levels`. sigma_hat: extinction per unit density times the cube's edge. sun: None for lattices
    of the density alone, which serve every sun. bounds: lowest and highest (3,), in the cube's frame, of the points to
    describe; cells beyond the reach of their stencils are not built. mapper: `map`, or `Tasks.each` for several
    threads. earlier: Lattices of another sun with otherwise equal arguments, whose density is reused.

    Density is interpolated before taking the logarithm, and optical depth before the exponential.
    """
    margin = margins(stencil)
    low, high = (np.broadcast_to(end, 3) for end in bounds)

    spans = [_fine_span(m, stencil, low, high) for m in range(MIPS)]
    ends = np.cumsum([np.prod(last - first) for first, last in spans])
    values = earlier.values.copy() if earlier else np.empty(ends[-1], np.uint16 if sun is None else np.uint32)

    packed = [
        values[end - np.prod(last - first) : end].reshape(last - first) for end, (first, last) in zip(ends, spans)
    ]
    # No mean exceeds the largest of its terms.
    scale = np.float32(sigma_hat / DENSITY_SCALE)
    density_step = max(np.log(np.float32(1.0) + scale * padded[0].max()) / np.float32(QUANTA), np.float32(1e-12))

    def build(m: int, start: int) -> None:
        """Planes of a mip from `start` on."""
        n, source = LEVEL0_CELLS >> m, max(m, 1)
        first, last = spans[m]
        block = packed[m][start : start + planes[m]]
        columns = block.view(np.uint16).reshape(*block.shape, -1)
        # Fine-cell centres in cube edges from the cube's lower corner.
        cube = [(np.arange(a, b) + 0.5) / (n * FINE[m]) - margin[m] / n for a, b in zip(first, last)]
        cube[0] = cube[0][start : start + planes[m]]
        density = None if earlier else padded[m]
        depth = None if sun is None else sun.unit_depths[source - 1]
        visibility = None if sun is None or sun.visibility is None else sun.visibility[source - 1]
        cells = LEVEL0_CELLS >> source
        fine = Between.of([c * n + margin[m] - 0.5 for c in cube], padded[m].shape)
        coarse = Between.of([c * cells + margin[source] - 0.5 for c in cube], padded[source].shape)
        call(
            "fill_lattice",
            shape=np.array(block.shape),
            density=fine.described(density),
            depth=coarse.described(depth),
            visibility=coarse.described(visibility),
            density_scale=float(scale),
            density_step=float(density_step),
            depth_scale=sigma_hat * BETA**source,
            least_visible=float(np.exp(-MAX_SHADOW_DEPTH * BETA**source)),
            packed=columns,
            columns=columns.shape[-1],
            scratch=np.empty(2 * block.shape[2] + max(padded[m].shape[2], padded[source].shape[2]), np.float32),
        )

    # Small blocks, so that a cancelled render ends soon.
    planes = [max(CELLS_PER_TASK // lattice[0].size, 1) for lattice in packed]
    tasks = [(m, start) for m in range(MIPS) for start in range(0, len(packed[m]), planes[m])]
    list(mapper(lambda task: build(*task), tasks))
    return Lattices(
        values,
        [
            Lattice(
                packed[m], -0.5 - margin[m] / (LEVEL0_CELLS >> m), float((LEVEL0_CELLS >> m) * FINE[m]), spans[m][0]
            )
            for m in range(MIPS)
        ],
        density_step,
    )
