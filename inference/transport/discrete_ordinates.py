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
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from ..grids.halving import doubled, halve
from ..kernels.library import call
from ..numerics.small_matmul import product_of_columns
from ..numerics.spherical_harmonics import spherical_harmonics
from ..occluders.cell_boundaries import CellBoundaries
from ..plan.resolution import TRANSPORT_CELLS
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.phase_function import reduced_anisotropy
from .diffusion import THIN, couple, solve
from .ordinate_sweeps import OrdinateSweeps
from .ordinates import ORDINATE_WEIGHTS, ORDINATES

#: Level of the density pyramid that has these cells, and its cells along an edge of the cube.
LEVEL, CELLS = 2, TRANSPORT_CELLS
# Cells along an edge from which on the light is first solved on cells twice as large.
MULTILEVEL_CELLS = 64
# At most so many sweeps, and so many after larger cells; they end when less than a fraction of the scattered light
# changes. Too few leave dense media too dark, each by a different factor. Of environments, whose network knows no
# better, few are made.
SWEEPS, FINE_SWEEPS, CONVERGED = 8, 8, 5e-4
ENVIRONMENT_FINE_SWEEPS, ENVIRONMENT_CONVERGED = 2, 0.002
# The same where the light is the answer and no feature: in dense media little changes in each of many sweeps.
EXACT_SWEEPS, EXACTLY_CONVERGED = 40, 1e-3
# Mean optical thickness of cells where light collides, from which on what scatters again is not smooth enough for cells
# twice as large.
THICK_CELL = 0.25
# Tolerance and maximal iterations of the diffusion solver, which works on cells twice as large.
TOLERANCE, MAX_ITERATIONS = 0.1, 40
# Numerical diffusion: even opaque cells pass light to their neighbours as if D were this fraction of their edge.
CELL_DIFFUSION = 0.2
# Change of the fluence's logarithm from cells to those half as large, over that from cells twice as large to these;
# measured. By what factor the latter may change at most, and what is added to fluences before they are compared.
REFINEMENT, MOST_REFINED, LEAST_FLUENCE = 0.4, 4.0, np.float32(1e-6)
# What follows light along the steps of one side.
Follower = Callable[[], object]


class Fields(NamedTuple):
    """Light of one solution.

    field: float32 (5, x, y, z), fluence and flux that are to scatter, and the fluence of a beam. source: of the same
    shape, what sweeps read; the field itself unless the albedo varies. swept: float32 (4, x, y, z), fluence and flux
    of what a sweep has scattered, or (26, x, y, z), radiance along each of ORDINATES.
    """

    field: np.ndarray
    source: np.ndarray
    swept: np.ndarray

    def start(self, light: Iterable[np.ndarray]) -> None:
        """Let this fluence and flux, (x, y, z) each, be what scatters next."""
        for values, begun in zip(self.field, light):
            values[...] = begun


class CellSource(Protocol):
    """What lights the cells of a solver."""

    @property
    def linear(self) -> bool:
        """Whether the solution has to be linear in it."""

    def followers(self, solver: "DiscreteOrdinates", fields: Fields, cancel: CancelToken) -> Sequence[Follower]:
        """How its light is followed in sweeps; may add to the fields what it knows of them. Raises Cancelled."""

    def coarser(self, solver: "DiscreteOrdinates") -> "CellSource":
        """The same for cells twice as large."""
        return self

    def arriving(self, solver: "DiscreteOrdinates", cancel: CancelToken = NEVER) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of all of its light, beams included. Raises Cancelled."""
        return solver.solve(self, cancel)

    def unscattered(self, solver: "DiscreteOrdinates", cancel: CancelToken = NEVER) -> np.ndarray:
        """As `arriving`, of a beam that has not scattered, not even within the forward peak. Raises Cancelled."""
        return np.zeros((4, *solver.density.shape), np.float32)


class DiscreteOrdinates:
    """Solver for the light in one medium, of any source.

    density: float32 (n, n, n), a level of the density pyramid, n being CELLS or half of it. sigma_hat: extinction per
    unit density times the cube's edge. anisotropy: G > -1. triangles: (T, 3, 3), in the cube's frame, of black
    surfaces, or None. albedo: in (0, 1], or (n, n, n) in [0, 1] where it varies.
    """

    def __init__(
        self,
        density: np.ndarray,
        sigma_hat: float,
        anisotropy: float,
        triangles: np.ndarray | None = None,
        albedo: float | np.ndarray = 1.0,
    ) -> None:
        n = len(density)
        self.matter, self.sigma_hat = density, sigma_hat
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
        self._medium = sigma_hat, anisotropy, triangles, albedo
        self.coarser = self.larger if n >= MULTILEVEL_CELLS else None
        self.diffusion = 1.0 / (3.0 * reduced + np.float32(THIN)) + np.float32(CELL_DIFFUSION / n)
        coarse_diffusion = 1.0 / (3.0 * self.means(reduced) + np.float32(THIN)) + np.float32(CELL_DIFFUSION / n)
        self.boundaries: CellBoundaries | None = None
        coarse_boundaries = None
        if triangles is not None and len(triangles):
            boundaries = CellBoundaries(triangles, n)
            if not boundaries.empty:
                self.boundaries, coarse_boundaries = boundaries, CellBoundaries(triangles, n // 2)
        self.equation = couple(coarse_diffusion.astype(np.float64), 2.0 / n, coarse_boundaries)
        if self.varies:
            self.equation[0][...] += (sigma_hat * (2.0 / n) ** 2) * self.means((1.0 - albedo) * density)
        elif not self.conservative:
            self.equation[0][...] += (sigma_hat * (1.0 - albedo) * (2.0 / n) ** 2) * self.means(density)
        scattering = float(1.0 if self.varies else self.albedo), self.anisotropy
        self.sweeps = OrdinateSweeps(self.extinction, scattering, self.boundaries)

    @functools.cached_property
    def larger(self) -> "DiscreteOrdinates":
        """The solver on cells twice as large."""
        sigma_hat, anisotropy, triangles, albedo = self._medium
        means = self.means(self.matter)
        if isinstance(albedo, np.ndarray):
            albedo = self.means(albedo * self.matter) / np.maximum(means, np.float32(1e-30))
        return DiscreteOrdinates(means, sigma_hat, anisotropy, triangles, albedo)

    def extrapolated(self, source: CellSource, octaves: int, cancel: CancelToken = NEVER) -> np.ndarray:
        """As `solve`, about as on cells so many octaves smaller.

        Solutions on larger cells tell how the fluence changes with their size (Richardson's extrapolation); the ratio
        of the flux to the fluence stays. Surfaces cut cells of different sizes differently: beside them nothing is
        extrapolated. Raises Cancelled.
        """
        found = self.solve(source, cancel)
        if not octaves or self.boundaries is not None:
            return found
        larger = self._finer(self.larger.solve(source.coarser(self), cancel)[0])
        ratio = (found[0] + LEAST_FLUENCE) / (np.maximum(larger, 0.0) + LEAST_FLUENCE)
        power = sum(REFINEMENT**octave for octave in range(1, octaves + 1))
        found *= np.clip(ratio, 1.0 / MOST_REFINED, MOST_REFINED) ** np.float32(power)
        return found

    def solve(self, source: CellSource, cancel: CancelToken = NEVER) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of the light of a source, as it says. Raises Cancelled."""
        fields = self._fields()
        follow = source.followers(self, fields, cancel)
        if self.coarser is not None:
            coarse = self.coarser.solve(source.coarser(self), cancel)
            fields.start(self._finer(values) for values in coarse)
        return self._converge(fields, follow, cancel, source.linear)

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
            coarse_first = np.stack([self.means(values) for values in first])
            coarse_beams = None if beams is None else np.stack([self.means(values) for values in beams])
            again = self.coarser._scattered_again(coarse_first, coarse_beams, cancel)
            again = np.stack([self._finer(values) for values in again])
        field, radiance = np.zeros((5, n, n, n), np.float32), np.empty((len(ORDINATES), n, n, n), np.float32)
        np.add(first, again, out=field[:4])
        self._bound(field)
        follow = self.sweeps.followers(field, radiance, beams=beams)
        self._sweep(Fields(field, field, radiance), follow, cancel)
        weights = spherical_harmonics(-ORDINATES) * (4.0 * np.pi * ORDINATE_WEIGHTS)
        return product_of_columns(weights.astype(np.float32), radiance.reshape(len(radiance), -1)).reshape(-1, n, n, n)

    def _scattered_again(self, first: np.ndarray, beams: np.ndarray | None, cancel: CancelToken) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of what `moments` finds."""
        fields = self._fields()
        field, swept = fields.field, fields.swept
        again = np.zeros_like(swept)
        follow = self.sweeps.followers(field, swept, beams=beams)
        for number in range(EXACT_SWEEPS):
            np.add(first, again, out=field[:4])
            self._bound(field)
            self._sweep(fields, follow, cancel)
            change = self._newly_scattered(swept, again)
            again[:] = swept
            most = EXACTLY_CONVERGED * (self.extinction * (swept[0] + first[0])).sum()
            if number == EXACT_SWEEPS - 1 or np.abs(change).sum() <= most:
                break
            self._correct(again, change, cancel)
        return again

    def _fields(self) -> "Fields":
        """Without any light."""
        n = len(self.density)
        field = np.zeros((5, n, n, n), np.float32)
        source = np.empty_like(field) if self.varies else field
        return Fields(field, source, np.empty((4, n, n, n), np.float32))

    def _converge(
        self, fields: "Fields", follow: Sequence[Follower], cancel: CancelToken, linear: bool = False
    ) -> np.ndarray:
        """Sweep, and correct by diffusion, until little changes; returns what is `swept`.

        follow: of `OrdinateSweeps.followers` of these fields. linear: as of CellSource.
        """
        fine, converged = FINE_SWEEPS, CONVERGED
        if linear:
            fine, converged = ENVIRONMENT_FINE_SWEEPS, ENVIRONMENT_CONVERGED
        field, swept = fields.field, fields.swept
        sweeps = SWEEPS if self.coarser is None else fine
        for number in range(sweeps):
            self._sweep(fields, follow, cancel)
            change = self._newly_scattered(swept, field)
            if number == sweeps - 1 or np.abs(change).sum() <= converged * (self.extinction * swept[0]).sum():
                break
            fields.start(swept)
            self._correct(field, change, cancel, limit=not linear)
        return swept

    def _sweep(self, fields: "Fields", follow: Sequence[Follower], cancel: CancelToken) -> None:
        """Fill `swept` with the light that the field scatters, and that of beams; arguments: `_converge`."""
        if self.boundaries is not None:
            np.multiply(fields.field, ~self.boundaries.inside, out=fields.field)
        if self.varies:
            np.multiply(fields.field, self.albedo, out=fields.source)
        fields.swept.fill(0.0)
        for one in follow:
            cancel.check()
            one()

    def _newly_scattered(self, swept: np.ndarray, field: np.ndarray) -> np.ndarray:
        """What scatters (x, y, z), per volume, of the fluence that sweeps have added to a field's."""
        change = self.albedo * self.extinction * (swept[0] - field[0])
        if self.boundaries is not None:
            change *= ~self.boundaries.inside
        return change

    def _correct(self, field: np.ndarray, change: np.ndarray, cancel: CancelToken, limit: bool = True) -> None:
        """Add the diffusion of sources (x, y, z) that the field, (5, x, y, z), has not scattered yet.

        limit: whether sources are kept from being negative, which makes the solution not quite linear.
        """
        n = len(self.density)
        source = self.means(change) * np.float32((2.0 / n) ** 2)
        correction = solve(self.equation, source, -np.inf, TOLERANCE, MAX_ITERATIONS, cancel)
        self._bound(field, self._finer(correction.astype(np.float32)), limit)

    def _finer(self, values: np.ndarray) -> np.ndarray:
        """Values on cells half as large, interpolated between cell centres, but not if there are surfaces."""
        return doubled(values) if self.boundaries is None else values.repeat(2, 0).repeat(2, 1).repeat(2, 2)

    def _bound(self, field: np.ndarray, more: np.ndarray | None = None, limit: bool = True) -> None:
        """Add fluence (x, y, z) and its diffusion to a field, (5, x, y, z); limit it so that no source is negative.

        limit: as of `_correct`.
        """
        call(
            "correct_light",
            cells=len(self.density),
            fluence=more,
            diffusion=None if more is None else self.diffusion,
            field=field,
            limited=limit,
            most_flux=3.0 * abs(self.anisotropy),
        )

    def means(self, values: np.ndarray) -> np.ndarray:
        """Means of 2 x 2 x 2 cells."""
        means = np.empty([n // 2 for n in values.shape], np.float32)
        halve(np.ascontiguousarray(values, np.float32), means)
        return means
