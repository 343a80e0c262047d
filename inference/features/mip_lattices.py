"""What the descriptors read: the density pyramid and the scaled transmittance fields.

Mip m has n = 2^(8 - m) cells along the cube's edge. Its density is level m of the
pyramid; its transmittance is field i = max(m - 1, 0), which integrates through level
i + 1. Both are kept on a lattice that reaches as far beyond the cube as the mip's stencil
points do: density is 0 there, and the optical depth towards the sun through the cube is
what A.3's redirection to the boundary would give.
"""

from dataclasses import dataclass

import numpy as np

from ..grids.optical_depth_sweep import sun_optical_depth
from ..plan.resolution import LEVEL0_CELLS
from .stencil import MIPS, Stencil

# beta of the scaled transmittance: field i holds exp(-beta^(i + 1) tau).
BETA = 0.578
# Density features are log(1 + sigma_hat * density / 64).
DENSITY_SCALE = 64.0
# Cells of the lookup lattice per cell of a mip: one lookup of the nearest fine cell stands
# for a trilinear one.
FINE = (1, 2, 2, 2, 4, 8, 16, 16)
# A feature is kept in 16 bits: so many steps up to its largest value.
STEPS = 65535
# Fine cells of lattices that one task makes.
CELLS_PER_TASK = 1 << 21
# What surfaces keep off the scaled transmittance counts as light behind this optical depth: no volume that the network
# has learned from makes its wider fields black.
SHADE = 10.0
# Places along an edge of a cell of levels 1..7 at which surfaces may shade it.
LIT_PARTS = (1, 1, 1, 2, 4, 4, 4)


def density_pyramid(level0: np.ndarray) -> list[np.ndarray]:
    """Levels 0..8 by 2x2x2 means, float32; level m has 2^(8 - m) cells along an edge."""
    levels = [level0]
    while levels[-1].shape[0] > 1:
        fine = levels[-1]
        pairs = fine[0::2] + fine[1::2]
        pairs = pairs[:, 0::2] + pairs[:, 1::2]
        levels.append((pairs[:, :, 0::2] + pairs[:, :, 1::2]) * np.float32(0.125))
    return levels


def margins(stencil: Stencil) -> list[int]:
    """Cells that each mip's lattice needs beyond every face of the cube."""
    cells = [LEVEL0_CELLS >> m for m in range(MIPS)]
    reach = [stencil.reach(m) for m in range(MIPS)]
    # Mips 0 and 1 share field 0, which needs mip 1's margin.
    return [int(np.ceil(r * n)) + 1 for r, n in zip(reach, cells)]


def padded_levels(pyramid: list[np.ndarray], stencil: Stencil) -> list[np.ndarray]:
    """Levels 0..7 with their margins of zeros."""
    return [np.pad(level, margin) for level, margin in zip(pyramid, margins(stencil))]


def unit_optical_depths(padded: list[np.ndarray], direction: np.ndarray) -> list[np.ndarray]:
    """Optical depth towards the sun through levels 1..7 for sigma_hat = 1, on the padded lattices.

    direction: (3,) unit vector towards the sun in the cube's frame.
    """
    return [
        sun_optical_depth(level, direction, step_length=1.0 / (LEVEL0_CELLS >> m))
        for m, level in enumerate(padded[1:], start=1)
    ]


def visibility_levels(stencil: Stencil, shadow_map) -> list[np.ndarray]:
    """Share of the sun's light that surfaces let through to the cells of levels 1..7, on the padded lattices.

    shadow_map: ShadowMap in the cube's frame.
    """
    return [shadow_map.lit_cells(LEVEL0_CELLS >> m, margin, parts)
            for m, (margin, parts) in enumerate(zip(margins(stencil)[1:], LIT_PARTS), start=1)]


def _shaded(share: np.ndarray, scale: float) -> np.ndarray:
    """What is left of a scaled transmittance where surfaces let a share of the light through; changed in place."""
    left = np.float32(np.exp(-SHADE * scale))
    share *= np.float32(1.0) - left
    share += left
    return share


@dataclass
class Lattice:
    """Features of one mip, ready for one lookup a point.

    packed: at fine-cell centres the density feature, uint16 (sx, sy, sz), or uint32 whose lower half it is and whose upper
        half is the scaled transmittance, both in steps.
    origin: cube coordinate of fine cell 0, the same on every axis. scale: fine cells per
        cube edge. first: int (3,), the fine cell that packed[0, 0, 0] is.
    """

    packed: np.ndarray
    origin: float
    scale: float
    first: np.ndarray


@dataclass
class Lattices:
    """Lattices of mips 0..7.

    values: all of theirs, one after another. density_step: of the density feature; the transmittance's is 1 / STEPS.
    """

    values: np.ndarray
    levels: list[Lattice]
    density_step: np.float32

    @property
    def columns(self) -> int:
        """1 where they hold the density alone, or 2."""
        return self.values.itemsize // 2

    def read(self, index: np.ndarray, features: np.ndarray):
        """Fill features, float32 (N, k, columns), with density and, where it is held, transmittance at places (N, k) in `values`."""
        # The lattices hold every cell that a stencil can read; clipping costs less than checking.
        steps = self.values.take(index, mode="clip").view(np.uint16)
        features = features.reshape(steps.shape)
        features[...] = steps
        features *= np.tile(np.array([self.density_step, 1.0 / STEPS][: self.columns], np.float32), index.shape[1])


def _fine_span(m: int, stencil: Stencil, low, high):
    """Fine cells of mip m that stencils around points from low to high (3,) can read: first, last + 1."""
    margin, reach, scale = margins(stencil)[m], stencil.reach(m), (LEVEL0_CELLS >> m) * FINE[m]
    cells = scale + 2 * margin * FINE[m]
    # One cell of slack on either side for rounding.
    first = np.floor((low - reach + 0.5) * scale).astype(int) + margin * FINE[m] - 1
    last = np.floor((high + reach + 0.5) * scale).astype(int) + margin * FINE[m] + 2
    return np.clip(first, 0, cells - 1), np.clip(last, 1, cells)


def _along(grid: np.ndarray, below, above_share, axis: int) -> np.ndarray:
    """Linear interpolation along one axis, between cells `below` and the next."""
    refined = grid.take(below, axis)
    if not above_share.any():
        return refined
    rise = grid.take(below + 1, axis)
    rise -= refined
    rise *= above_share.reshape([-1 if a == axis else 1 for a in range(3)])
    refined += rise
    return refined


def _refined_planes(grid: np.ndarray, centres):
    """Linear interpolation of the grid at fine-cell centres, a plane (y, z) of the first axis at a time.

    centres: three arrays, positions in cells of the grid, whose centres lie at integers; clamped at the rim.
    Yields the plane's number and the plane, which the next one overwrites: memory that is taken and given back anew for
    each would cost several threads more than the arithmetic.
    """
    below, share = [], []
    for axis, position in enumerate(centres):
        # Fine centres that are a cell's centre are one in spite of rounding.
        position = np.clip(np.round(position, 6), 0.0, grid.shape[axis] - 1.0)
        cell = np.minimum(position.astype(int), grid.shape[axis] - 2)
        below.append(cell)
        share.append((position - cell).astype(np.float32))
    first, last = below[0][0], below[0][-1] + 2
    # The short axes' work is done before the grid grows along the long one.
    grid = _along(_along(grid[first:last], below[2], share[2], 2), below[1], share[1], 1)
    plane = np.empty(grid.shape[1:], np.float32)
    for number, (cell, part) in enumerate(zip(below[0] - first, share[0])):
        np.subtract(grid[cell + 1], grid[cell], out=plane)
        plane *= part
        plane += grid[cell]
        yield number, plane


@dataclass(frozen=True)
class SunLevels:
    """One sun's light on levels 1..7 of the padded pyramid.

    unit_depths: from `unit_optical_depths`. visibility: from `visibility_levels` where surfaces shade, or None.
    """

    unit_depths: list[np.ndarray]
    visibility: list[np.ndarray] | None = None


def build_lattices(
    padded, sigma_hat: float, stencil: Stencil, sun: SunLevels | None = None, bounds=(-0.5, 0.5), mapper=map,
    earlier: Lattices | None = None,
) -> Lattices:
    """Lattices of mips 0..7 for one optical thickness and one sun.

    padded: from `padded_levels`. sun: None where the density is all that is read, which serves every sun. The density is
    interpolated before the logarithm and the optical depth before the exponential. bounds: lowest and highest (3,), in the
    cube's frame, of the points to be described; what their stencils cannot reach is not built. mapper: `map`, or
    `Tasks.each` to build parts on several threads. earlier: Lattices of another sun, the rest being equal, whose density is
    used again.
    """
    margin = margins(stencil)
    low, high = (np.broadcast_to(end, 3) for end in bounds)

    spans = [_fine_span(m, stencil, low, high) for m in range(MIPS)]
    ends = np.cumsum([np.prod(last - first) for first, last in spans])
    values = earlier.values.copy() if earlier else np.empty(ends[-1], np.uint16 if sun is None else np.uint32)

    packed = [values[end - np.prod(last - first) : end].reshape(last - first)
              for end, (first, last) in zip(ends, spans)]
    # No mean is denser than what it is of.
    scale = np.float32(sigma_hat / DENSITY_SCALE)
    density_step = max(np.log(np.float32(1.0) + scale * padded[0].max()) / np.float32(STEPS), np.float32(1e-12))

    def build(m: int, start: int) -> None:
        """Planes of a mip from `start` on."""
        n, source = LEVEL0_CELLS >> m, max(m, 1)
        first, last = spans[m]
        part = packed[m][start : start + planes[m]]
        columns = part.view(np.uint16).reshape(*part.shape, -1)
        # Fine-cell centres in cube edges from the cube's lower corner.
        cube = [(np.arange(a, b) + 0.5) / (n * FINE[m]) - margin[m] / n for a, b in zip(first, last)]
        cube[0] = cube[0][start : start + planes[m]]
        if not earlier:
            for i, plane in _refined_planes(padded[m], [c * n + margin[m] - 0.5 for c in cube]):
                plane *= scale
                plane += np.float32(1.0)
                np.log(plane, out=plane)
                plane *= 1.0 / density_step
                columns[i, ..., 0] = np.rint(np.minimum(plane, np.float32(STEPS), out=plane), out=plane)
        if sun is None:
            return
        cells = LEVEL0_CELLS >> source
        centres = [c * cells + margin[source] - 0.5 for c in cube]
        shares = _refined_planes(sun.visibility[source - 1], centres) if sun.visibility is not None else None
        for i, plane in _refined_planes(sun.unit_depths[source - 1], centres):
            plane *= np.float32(-sigma_hat * BETA**source)
            np.exp(plane, out=plane)
            if shares:
                plane *= _shaded(next(shares)[1], BETA**source)
            plane *= np.float32(STEPS)
            columns[i, ..., 1] = np.rint(plane, out=plane)

    # Parts are small, so that a render that is stopped ends soon.
    planes = [max(CELLS_PER_TASK // lattice[0].size, 1) for lattice in packed]
    tasks = [(m, start) for m in range(MIPS) for start in range(0, len(packed[m]), planes[m])]
    list(mapper(lambda task: build(*task), tasks))
    return Lattices(values, [Lattice(packed[m], -0.5 - margin[m] / (LEVEL0_CELLS >> m),
                                     float((LEVEL0_CELLS >> m) * FINE[m]), spans[m][0]) for m in range(MIPS)],
                    density_step)
