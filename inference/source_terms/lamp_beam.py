# SPDX-License-Identifier: GPL-3.0-or-later
"""Unscattered light of a lamp in the cells of the coarse transport."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..grids.dense_grid import DenseGrid
from ..grids.lamp_optical_depth import LampOpticalDepth
from ..grids.working_cube import Cube
from ..occluders.lamp_shadow_map import LampShadowMap
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.emitters import Emitter, LampSource
from ..scene.spot_cone import SpotCone
from ..transport.discrete_ordinates import DiscreteOrdinates
from .held_cells import box_of, with_neighbours
from .lamp_cells import LampCells, light_in_cells

# Sample points along an edge of a cell, where a lamp is one point: of all cells that hold density, and of those within
# so many cells of the lamp, where its light varies as the inverse square of a distance smaller than a cell. Nearer to
# the lamp than a fraction of the distance between them no light is told apart.
PARTS, NEAR_PARTS, NEAR_CELLS, SOFT = 2, 8, 2.5, 0.4
# Most by which the columns of several lamps together are further apart than those of one.
BLENDED = 1.5
# Optical depth beyond which no light arrives.
MAX_DEPTH = 60.0


@dataclass(frozen=True)
class CubeCells:
    """Cells of the working cube that light is cast into.

    density: float32 (n, n, n). sigma: extinction for density 1, per edge of the cube.
    forward: as of DiscreteOrdinates.
    """

    density: np.ndarray
    sigma: float
    forward: float = 0.0


@dataclass(frozen=True)
class LampInCube:
    """A lamp of power 1 as the working cube of a group of volumes sees it.

    emitters: its parts, in the world. cube: the working cube. shadow_maps: of each emitter, None where nothing shadows
    it, or None. key: digest that is equal for lamps with the same light and shadows. centre: (3,), in the world, where
    its light comes from. lamps: how many lamps it stands for, whose shadows blend: their columns may be further apart.
    """

    emitters: Sequence[Emitter]
    cube: Cube
    shadow_maps: Sequence[LampShadowMap | None] | None
    key: bytes
    centre: np.ndarray
    lamps: int = 1

    @property
    def place(self) -> np.ndarray:
        """The centre (3,) in the cube's frame."""
        return self.cube.positions(self.centre[None])[0]

    @property
    def cone(self) -> SpotCone | None:
        """A round one in which its light travels, in the cube's frame, or None."""
        cone = self.emitters[0].cone
        return None if cone is None else cone.around(self.cube.directions(cone.axis))

    def __call__(
        self, solver: "DiscreteOrdinates | CubeCells", cancel: CancelToken = NEVER
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean of the unscattered light over each cell, and unit vectors (3, x, y, z) towards the lamp."""
        n, few = len(solver.density), PARTS if len(self.emitters) == 1 else 1
        light, filled = np.zeros((n, n, n), np.float32), np.flatnonzero(solver.density > 0.0)
        light.reshape(-1)[filled] = self._light(solver, filled, few, cancel, min(self.lamps**0.25, BLENDED))[0]
        lamp = self.place
        away = np.empty((3, n, n, n), np.float32)
        for axis, along in enumerate(np.ogrid[:n, :n, :n]):
            away[axis] = lamp[axis] + 0.5 - (along + 0.5) / n
        away /= np.maximum(np.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2), np.float32(1e-9))
        cone = self.cone
        if cone is not None:
            # Of cells that the cone touches, the middle may lie beside it.
            lit, flat = np.flatnonzero(light), away.reshape(3, -1)
            level = -sum(part * towards[lit] for part, towards in zip(cone.axis, flat))
            beside = lit[level < cone.bound]
            flat[:, beside] = -cone.turned(-flat[:, beside].T).T
        return light, away

    def unit_depth(self, cells: CubeCells, cancel: CancelToken = NEVER) -> tuple[np.ndarray, float]:
        """The lamp's light in cells as an optical depth float32 (n, n, n) for sigma = 1, and the light where that is 0.

        The depth stands for all that the light in a cell lacks of that where it is brightest: what matter and surfaces
        take, the distance, a spot's cone and an area light's side. 0 in cells that neither hold density nor touch one
        that does. Raises Cancelled.
        """
        near = with_neighbours(cells.density > 0.0)
        lit, depth = np.flatnonzero(near), np.zeros(near.shape, np.float32)
        # The shadows of several emitters blend: each of them may be coarser.
        share, unhindered = self._light(cells, lit, 1, cancel, len(self.emitters) ** 0.25)
        most = float(unhindered.max(initial=0.0))
        share /= np.float32(max(most, 1e-30))
        np.clip(share, np.float32(np.exp(-MAX_DEPTH)), np.float32(1.0), out=share)
        depth.reshape(-1)[lit] = np.log(share, out=share) / np.float32(-max(cells.sigma, 1e-30))
        return depth, most

    def _light(
        self,
        solver: DiscreteOrdinates | CubeCells,
        filled: np.ndarray,
        few: int,
        cancel: CancelToken,
        apart: float = 1.0,
    ) -> np.ndarray:
        """Means of the unscattered light over C cells, float32 (2, C): as it is, and without what lies in between.

        filled: int (C,), numbers of the cells. few: parts of an edge of a cell that is not near the lamp. apart: as for
        LampOpticalDepth.
        """
        n = len(solver.density)
        # Columns through the cells that hold density alone.
        box = box_of(solver.density)
        low = np.array([part.start for part in box])
        linear, offset = n * np.eye(3), 0.5 * n - 0.5 - low
        grid = DenseGrid(solver.density[box])
        sources = [self._in_cube(emitter.source) for emitter in self.emitters]
        depths = [LampOpticalDepth(grid, linear, offset, one, apart, cancel) for one in sources]
        light, near = np.zeros((2, len(filled)), np.float32), np.zeros((n, n, n), bool)
        for source in sources:
            first, end = (np.ceil((source.position + 0.5) * n - 0.5 + side * NEAR_CELLS) for side in (-1.0, 1.0))
            near[tuple(slice(*ends) for ends in np.clip([first, end], 0, n).astype(int).T)] = True
        nearby = near.reshape(-1)[filled]
        for some, parts in ((~nearby, few), (nearby, NEAR_PARTS)):
            cells = filled[some]
            radius = SOFT * self.cube.edge / (n * parts)
            world = self.cube.rotation * (self.cube.edge / n)
            origin = self.cube.world(np.full(3, 0.5 / n - 0.5))
            lattice = LampCells((n, n, n), world, origin, low, float(solver.sigma), solver.forward)
            emitters = list(zip(self.emitters, depths, self.shadow_maps or [None] * len(depths)))
            light[:, some] = light_in_cells(emitters, lattice, (cells, parts, radius), cancel)
        self._add_closest(light, filled, solver)
        return light

    def _add_closest(self, light: np.ndarray, filled: np.ndarray, solver: DiscreteOrdinates | CubeCells) -> None:
        """Add to the cells that the lamp's points lie in what softening by a radius r took; light: (2, C).

        Along each way that is the integral of r^2 / (d^2 + r^2) exp(-sigma d) over distances d.
        """
        n = len(solver.density)
        cell = self.cube.edge / n
        radius = SOFT * cell / NEAR_PARTS
        # Distances over r, evenly spaced in the angle that r is seen under.
        apart = np.tan((np.arange(64) + 0.5) / 64 * 0.5 * np.pi)
        for emitter in self.emitters:
            if not emitter.is_point_within(radius):
                continue
            place = np.floor((self.cube.positions(emitter.position[None])[0] + 0.5) * n).astype(int)
            if ((place < 0) | (place >= n)).any():
                continue
            number = np.ravel_multi_index(tuple(place), (n, n, n))
            at = np.searchsorted(filled, number)
            if at < len(filled) and filled[at] == number:
                depth = float(solver.sigma) * float(solver.density[tuple(place)]) * radius
                taken = emitter.power * 0.5 * np.pi * radius / cell**3
                light[:, at] += taken * np.array([np.exp(-depth / self.cube.edge * apart).mean(), 1.0])

    def _in_cube(self, source: LampSource) -> LampSource:
        """A source of light in the cube's frame."""
        position, centre = self.cube.positions(np.stack([source.position, source.centre]))
        return LampSource(position, centre, source.radius / self.cube.edge, source.soft_falloff)


def directions_to(lamp: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3) from positions (N, 3) to a lamp (3,)."""
    away = lamp - positions
    return away / np.maximum(np.linalg.norm(away, axis=1), 1e-30)[:, None]
