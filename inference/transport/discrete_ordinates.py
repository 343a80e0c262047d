# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering on coarse cells by discrete ordinates: what light does far from where it enters.

Radiance travels between neighbouring cells of the working cube along 26 directions, with the weights of Lebedev's
quadrature of that order, for albedo 1 unless another is given. The forward peak of the phase function counts as
unscattered (delta scaling, Wiscombe 1977), so that few directions suffice for any anisotropy G and albedo w:

    sigma' = sigma_hat (1 - w G^2),    w' = w (1 - G^2) / (1 - w G^2),    G' = G / (1 + G).

A sweep along all directions gives the fluence phi and the flux F of the light scattered from the sun's beam and from
the previous phi and F; its sources are w' (phi + 3 G' F . u) / (4 pi), and for the beam the Henyey-Greenstein phase
function of G'. The part of the fluence that a sweep still lacks follows from a diffusion equation,

    -div(D grad psi) + sigma_hat (1 - w) psi = w' sigma' (phi_new - phi_old),
    D = 1 / (3 sigma_hat (1 - w G)) + numerical diffusion of the cells,

so that a few sweeps suffice where light scatters a thousand times (diffusion synthetic acceleration). Light leaves
through the faces of the cube. That of a sun or a lamp does not enter there, because its beam is known; that of an
environment does, and phi and F then hold unscattered light too. The solution is too coarse to be the answer; it is a
feature for the network, which otherwise knows a point's surroundings in outline only.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..grids.halving import halve
from ..grids.optical_depth_sweep import sun_optical_depth
from ..kernels.field_structures import OrdinateSweep
from ..kernels.library import Kernels
from ..numerics.exponential import one_minus_exp
from ..numerics.small_matmul import product_of_columns
from ..numerics.spherical_harmonics import spherical_harmonics
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
# The same where the light is the answer and no feature: in dense media little changes in each of many sweeps.
EXACT_SWEEPS, EXACTLY_CONVERGED = 40, 1e-3
# Mean optical thickness of cells where light collides, from which on what scatters again is not smooth enough for cells
# twice as large.
THICK_CELL = 0.25
# Tolerance and maximal iterations of the diffusion solver, which works on cells twice as large.
TOLERANCE, MAX_ITERATIONS = 0.1, 40
# Numerical diffusion: even opaque cells pass light to their neighbours as if D were this fraction of their edge.
CELL_DIFFUSION = 0.2
# Lower bound of the optical thickness of a cell.
MIN_DEPTH = np.float32(1e-6)
# Fluence and flux: no axis has as many directions on one side.
SUMS = 4
# Cells whose beams are found at once: few enough for matrix products that stay on this thread.
BEAMS_PER_BLOCK = 1024
# Optical thickness of a cell below which a series takes the place of differences.
THIN_CELL = np.float32(0.03)


def _directions(axis: int) -> np.ndarray:
    """Steps int (D, 3) that rise along an axis and are 0 along those before it, nearest neighbours first."""
    steps = np.array(list(np.ndindex(3, 3, 3))) - 1
    steps = steps[(steps[:, axis] == 1) & (steps[:, :axis] == 0).all(axis=1)]
    return steps[np.argsort(np.abs(steps).sum(axis=1), kind="stable")]


# Phase function of the beam along the steps of an axis, and along their opposites.
Phases = tuple[np.ndarray, np.ndarray]
# Mean of a lamp's unscattered light over each cell of a solver, (x, y, z), and unit vectors (3, x, y, z) towards it.
Beam = Callable[["DiscreteOrdinates", CancelToken], tuple[np.ndarray, np.ndarray]]

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
    surfaces, or None. kernels: compiled ones, or None. albedo: in (0, 1], or (n, n, n) in [0, 1] where it varies.
    """

    def __init__(
        self,
        density: np.ndarray,
        sigma_hat: float,
        anisotropy: float,
        triangles: np.ndarray | None = None,
        kernels: Kernels | None = None,
        albedo: float | np.ndarray = 1.0,
    ):
        n = len(density)
        self.kernels = kernels
        self.density, self.sigma = density, np.float32(sigma_hat)
        self.anisotropy = reduced_anisotropy(anisotropy)
        self.varies = isinstance(albedo, np.ndarray)
        #: w', and whether that of the medium is 1.
        self.albedo = np.float32(albedo * (1.0 - anisotropy**2) / (1.0 - albedo * anisotropy**2))
        self.conservative = not self.varies and albedo == 1.0
        if self.varies:
            # What is delta-scaled differs from cell to cell.
            self.density = (density * (1.0 - albedo * anisotropy**2)).astype(np.float32)
        else:
            self.sigma = np.float32(sigma_hat * (1.0 - albedo * anisotropy**2))
        self.extinction = self.sigma * self.density
        #: Fraction of the extinction that counts as unscattered: the forward peak. Its mean where the albedo varies.
        mean = float(np.average(albedo, weights=density + 1e-30)) if isinstance(albedo, np.ndarray) else albedo
        self.forward = mean * anisotropy**2
        reduced = np.float32(sigma_hat * (1.0 - albedo * anisotropy)) * density
        self.coarser: DiscreteOrdinates | None = None
        if n >= MULTILEVEL_CELLS:
            means = self._means(density)
            if self.varies:
                albedo_means = self._means(albedo * density) / np.maximum(means, np.float32(1e-30))
            else:
                albedo_means = albedo
            self.coarser = DiscreteOrdinates(means, sigma_hat, anisotropy, triangles, kernels, albedo_means)
        self.diffusion = 1.0 / (3.0 * reduced + np.float32(THIN)) + np.float32(CELL_DIFFUSION / n)
        coarse_diffusion = 1.0 / (3.0 * self._means(reduced) + np.float32(THIN)) + np.float32(CELL_DIFFUSION / n)
        self.boundaries: CellBoundaries | None = None
        self.links: list[dict[int, np.ndarray]] | None = None
        coarse_boundaries = None
        if triangles is not None and len(triangles):
            boundaries = CellBoundaries(triangles, n)
            if not boundaries.empty:
                self.boundaries, coarse_boundaries = boundaries, CellBoundaries(triangles, n // 2)
                self.links = [_open_links(boundaries, axis) for axis in range(3)]
        self.equation = couple(coarse_diffusion.astype(np.float64), 2.0 / n, coarse_boundaries)
        if self.varies:
            self.equation[0][...] += (sigma_hat * (2.0 / n) ** 2) * self._means((1.0 - albedo) * density)
        elif not self.conservative:
            self.equation[0][...] += (sigma_hat * (1.0 - albedo) * (2.0 / n) ** 2) * self._means(density)
        self.leaving, self.within = self._source_shares()

    def _source_shares(self) -> tuple[np.ndarray, np.ndarray]:
        """Share of the source function in the radiance that leaves a cell, and in its mean within it.

        float32 (3, x, y, z), for each kind of neighbour: across a face, an edge or a corner. These are 1 - exp(-tau)
        and 1 - (1 - exp(-tau)) / tau.
        """
        n = len(self.density)
        extinction = self.extinction
        if self.boundaries is not None:
            extinction = np.where(self.boundaries.inside, np.float32(n * 1e3), extinction)
        lengths = np.sqrt([1.0, 2.0, 3.0]).astype(np.float32) / np.float32(n)
        tau = np.maximum(extinction * lengths[:, None, None, None], MIN_DEPTH)
        lost = one_minus_exp(tau)
        # The difference from 1 loses all digits in thin cells.
        return lost, np.where(tau < THIN_CELL, tau * (0.5 - tau * (1.0 / 6.0 - tau / 24.0)), 1.0 - lost / tau)

    def light(self, sun: np.ndarray, visibility: np.ndarray | float = 1.0, cancel: CancelToken = NEVER) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of the scattered light of a sun of irradiance 1.

        sun: (3,) unit vector in the cube's frame. visibility: (x, y, z), fraction of its light that surfaces let
        through. Raises Cancelled.
        """
        n = len(self.density)
        tau = self.sigma * sun_optical_depth(self.density, sun, 1.0 / n, self.kernels)
        # Mean of the beam over a cell, exact for a beam along an axis.
        half = np.float32(0.5 / n) * self.extinction
        beam = visibility * np.exp(-np.maximum(tau - half, 0.0)) * (1.0 - self.within[0])
        phases = [self._phases(steps, sun) for steps in STEPS]
        # The quadrature of the phase function need not be exactly 1.
        total = (
            4.0
            * np.pi
            * sum((_solid_angles(steps) * phase).sum() for steps, pair in zip(STEPS, phases) for phase in pair)
        )
        field = np.zeros((5, n, n, n), np.float32)
        field[4] = beam
        source = self._source(field)
        swept, sweeps = np.empty((4, n, n, n), np.float32), SWEEPS
        follow = [
            self._follower(axis, sign, phase / total, source, swept)
            for axis, pair in enumerate(phases)
            for sign, phase in zip((1, -1), pair)
        ]
        if self.coarser is not None:
            coarse_visibility = self._means(visibility) if isinstance(visibility, np.ndarray) else visibility
            coarse = self.coarser.light(sun, coarse_visibility, cancel)
            field[:4] = [self._finer(values) for values in coarse]
            sweeps = FINE_SWEEPS
        for number in range(sweeps):
            if self.boundaries is not None:
                field *= ~self.boundaries.inside
            self._scatter(field, source)
            swept.fill(0.0)
            for one in follow:
                cancel.check()
                one()
            change = self.albedo * self.extinction * (swept[0] - field[0])
            if self.boundaries is not None:
                change *= ~self.boundaries.inside
            if number == sweeps - 1 or np.abs(change).sum() <= CONVERGED * (self.extinction * swept[0]).sum():
                break
            field[:4] = swept
            self._correct(field, change, cancel)
        return swept

    def lamp(self, beam: "Beam", cancel: CancelToken = NEVER) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of the scattered light of a lamp.

        beam: of the lamp, on any number of cells. Raises Cancelled.
        """
        n = len(self.density)
        light, towards = beam(self, cancel)
        field, sweeps = np.zeros((5, n, n, n), np.float32), SWEEPS
        beams, source = self._beams(light.astype(np.float32), towards.astype(np.float32)), self._source(field)
        if self.varies:
            beams *= self.albedo
        swept = np.empty((4, n, n, n), np.float32)
        follow = self._lamp_followers(source, beams, [swept] * 6)
        if self.coarser is not None:
            field[:4] = [self._finer(values) for values in self.coarser.lamp(beam, cancel)]
            sweeps = FINE_SWEEPS
        for number in range(sweeps):
            self._sweep_lamp(field, source, swept, follow, cancel)
            change = self.albedo * self.extinction * (swept[0] - field[0])
            if self.boundaries is not None:
                change *= ~self.boundaries.inside
            if number == sweeps - 1 or np.abs(change).sum() <= CONVERGED * (self.extinction * swept[0]).sum():
                break
            field[:4] = swept
            self._correct(field, change, cancel)
        return swept

    def moments(self, first: np.ndarray, beams: np.ndarray | None = None, cancel: CancelToken = NEVER) -> np.ndarray:
        """What becomes of light that scatters: radiance times each of `spherical_harmonics` of where it goes.

        float32 (16, x, y, z). first: fluence and flux, float32 (4, x, y, z), of light that is not in the result. beams:
        float32 (26, x, y, z), other light that scatters along each of ORDINATES, for albedo 1, or None. Not where the
        albedo varies. Raises Cancelled.
        """
        n = len(self.density)
        thickness = (self.extinction**2).sum() / max(float(self.extinction.sum()), 1e-30) / n
        if self.coarser is None or thickness > THICK_CELL:
            again = self._scattered_again(first, beams, cancel)
        else:
            # Smooth enough for cells twice as large.
            coarse_first = np.stack([self._means(values) for values in first])
            coarse_beams = None if beams is None else np.stack([self._means(values) for values in beams])
            again = self.coarser._scattered_again(coarse_first, coarse_beams, cancel)
            again = np.stack([self._finer(values) for values in again])
        field, radiance = np.zeros((5, n, n, n), np.float32), np.empty((len(ORDINATES), n, n, n), np.float32)
        np.add(first, again, out=field[:4])
        self._limit_flux(field)
        follow = self._lamp_followers(field, beams, np.split(radiance, INFLOW_ENDS))
        self._sweep_lamp(field, field, radiance, follow, cancel)
        weights = spherical_harmonics(-ORDINATES) * (4.0 * np.pi * ORDINATE_WEIGHTS)
        return product_of_columns(weights.astype(np.float32), radiance.reshape(len(radiance), -1)).reshape(-1, n, n, n)

    def _scattered_again(self, first: np.ndarray, beams: np.ndarray | None, cancel: CancelToken) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of what `moments` finds."""
        n = len(self.density)
        again, swept = np.zeros((4, n, n, n), np.float32), np.empty((4, n, n, n), np.float32)
        field = np.zeros((5, n, n, n), np.float32)
        follow = self._lamp_followers(field, beams, [swept] * 6)
        for number in range(EXACT_SWEEPS):
            np.add(first, again, out=field[:4])
            self._limit_flux(field)
            self._sweep_lamp(field, field, swept, follow, cancel)
            change = self.albedo * self.extinction * (swept[0] - again[0])
            if self.boundaries is not None:
                change *= ~self.boundaries.inside
            again[:] = swept
            most = EXACTLY_CONVERGED * (self.extinction * (swept[0] + first[0])).sum()
            if number == EXACT_SWEEPS - 1 or np.abs(change).sum() <= most:
                break
            self._correct(again, change, cancel)
        return again

    def _lamp_followers(
        self, source: np.ndarray, beams: np.ndarray | None, swept: Sequence[np.ndarray]
    ) -> list[Callable[[], object]]:
        """What follows light along all directions; source and beams: as for `_follower`, swept: for each axis and sign.

        Beams are those of each direction, so that no light is lost whatever the quadrature of the phase function.
        """
        sides = [(axis, sign) for axis in range(3) for sign in (1, -1)]
        parts = [None] * len(sides) if beams is None else np.split(beams, INFLOW_ENDS)
        return [
            self._follower(axis, sign, np.ones(len(STEPS[axis])), source, one, beams=some)
            for (axis, sign), some, one in zip(sides, parts, swept)
        ]

    def _sweep_lamp(
        self,
        field: np.ndarray,
        source: np.ndarray,
        swept: np.ndarray,
        follow: Sequence[Callable[[], object]],
        cancel: CancelToken,
    ) -> None:
        """Fill what the followers add to with the light of a field (5, x, y, z), and of the beams."""
        if self.boundaries is not None:
            field *= ~self.boundaries.inside
        self._scatter(field, source)
        swept.fill(0.0)
        for one in follow:
            cancel.check()
            one()

    def _beams(self, light: np.ndarray, towards: np.ndarray) -> np.ndarray:
        """Light of a beam that scatters along each of ORDINATES, for albedo 1: float32 (26, x, y, z).

        light: float32 (x, y, z). towards: float32 (3, x, y, z), unit vectors against the beam.
        """
        beams = np.zeros((len(ORDINATES), *light.shape), np.float32)
        flat, towards, lit = beams.reshape(len(ORDINATES), -1), towards.reshape(3, -1), np.flatnonzero(light)
        # Henyey and Greenstein's phase function but for a factor, which the quadrature divides out.
        g = np.float32(abs(self.anisotropy))
        turned = (np.copysign(1.0, self.anisotropy) * ORDINATES).astype(np.float32)
        weights = (4.0 * np.pi * ORDINATE_WEIGHTS).astype(np.float32)
        for start in range(0, len(lit), BEAMS_PER_BLOCK):
            some = lit[start : start + BEAMS_PER_BLOCK]
            phases = np.maximum(1 - turned @ towards[:, some], np.float32(0.0))
            phases *= 2 * g
            phases += (1 - g) ** 2
            phases *= np.sqrt(phases)
            np.reciprocal(phases, out=phases)
            flat[:, some] = phases * (light.reshape(-1)[some] / np.einsum("dn,d->n", phases, weights))
        return beams

    def environment(self, radiance: np.ndarray, cancel: CancelToken = NEVER) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of all light of an environment, unscattered light included.

        radiance: (26,), that arrives from ORDINATES. Linear in it. Raises Cancelled.
        """
        n = len(self.density)
        field, swept, sweeps = np.zeros((5, n, n, n), np.float32), np.empty((4, n, n, n), np.float32), SWEEPS
        entering = iter(np.split(np.asarray(radiance, np.float32), INFLOW_ENDS))
        source = self._source(field)
        follow = [
            self._follower(axis, sign, np.zeros(len(steps)), source, swept, np.ascontiguousarray(next(entering)))
            for axis, steps in enumerate(STEPS)
            for sign in (1, -1)
        ]
        if self.coarser is not None:
            field[:4] = [self._finer(values) for values in self.coarser.environment(radiance, cancel)]
            sweeps = FINE_SWEEPS
        elif self.conservative:
            # Exact for even light, which no albedo of 1 changes.
            field[0] = 4.0 * np.pi * (ORDINATE_WEIGHTS @ radiance)
        for number in range(sweeps):
            self._scatter(field, source)
            swept.fill(0.0)
            for one in follow:
                cancel.check()
                one()
            change = self.albedo * self.extinction * (swept[0] - field[0])
            if number == sweeps - 1 or np.abs(change).sum() <= CONVERGED * (self.extinction * swept[0]).sum():
                break
            field[:4] = swept
            self._correct(field, change, cancel, limit=False)
        return swept

    def unscattered(self, sun: np.ndarray, visibility: np.ndarray | float = 1.0) -> np.ndarray:
        """Fluence float32 (x, y, z) of a sun's light that counts as unscattered, as of `light`, in cells' centres."""
        tau = self.sigma * sun_optical_depth(self.density, sun, 1.0 / len(self.density), self.kernels)
        return visibility * np.exp(-tau)

    def _source(self, field: np.ndarray) -> np.ndarray:
        """What sweeps read in place of a field (5, x, y, z): itself, unless the albedo varies."""
        return np.empty_like(field) if self.varies else field

    def _scatter(self, field: np.ndarray, source: np.ndarray) -> None:
        """Fill the source of sweeps with what of a field scatters, if the albedo varies."""
        if self.varies:
            np.multiply(field, self.albedo, out=source)

    def _phases(self, steps: np.ndarray, sun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Henyey-Greenstein phase function of the beam along steps and along their opposites, (D,) each."""
        cosine = -(steps @ sun) / np.sqrt((steps**2).sum(axis=1))
        return henyey_greenstein(cosine, self.anisotropy), henyey_greenstein(-cosine, self.anisotropy)

    def _correct(self, field: np.ndarray, change: np.ndarray, cancel: CancelToken, limit: bool = True) -> None:
        """Add the diffusion of sources (x, y, z) that the field, (5, x, y, z), has not scattered yet.

        limit: whether sources are kept from being negative, which makes the solution not quite linear.
        """
        n = len(self.density)
        source = self._means(change) * np.float32((2.0 / n) ** 2)
        found = solve(self.equation, source, -np.inf, TOLERANCE, MAX_ITERATIONS, self.kernels, cancel)
        more = self._finer(found.astype(np.float32))
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

    def _means(self, values: np.ndarray) -> np.ndarray:
        """Means of 2 x 2 x 2 cells."""
        means = np.empty([n // 2 for n in values.shape], np.float32)
        halve(np.ascontiguousarray(values, np.float32), means, self.kernels)
        return means

    def _follower(
        self,
        axis: int,
        sign: int,
        phase: np.ndarray,
        field: np.ndarray,
        swept: np.ndarray,
        entering: np.ndarray | None = None,
        beams: np.ndarray | None = None,
    ) -> Callable[[], object]:
        """What adds the light along the steps of an axis, or their opposites, to fluence and flux (4, x, y, z).

        phase: (D,), of the beam. field: (5, x, y, z), whose sources emit the light: phi, F and the beam. entering:
        float32 (D,), radiance at the faces of the cube, or None. beams: float32 (D, x, y, z), of each step, in place of
        the field's; with them, swept may be the mean radiance along each step in each cell, (D, x, y, z).
        """
        steps = sign * STEPS[axis]
        links = None if self.links is None else self.links[axis][sign]
        emit, gather = self._weights(steps, phase)
        if self.kernels is None:
            return lambda: self._follow_steps(axis, steps, (emit, gather), (field, beams), swept, links, entering)
        n = len(self.density)
        data = OrdinateSweep(
            cells=n,
            axis=axis,
            sign=sign,
            directions=len(steps),
            steps=np.ascontiguousarray(np.delete(steps, axis, 1), np.int64),
            kinds=np.abs(steps).sum(axis=1) - 1,
            emit=emit,
            gather=gather if len(swept) == SUMS else None,
            field=field,
            beams=beams,
            leaving=self.leaving,
            within=self.within,
            links=links,
            entering=entering,
            sums=swept,
            scratch=np.empty(2 * len(steps) * (n + 2) ** 2 + 12 * n, np.float32),
        )
        return functools.partial(self.kernels.prepare, "sweep_ordinates", data)

    def _weights(self, steps: np.ndarray, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights of a field in the sources of steps, float32 (D, 5), and of their light in its sums, (D, 4)."""
        unit = np.concatenate([np.ones((len(steps), 1)), steps / np.sqrt(np.abs(steps).sum(axis=1))[:, None]], axis=1)
        albedo = np.float32(1.0) if self.varies else self.albedo
        scattered = albedo * unit * [1.0, *[3.0 * self.anisotropy] * 3] / (4.0 * np.pi)
        phase = albedo * phase
        gather = 4.0 * np.pi * _solid_angles(steps)[:, None] * unit
        return np.concatenate([scattered, phase[:, None]], axis=1).astype(np.float32), gather.astype(np.float32)

    def _follow_steps(
        self,
        axis: int,
        steps: np.ndarray,
        weights: tuple[np.ndarray, np.ndarray],
        light: tuple[np.ndarray, np.ndarray | None],
        swept: np.ndarray,
        links: np.ndarray | None,
        entering: np.ndarray | None,
    ) -> None:
        """Add fluence and flux of light along steps (D, 3), all of which lead to one side along an axis, to `swept`.

        weights: from `_weights`. light: field and beams; these, swept and entering: as for `_follower`.
        """
        n, kinds = len(self.density), np.abs(steps).sum(axis=1) - 1
        (emit, gather), (field, beams) = weights, light
        across = [place for place in range(3) if place != axis]
        field, swept, leaving, within = (
            np.moveaxis(values, 1 + axis, 0) for values in (field, swept, self.leaving, self.within)
        )
        if beams is not None:
            beams = np.moveaxis(beams, 1 + axis, 0)
        # Light that leaves the previous slice, with a border of what enters.
        passing = np.zeros((len(steps), n + 2, n + 2), np.float32)
        if entering is not None:
            passing[:] = entering[:, None, None]
        for k in range(n)[:: steps[0, axis]]:
            arriving = np.stack(
                [previous[1 - b : 1 - b + n, 1 - c : 1 - c + n] for previous, (b, c) in zip(passing, steps[:, across])]
            )
            if links is not None:
                arriving *= links[k]
            # Within a cell radiance tends towards the source function: I = I_0 + (S - I_0) (1 - exp(-tau)).
            parts = field[k] if beams is None else [*field[k][:4], beams[k]]
            source = sum(weight[:, None, None] * part for weight, part in zip(emit.T, parts))
            rise = source - arriving
            passing[:, 1:-1, 1:-1] = arriving + rise * leaving[k][kinds]
            mean = arriving + rise * within[k][kinds]
            if swept.shape[1] == SUMS:
                swept[k] += (gather[:, :, None, None] * mean[:, None]).sum(axis=0)
            else:
                swept[k] = mean


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
        found[sign] = np.ascontiguousarray(np.stack(links, axis=1), np.float32)
    return found


def _interpolated(values: np.ndarray) -> np.ndarray:
    """Values (x, y, z) on cells half as large, linear between the centres of the large ones."""
    for axis in range(3):
        v = np.moveaxis(np.pad(values, [(int(a == axis),) * 2 for a in range(3)], mode="edge"), axis, 0)
        halves = np.stack([0.25 * v[:-2] + 0.75 * v[1:-1], 0.75 * v[1:-1] + 0.25 * v[2:]], axis=1)
        values = np.moveaxis(halves.reshape(-1, *v.shape[1:]), 0, axis)
    return values
