# SPDX-License-Identifier: GPL-3.0-or-later
"""Unscattered light of a lamp in the cells of the coarse transport."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..grids.dense_grid import DenseGrid
from ..grids.lamp_optical_depth import LampOpticalDepth
from ..grids.working_cube import Cube
from ..kernels import field_structures
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
        n = len(solver.density)
        place = (np.arange(n) + 0.5) / n - 0.5
        centres = np.stack(np.meshgrid(place, place, place, indexing="ij"), axis=-1).reshape(-1, 3)
        grid, linear, offset = DenseGrid(solver.density), n * np.eye(3), np.full(3, 0.5 * n - 0.5)
        light, filled = np.zeros(len(centres)), solver.density.ravel() > 0.0
        for e, emitter in enumerate(self.emitters):
            lamp = self.cube.positions(emitter.position[None])[0]
            depth = LampOpticalDepth(grid, linear, offset, lamp, 1.0, cancel, solver.kernels)
            shadow_map = None if self.shadow_maps is None else self.shadow_maps[e]
            near = np.abs(centres - lamp).max(axis=1) < NEAR_CELLS / n
            few = PARTS if len(self.emitters) == 1 else 1
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
        away = self.cube.positions(self.centre[None])[0] - centres
        away /= np.maximum(np.linalg.norm(away, axis=1), 1e-9)[:, None]
        return light.reshape(n, n, n), away.T.reshape(3, n, n, n)

    def _add_compiled(
        self,
        solver: DiscreteOrdinates,
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
