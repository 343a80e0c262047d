# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering on coarse cells by discrete ordinates: what light does far from where it enters.

Radiance travels between neighbouring cells of the working cube along 26 directions, with the weights of Lebedev's
quadrature of that order, for albedo 1. The forward peak of the phase function counts as unscattered (delta scaling,
Wiscombe 1977), so that few directions suffice for any anisotropy G:

    sigma' = sigma_hat (1 - G^2),    G' = G / (1 + G).

A sweep along all directions gives the fluence phi and the flux F of the light scattered from the sun's beam and from
the previous phi and F; its sources are (phi + 3 G' F . u) / (4 pi), and for the beam the Henyey-Greenstein phase
function of G'. The part of the fluence that a sweep still lacks follows from a diffusion equation,

    -div(D grad psi) = sigma' (phi_new - phi_old),    D = 1 / (3 sigma_hat (1 - G)) + numerical diffusion of the cells,

so that a few sweeps suffice where light scatters a thousand times (diffusion synthetic acceleration). Light leaves
through the faces of the cube. That of a sun does not enter there, because its beam is known; that of an environment
does, and phi and F then hold unscattered light too. The solution is too coarse to be the answer; it is a feature for
the network, which otherwise knows a point's surroundings in outline only.
"""

from typing import Any

import numpy as np

from ..grids.optical_depth_sweep import sun_optical_depth
from ..numerics.exponential import one_minus_exp
from ..occluders.cell_boundaries import CellBoundaries
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.phase_function import henyey_greenstein
from .diffusion import THIN, couple, solve

#: Level of the density pyramid that has these cells, and its cells along an edge of the cube.
LEVEL, CELLS = 2, 64
# Solid angles of the directions to the neighbours across a face, an edge and a corner, over 4 pi.
WEIGHTS = 1.0 / 21.0, 4.0 / 105.0, 9.0 / 280.0
# Cells along an edge from which on the light is first solved on cells twice as large. At most so many sweeps without
# and after that; they end when less than the fraction CONVERGED of the scattered light changes.
MULTILEVEL_CELLS, SWEEPS, FINE_SWEEPS, CONVERGED = 64, 8, 2, 0.002
# Tolerance and maximal iterations of the diffusion solver, which works on cells twice as large.
TOLERANCE, MAX_ITERATIONS = 0.1, 40
# Numerical diffusion: even opaque cells pass light to their neighbours as if D were this fraction of their edge.
CELL_DIFFUSION = 0.2
# Lower bound of the optical thickness of a cell.
MIN_DEPTH = np.float32(1e-6)


def _directions(axis: int) -> np.ndarray:
    """Steps int (D, 3) that rise along an axis and are 0 along those before it, nearest neighbours first."""
    steps = np.array(list(np.ndindex(3, 3, 3))) - 1
    steps = steps[(steps[:, axis] == 1) & (steps[:, :axis] == 0).all(axis=1)]
    return steps[np.argsort(np.abs(steps).sum(axis=1), kind="stable")]


# Phase function of the beam along the steps of an axis, and along their opposites.
Phases = tuple[np.ndarray, np.ndarray]

# With their opposites, all 26 directions.
STEPS = [_directions(axis) for axis in range(3)]


def _ordinates() -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (26, 3) towards the light of all steps, in the order of sweeps, and their shares (26,) of 4 pi."""
    steps = np.concatenate([sign * steps for steps in STEPS for sign in (1, -1)])
    return -steps / np.sqrt((steps**2).sum(axis=1))[:, None], _solid_angles(steps)


def reduced_anisotropy(anisotropy: Any) -> Any:
    """G', the mean cosine of the phase function without its forward peak."""
    return anisotropy / (1.0 + anisotropy)


class DiscreteOrdinates:
    """Solver for the scattered light in one medium, for any sun.

    density: float32 (n, n, n), a level of the density pyramid, n being CELLS or half of it. sigma_hat: extinction per
    unit density times the cube's edge. anisotropy: G > -1. triangles: (T, 3, 3), in the cube's frame, of black
    surfaces, or None.
    """

    def __init__(self, density: np.ndarray, sigma_hat: float, anisotropy: float, triangles: np.ndarray | None = None):
        n = len(density)
        self.density, self.sigma = density, np.float32(sigma_hat * (1.0 - anisotropy**2))
        self.anisotropy = reduced_anisotropy(anisotropy)
        self.extinction = self.sigma * density
        reduced = np.float32(sigma_hat * (1.0 - anisotropy)) * density
        self.coarser: DiscreteOrdinates | None = None
        if n >= MULTILEVEL_CELLS:
            self.coarser = DiscreteOrdinates(_means(density), sigma_hat, anisotropy, triangles)
        self.diffusion = 1.0 / (3.0 * reduced + np.float32(THIN)) + np.float32(CELL_DIFFUSION / n)
        coarse_diffusion = 1.0 / (3.0 * _means(reduced) + np.float32(THIN)) + np.float32(CELL_DIFFUSION / n)
        self.boundaries: CellBoundaries | None = None
        self.links: list[dict[int, np.ndarray]] | None = None
        coarse_boundaries = None
        if triangles is not None and len(triangles):
            boundaries = CellBoundaries(triangles, n)
            if not boundaries.empty:
                self.boundaries, coarse_boundaries = boundaries, CellBoundaries(triangles, n // 2)
                self.links = [_open_links(boundaries, axis) for axis in range(3)]
        diagonal, couplings = couple(coarse_diffusion.astype(np.float64), 2.0 / n, coarse_boundaries)
        self.equation = diagonal.astype(np.float32), couplings.astype(np.float32)
        self.transmittances = self._transmittances()

    def _transmittances(self) -> list[list[tuple[np.ndarray, np.ndarray]]]:
        """Transmittance of cells and mean of exp(-tau) within them, main axis first.

        Per main axis and kind of neighbour: across a face, an edge or a corner.
        """
        n, kinds = len(self.density), []
        extinction = self.extinction
        if self.boundaries is not None:
            extinction = np.where(self.boundaries.inside, np.float32(n * 1e3), extinction)
        for length in np.sqrt([1.0, 2.0, 3.0]).astype(np.float32) / np.float32(n):
            tau = np.maximum(extinction * length, MIN_DEPTH)
            lost = one_minus_exp(tau)
            kinds.append((1.0 - lost, lost / tau))

        def main_axis_first(values: np.ndarray, axis: int) -> np.ndarray:
            return np.ascontiguousarray(np.moveaxis(values, axis, 0))

        return [
            [
                (main_axis_first(transmitted, axis), main_axis_first(mean, axis))
                for transmitted, mean in kinds[: 3 - axis]
            ]
            for axis in range(3)
        ]

    def light(self, sun: np.ndarray, visibility: np.ndarray | float = 1.0, cancel: CancelToken = NEVER) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of the scattered light of a sun of irradiance 1.

        sun: (3,) unit vector in the cube's frame. visibility: (x, y, z), fraction of its light that surfaces let
        through. Raises Cancelled.
        """
        n = len(self.density)
        tau = self.sigma * sun_optical_depth(self.density, sun, 1.0 / n)
        # Mean of the beam over a cell, exact for a beam along an axis.
        half = np.float32(0.5 / n) * self.extinction
        across = np.maximum(2.0 * half, MIN_DEPTH)
        beam = visibility * np.exp(-np.maximum(tau - half, 0.0)) * one_minus_exp(across) / across
        phases = [self._phases(steps, sun) for steps in STEPS]
        # The quadrature of the phase function need not be exactly 1.
        total = (
            4.0
            * np.pi
            * sum((_solid_angles(steps) * phase).sum() for steps, pair in zip(STEPS, phases) for phase in pair)
        )
        field = np.zeros((5, n, n, n), np.float32)
        field[4] = beam
        sweeps = SWEEPS
        if self.coarser is not None:
            coarse_visibility = _means(visibility) if isinstance(visibility, np.ndarray) else visibility
            coarse = self.coarser.light(sun, coarse_visibility, cancel)
            field[:4] = [self._finer(values) for values in coarse]
            sweeps = FINE_SWEEPS
        for number in range(sweeps):
            if self.boundaries is not None:
                field *= ~self.boundaries.inside
            swept = self._sweep(field, phases, total, cancel)
            change = self.extinction * (swept[0] - field[0])
            if self.boundaries is not None:
                change *= ~self.boundaries.inside
            if number == sweeps - 1 or np.abs(change).sum() <= CONVERGED * (self.extinction * swept[0]).sum():
                break
            field[:4] = swept
            self._correct(field, change)
        return swept

    def environment(self, radiance: np.ndarray, cancel: CancelToken = NEVER) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of all light of an environment, unscattered light included.

        radiance: (26,), that arrives from ORDINATES. Linear in it. Raises Cancelled.
        """
        n = len(self.density)
        field = np.zeros((5, n, n, n), np.float32)
        sweeps = SWEEPS
        if self.coarser is not None:
            field[:4] = [self._finer(values) for values in self.coarser.environment(radiance, cancel)]
            sweeps = FINE_SWEEPS
        else:
            # Exact for even light, which no albedo of 1 changes.
            field[0] = 4.0 * np.pi * (ORDINATE_WEIGHTS @ radiance)
        phases = [(np.zeros(len(steps)),) * 2 for steps in STEPS]
        for number in range(sweeps):
            swept = self._sweep(field, phases, 1.0, cancel, radiance)
            change = self.extinction * (swept[0] - field[0])
            if number == sweeps - 1 or np.abs(change).sum() <= CONVERGED * (self.extinction * swept[0]).sum():
                break
            field[:4] = swept
            self._correct(field, change, limit=False)
        return swept

    def _phases(self, steps: np.ndarray, sun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Henyey-Greenstein phase function of the beam along steps and along their opposites, (D,) each."""
        cosine = -(steps @ sun) / np.sqrt((steps**2).sum(axis=1))
        return henyey_greenstein(cosine, self.anisotropy), henyey_greenstein(-cosine, self.anisotropy)

    def _correct(self, field: np.ndarray, change: np.ndarray, limit: bool = True) -> None:
        """Add the diffusion of sources (x, y, z) that the field, (5, x, y, z), has not scattered yet.

        limit: whether sources are kept from being negative, which makes the solution not quite linear.
        """
        n = len(self.density)
        source = _means(change) * np.float32((2.0 / n) ** 2)
        more = self._finer(solve(self.equation, source, -np.inf, TOLERANCE, MAX_ITERATIONS))
        field[0] += more
        for axis in range(3):
            field[1 + axis] -= self.diffusion * np.gradient(more, np.float32(1.0 / n), axis=axis)
        if limit:
            np.maximum(field[0], 0.0, out=field[0])
            self._limit_flux(field)

    def _finer(self, values: np.ndarray) -> np.ndarray:
        """Values on cells half as large, interpolated between cell centres, but not if there are surfaces."""
        return _interpolated(values) if self.boundaries is None else values.repeat(2, 0).repeat(2, 1).repeat(2, 2)

    def _limit_flux(self, field: np.ndarray) -> None:
        """Limit the flux of a field, (5, x, y, z), such that no source is negative."""
        size = np.sqrt((field[1:4] ** 2).sum(axis=0)) * np.float32(3.0 * abs(self.anisotropy))
        field[1:4] *= np.minimum(field[0] / np.maximum(size, np.float32(1e-30)), 1.0)

    def _sweep(
        self,
        field: np.ndarray,
        phases: list[Phases],
        total: float,
        cancel: CancelToken,
        radiance: np.ndarray | None = None,
    ) -> np.ndarray:
        """Fluence and flux (4, x, y, z) of the light that the sources of a field (5, x, y, z) emit.

        The field holds phi, F and the beam. radiance: (26,), of the light that enters from ORDINATES, if any does.
        """
        swept = np.zeros((4, *field.shape[1:]), np.float32)
        entering = iter(np.split(np.zeros(26) if radiance is None else np.asarray(radiance), INFLOW_ENDS))
        for axis, steps in enumerate(STEPS):
            sources = np.ascontiguousarray(np.moveaxis(field, [1 + axis, 0], [0, 1]))
            sums = np.zeros((len(sources), 4, *sources.shape[2:]), np.float32)
            for sign, phase in zip((1, -1), phases[axis]):
                cancel.check()
                links = None if self.links is None else self.links[axis][sign]
                self._follow_steps(axis, sign * steps, phase / total, sources, sums, links, next(entering))
            swept += np.moveaxis(sums, [1, 0], [0, 1 + axis])
        return swept

    def _follow_steps(
        self,
        axis: int,
        steps: np.ndarray,
        phase: np.ndarray,
        sources: np.ndarray,
        sums: np.ndarray,
        links: np.ndarray | None,
        entering: np.ndarray,
    ) -> None:
        """Add fluence and flux of light along steps (D, 3) to `sums` (slices, 4, b, c).

        All steps lead to one side along an axis. entering: (D,), radiance at the faces of the cube.
        """
        n, count = len(sources), len(steps)
        kinds = np.abs(steps).sum(axis=1)
        unit = steps / np.sqrt(kinds)[:, None]
        one = np.ones((count, 1))
        scattered = np.concatenate([one, 3.0 * self.anisotropy * unit], axis=1) / (4.0 * np.pi)
        emit = np.concatenate([scattered, phase[:, None]], axis=1).astype(np.float32)
        gather = (4.0 * np.pi * _solid_angles(steps) * np.concatenate([one, unit], axis=1).T).astype(np.float32)
        # Steps are sorted by kind.
        places = [(kind - 1, np.flatnonzero(kinds == kind)) for kind in np.unique(kinds)]
        of_kind = [(kind, slice(found[0], found[-1] + 1)) for kind, found in places]
        b, c = (steps[:, other] for other in range(3) if other != axis)
        # Light that leaves the previous slice, with a border of what enters.
        light = np.empty((count, sources.shape[2] + 2, sources.shape[3] + 2), np.float32)
        light[:] = entering[:, None, None]
        before, after = (np.empty((count, *sources.shape[2:]), np.float32) for _ in range(2))
        rows, columns = sources.shape[2:]
        for k in range(n)[:: steps[0, axis]]:
            source = (emit @ sources[k].reshape(5, -1)).reshape(before.shape)
            for d in range(count):
                arriving = light[d, 1 - b[d] : 1 - b[d] + rows, 1 - c[d] : 1 - c[d] + columns]
                if links is not None:
                    arriving = arriving * links[k, d]
                np.subtract(arriving, source[d], out=before[d])
            # Within a cell radiance tends towards the source function: I = S + (I_0 - S) exp(-tau).
            for kind, which in of_kind:
                transmitted, mean = self.transmittances[axis][kind]
                np.multiply(before[which], transmitted[k], out=after[which])
                before[which] *= mean[k]
            np.add(after, source, out=light[:, 1:-1, 1:-1])
            before += source
            sums[k] += (gather @ before.reshape(count, -1)).reshape(sums[k].shape)


def _solid_angles(steps: np.ndarray) -> np.ndarray:
    """Solid angles (D,) of steps, over 4 pi."""
    return np.array(WEIGHTS)[np.abs(steps).sum(axis=1) - 1]


#: Unit vectors (26, 3) towards the light of the directions that are solved for, and their shares (26,) of the sphere.
ORDINATES, ORDINATE_WEIGHTS = _ordinates()
# Where the directions of each axis and sign end among them.
INFLOW_ENDS = np.cumsum([len(steps) for steps in STEPS for _ in range(2)])[:-1]


def _open_links(boundaries: CellBoundaries, axis: int) -> dict[int, np.ndarray]:
    """Whether light passes from the cells that steps along an axis come from, by sign of the steps.

    float32 (slices, D, b, c): 0 where a surface cuts the link, else 1.
    """
    clear = boundaries.facing == 0.0
    found = {}
    for sign in (1, -1):
        links = []
        for step in sign * STEPS[axis]:
            # The link goes along one axis after the other, backwards. What np.roll carries in at a face comes without
            # light.
            place, link = np.zeros(3, int), np.ones(clear.shape[1:], bool)
            for a in np.flatnonzero(step):
                if step[a] > 0:
                    place[a] -= 1
                link &= np.roll(clear[a], tuple(-place), axis=(0, 1, 2))
                if step[a] < 0:
                    place[a] += 1
            links.append(np.moveaxis(link, axis, 0))
        found[sign] = np.stack(links, axis=1).astype(np.float32)
    return found


def _means(values: np.ndarray) -> np.ndarray:
    """Means of 2 x 2 x 2 cells."""
    n = len(values) // 2
    return values.reshape(n, 2, n, 2, n, 2).mean(axis=(1, 3, 5))


def _interpolated(values: np.ndarray) -> np.ndarray:
    """Values (x, y, z) on cells half as large, linear between the centres of the large ones."""
    for axis in range(3):
        v = np.moveaxis(np.pad(values, [(int(a == axis),) * 2 for a in range(3)], mode="edge"), axis, 0)
        halves = np.stack([0.25 * v[:-2] + 0.75 * v[1:-1], 0.75 * v[1:-1] + 0.25 * v[2:]], axis=1)
        values = np.moveaxis(halves.reshape(-1, *v.shape[1:]), 0, axis)
    return values
