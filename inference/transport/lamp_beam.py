# SPDX-License-Identifier: GPL-3.0-or-later
"""Unscattered light of a lamp in the cells of the coarse transport."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..grids.dense_grid import DenseGrid
from ..grids.lamp_optical_depth import LampOpticalDepth
from ..grids.working_cube import Cube
from ..kernels import field_structures
from ..kernels.library import Kernels
from ..occluders.lamp_shadow_map import LampShadowMap
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.lamps import Emitter
from .described_lamps import describe_emitter, describe_shadow_map
from .discrete_ordinates import DiscreteOrdinates

# Sample points along an edge of a cell, where a lamp is one point: of all cells that hold density, and of those within
# so many cells of the lamp, where its light varies as the inverse square of a distance smaller than a cell. Nearer to
# the lamp than a fraction of the distance between them no light is told apart.
PARTS, NEAR_PARTS, NEAR_CELLS, SOFT = 2, 8, 2.5, 0.4
# Samples between two polls of cancellation.
SAMPLES_PER_CALL = 1 << 19
# Optical depth beyond which no light arrives.
MAX_DEPTH = 60.0
# Of the largest irradiance in a cube, below which it counts as dark.
MIN_SHARE = 1e-6


def _centres(n: int) -> np.ndarray:
    """Centres (n^3, 3) of the cells of a cube from -1/2 to 1/2."""
    place = (np.arange(n) + 0.5) / n - 0.5
    return np.stack(np.meshgrid(place, place, place, indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass(frozen=True)
class CubeCells:
    """Cells of the working cube that light is cast into.

    density: float32 (n, n, n). sigma: extinction for density 1, per edge of the cube. kernels: compiled ones, or None.
    """

    density: np.ndarray
    sigma: float
    kernels: Kernels | None = None


@dataclass(frozen=True)
class LampInCube:
    """A lamp of power 1 as the working cube of a group of volumes sees it.

    emitters: its parts, in the world. cube: the working cube. shadow_maps: of each emitter, None where nothing shadows
    it, or None. key: digest that is equal for lamps with the same light and shadows. centre: (3,), in the world, where
    its light comes from.
    """

    emitters: Sequence[Emitter]
    cube: Cube
    shadow_maps: Sequence[LampShadowMap | None] | None
    key: bytes
    centre: np.ndarray

    def irradiance(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N,) at world points (N, 3) for power 1, without what lies in between."""
        return np.sum([emitter.fluence(points) for emitter in self.emitters], axis=0)

    def __call__(self, solver: DiscreteOrdinates, cancel: CancelToken = NEVER) -> tuple[np.ndarray, np.ndarray]:
        """Mean of the unscattered light over each cell, and unit vectors (3, x, y, z) towards the lamp."""
        n, centres = len(solver.density), _centres(len(solver.density))
        light = self._light(solver, solver.density.ravel() > 0.0, PARTS if len(self.emitters) == 1 else 1, cancel)
        away = self.cube.positions(self.centre[None])[0] - centres
        away /= np.maximum(np.linalg.norm(away, axis=1), 1e-9)[:, None]
        return light.reshape(n, n, n), away.T.reshape(3, n, n, n)

    def unit_depth(self, cells: CubeCells, cancel: CancelToken = NEVER) -> np.ndarray:
        """Optical depth float32 (n, n, n) towards the lamp for sigma = 1, what surfaces take of its light included.

        0 in cells that neither hold density nor touch one that does. Raises Cancelled.
        """
        n = len(cells.density)
        near = np.pad(cells.density > 0.0, 1)
        for axis in range(3):
            near = np.moveaxis(near, axis, 0)
            near = np.moveaxis(near[:-2] | near[1:-1] | near[2:], 0, axis)
        lit, depth = np.flatnonzero(near), np.zeros(n**3, np.float32)
        open_light = self.irradiance(self.cube.world(_centres(n)[lit]))
        # Beside the cone of a spot there is no light to take away.
        least = max(MIN_SHARE * open_light.max(initial=0.0), 1e-30)
        share = self._light(cells, near.ravel(), 1, cancel)[lit] / np.maximum(open_light, least)
        depth[lit] = -np.log(np.clip(share, np.exp(-MAX_DEPTH), 1.0)) / max(cells.sigma, 1e-30)
        return depth.reshape(n, n, n)

    def _light(
        self, solver: DiscreteOrdinates | CubeCells, filled: np.ndarray, few: int, cancel: CancelToken
    ) -> np.ndarray:
        """Mean of the unscattered light float64 (n^3,) over those cells that are `filled`, bool (n^3,).

        few: parts of an edge of a cell that is not near the lamp.
        """
        n = len(solver.density)
        grid, linear, offset = DenseGrid(solver.density), n * np.eye(3), np.full(3, 0.5 * n - 0.5)
        centres = _centres(n)
        light = np.zeros(len(centres))
        for e, emitter in enumerate(self.emitters):
            lamp = self.cube.positions(emitter.position[None])[0]
            depth = LampOpticalDepth(grid, linear, offset, lamp, 1.0, cancel, solver.kernels)
            shadow_map = None if self.shadow_maps is None else self.shadow_maps[e]
            near = np.abs(centres - lamp).max(axis=1) < NEAR_CELLS / n
            for cells, parts in ((np.flatnonzero(filled & ~near), few), (np.flatnonzero(filled & near), NEAR_PARTS)):
                if solver.kernels is not None:
                    self._add_compiled(solver, depth, e, (cells, parts), light, cancel)
                    continue
                inside = ((np.arange(parts) + 0.5) / parts - 0.5) / n
                for shift in np.stack(np.meshgrid(inside, inside, inside, indexing="ij"), axis=-1).reshape(-1, 3):
                    cancel.check()
                    points = centres[cells] + shift
                    world = self.cube.world(points)
                    found = emitter.fluence(world)
                    radius = SOFT * self.cube.edge / (n * parts)
                    found = found / (1.0 + found * (4.0 * np.pi * radius**2))
                    index = (n * points + offset).T.astype(np.float32)
                    found *= np.exp(-depth(index, float(solver.sigma)) * emitter.slant(world))
                    if shadow_map is not None:
                        found *= shadow_map.visibility(world)
                    light[cells] += found / parts**3
        return light

    def _add_compiled(
        self,
        solver: DiscreteOrdinates | CubeCells,
        depth: LampOpticalDepth,
        number: int,
        samples: tuple[np.ndarray, int],
        light: np.ndarray,
        cancel: CancelToken,
    ) -> None:
        """Add the light of one emitter, by number, to cells (n^3,) with compiled kernels.

        depth: through the solver's cells. samples: numbers of cells, and into how many parts their edges are divided.
        """
        (cells, parts), n = samples, len(solver.density)
        assert solver.kernels is not None
        columns, emitter = depth.described(float(solver.sigma)), describe_emitter(self.emitters[number])
        shadow_map = None if self.shadow_maps is None else self.shadow_maps[number]
        size = max(SAMPLES_PER_CALL // parts**3, 1)
        for start in range(0, len(cells), size):
            cancel.check()
            some = np.ascontiguousarray(cells[start : start + size], np.int64)
            data = field_structures.LampBeam(
                columns=columns,
                emitter=emitter,
                shadow_map=None if shadow_map is None else describe_shadow_map(shadow_map),
                cells=n,
                count=len(some),
                numbers=some,
                parts=parts,
                world=self.cube.rotation * (self.cube.edge / n),
                offset=self.cube.world(np.full(3, 0.5 / n - 0.5)),
                sigma=float(solver.sigma),
                radius=SOFT * self.cube.edge / (n * parts),
                light=light,
            )
            solver.kernels.prepare("lamp_beam", data)
