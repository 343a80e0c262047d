# SPDX-License-Identifier: GPL-3.0-or-later
"""Light followed across cells along the 26 directions of discrete ordinates, once along each.

Light passes from a cell to its neighbours, slice after slice. Within a cell the radiance I tends towards the source
function S: I = I_0 + (S - I_0) (1 - exp(-tau)).
"""

from collections.abc import Callable

import numpy as np

from ..kernels import library, structures
from ..numerics.exponential import one_minus_exp
from ..occluders.cell_boundaries import CellBoundaries
from .ordinates import SIDE_ENDS, SIDES, STEPS, solid_angles

# Fluence and flux: no axis has as many directions on one side.
SUMS = 4
# Lower bound of the optical thickness of a cell.
MIN_DEPTH = np.float32(1e-6)
# Optical thickness of a cell below which a series takes the place of differences.
THIN_CELL = np.float32(0.03)


class OrdinateSweeps:
    """Follows light across cells.

    extinction: float32 (n, n, n), per edge of the cube. scattering: albedo and mean cosine, by which a field's fluence
    and flux are its source. boundaries: CellBoundaries of black surfaces, or None.
    """

    def __init__(
        self,
        extinction: np.ndarray,
        scattering: tuple[float, float],
        boundaries: CellBoundaries | None,
    ) -> None:
        n = len(extinction)
        self.cells, self.scattering = n, scattering
        self.links: list[np.ndarray] | None = None
        if boundaries is not None:
            extinction = np.where(boundaries.inside, np.float32(n * 1e3), extinction)
            clear = boundaries.facing == 0.0
            self.links = [_open_links(clear, side) for side in range(len(SIDES))]
        lengths = np.sqrt([1.0, 2.0, 3.0]).astype(np.float32) / np.float32(n)
        tau = np.maximum(extinction * lengths[:, None, None, None], MIN_DEPTH)
        # Share of the source function in the radiance that leaves a cell, 1 - exp(-tau), and in its mean within the
        # cell, 1 - (1 - exp(-tau)) / tau, whose difference from 1 loses all digits in thin cells: float32 (3, x, y, z),
        # for each kind of neighbour, across a face, an edge or a corner.
        self.leaving = one_minus_exp(tau)
        series = tau * (0.5 - tau * (1.0 / 6.0 - tau / 24.0))
        self.within = np.where(tau < THIN_CELL, series, 1.0 - self.leaving / tau)

    def followers(
        self,
        source: np.ndarray,
        swept: np.ndarray,
        phases: list[np.ndarray] | None = None,
        entering: np.ndarray | None = None,
        beams: np.ndarray | None = None,
        visible: np.ndarray | None = None,
    ) -> list[Callable[[], object]]:
        """What follows light along the steps of each of SIDES: each call adds to `swept`.

        source: float32 (5, x, y, z), fluence, flux and beam whose scattering emits the light. swept: float32
        (4, x, y, z), sums of fluence and flux, or (26, x, y, z), mean radiance along each of ORDINATES in each cell.
        phases: phase function of the beam along the steps of each side, or None without a beam. entering: float32
        (26,), radiance at the faces of the cube, or None. beams: float32 (26, x, y, z), light of beams that scatters
        along each of ORDINATES, in place of the source's beam, so that none is lost whatever the quadrature. visible:
        float32 (26, x, y, z), the share of what enters that reaches the outermost cells along each of them.
        """
        links = [None] * len(SIDES) if self.links is None else self.links
        if visible is not None:
            parts = np.split(visible, SIDE_ENDS)
            links = [_entering_links(own, part, k) for k, (own, part) in enumerate(zip(links, parts))]
        sums = [swept] * len(SIDES) if len(swept) == SUMS else np.split(swept, SIDE_ENDS)
        inflow = [None] * len(SIDES) if entering is None else np.split(entering, SIDE_ENDS)
        scattered = [None] * len(SIDES) if beams is None else np.split(beams, SIDE_ENDS)
        if phases is None:
            phases = [np.full(len(STEPS[axis]), float(beams is not None)) for axis, _ in SIDES]
        return [
            self._follower(k, phases[k], (source, scattered[k]), sums[k], (inflow[k], links[k]))
            for k in range(len(SIDES))
        ]

    def _follower(
        self,
        side: int,
        phase: np.ndarray,
        light: tuple[np.ndarray, np.ndarray | None],
        swept: np.ndarray,
        entering: tuple[np.ndarray | None, np.ndarray | None],
    ) -> Callable[[], object]:
        """As `followers`, of one side; light: source and beams; entering: radiance, and links of cells."""
        axis, sign = SIDES[side]
        steps, weights = sign * STEPS[axis], self._weights(sign * STEPS[axis], phase)
        n = self.cells
        described = structures.FUNCTIONS["sweep_ordinates"](
            cells=n,
            axis=axis,
            sign=sign,
            directions=len(steps),
            steps=np.ascontiguousarray(np.delete(steps, axis, 1), np.int64),
            kinds=np.abs(steps).sum(axis=1) - 1,
            emit=weights[0],
            gather=weights[1] if len(swept) == SUMS else None,
            field=light[0],
            beams=light[1],
            leaving=self.leaving,
            within=self.within,
            links=entering[1],
            entering=None if entering[0] is None else np.ascontiguousarray(entering[0]),
            sums=swept,
            scratch=np.empty(2 * len(steps) * (n + 2) ** 2, np.float32),
        )
        return lambda: library.load_kernels().call("sweep_ordinates", described)

    def _weights(self, steps: np.ndarray, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights of a source in what steps emit, float32 (D, 5), and of their light in its sums, (D, 4)."""
        albedo, anisotropy = self.scattering
        unit = np.concatenate([np.ones((len(steps), 1)), steps / np.sqrt(np.abs(steps).sum(axis=1))[:, None]], axis=1)
        scattered = albedo * unit * [1.0, *[3.0 * anisotropy] * 3] / (4.0 * np.pi)
        phase = albedo * phase
        gather = 4.0 * np.pi * solid_angles(steps)[:, None] * unit
        return np.concatenate([scattered, phase[:, None]], axis=1).astype(np.float32), gather.astype(np.float32)


def _open_links(clear: np.ndarray, side: int) -> np.ndarray:
    """Whether light passes from the cells that the steps of one of SIDES come from.

    clear: bool (3, n, n, n), whether it passes to the next cell along each axis. float32 (slices, D, b, c): 0 where
    a surface cuts the link, else 1.
    """
    axis, sign = SIDES[side]
    links: list[np.ndarray] = []
    for step in sign * STEPS[axis]:
        # The link goes along one axis after the other, backwards. What np.roll carries in at a face brings no light.
        place, link = np.zeros(3, int), np.ones(clear.shape[1:], bool)
        for a in np.flatnonzero(step):
            if step[a] > 0:
                place[a] -= 1
            link &= np.roll(clear[a], tuple(-place), axis=(0, 1, 2))
            if step[a] < 0:
                place[a] += 1
        links.append(np.moveaxis(link, axis, 0))
    return np.ascontiguousarray(np.stack(links, axis=1), np.float32)


def _entering_links(links: np.ndarray | None, visible: np.ndarray, side: int) -> np.ndarray:
    """The links of one of SIDES, 1 if None, and instead of those from outside of the cube what is visible.

    visible: float32 (D, x, y, z), along each of the side's steps.
    """
    axis, sign = SIDES[side]
    visible = np.moveaxis(visible, 1 + axis, 0)
    found = np.ones(visible.shape, np.float32) if links is None else links.copy()
    for d, step in enumerate(sign * STEPS[axis]):
        # The array's axes: that of the side, then the other two.
        for place, along in enumerate([step[axis], *np.delete(step, axis)]):
            if along:
                face = np.moveaxis(found[:, d], place, 0), np.moveaxis(visible[:, d], place, 0)
                first = 0 if along > 0 else -1
                face[0][first] = face[1][first]
    return found
