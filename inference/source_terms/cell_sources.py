# SPDX-License-Identifier: GPL-3.0-or-later
"""Light as the coarse transport takes it in: a sun's beam, a lamp's, or what enters through the faces of the cube."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..grids.optical_depth_sweep import sun_optical_depth
from ..numerics.small_matmul import product
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.phase_function import henyey_greenstein
from ..transport.discrete_ordinates import CellSource, DiscreteOrdinates, Fields, Follower
from ..transport.ordinates import ORDINATE_WEIGHTS, ORDINATES, SIDES, STEPS, solid_angles
from .lamp_beam import CubeCells

# Cells whose beams are found at once: few enough for matrix products that stay on this thread.
BEAMS_PER_BLOCK = 1024

# Mean of a lamp's unscattered light over each cell of a solver, (x, y, z), and unit vectors (3, x, y, z) towards it.
Beam = Callable[[DiscreteOrdinates | CubeCells, CancelToken], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class SunBeam:
    """A sun of irradiance 1; a `CellSource` of its scattered light.

    direction: (3,) unit vector towards it, in the cube's frame. visibility: (x, y, z), fraction of its light that
    surfaces let through.
    """

    direction: np.ndarray
    visibility: np.ndarray | float = 1.0
    linear = False

    def followers(self, solver: DiscreteOrdinates, fields: Fields, cancel: CancelToken) -> Sequence[Follower]:
        """As of CellSource."""
        n = len(solver.density)
        tau = solver.sigma * sun_optical_depth(solver.density, self.direction, 1.0 / n)
        # Mean of the beam over a cell, exact for a beam along an axis.
        half = np.float32(0.5 / n) * solver.extinction
        fields.field[4] = self.visibility * np.exp(-np.maximum(tau - half, 0.0)) * (1.0 - solver.sweeps.within[0])
        phases = [self._phase(solver, sign * STEPS[axis]) for axis, sign in SIDES]
        # The quadrature of the phase function need not be exactly 1.
        angles = [solid_angles(STEPS[axis]) for axis, _ in SIDES]
        total = 4.0 * np.pi * sum((angle * phase).sum() for angle, phase in zip(angles, phases))
        return solver.sweeps.followers(fields.source, fields.swept, phases=[phase / total for phase in phases])

    def coarser(self, solver: DiscreteOrdinates) -> "SunBeam":
        """As of CellSource."""
        visibility = self.visibility
        return replace(self, visibility=solver.means(visibility)) if isinstance(visibility, np.ndarray) else self

    def arriving(self, solver: DiscreteOrdinates, cancel: CancelToken = NEVER) -> np.ndarray:
        """As of CellSource."""
        return solver.solve(self, cancel) + self._beam(solver.density, float(solver.sigma))

    def unscattered(self, solver: DiscreteOrdinates, cancel: CancelToken = NEVER) -> np.ndarray:
        """As of CellSource."""
        return self._beam(solver.matter, solver.sigma_hat)

    def _beam(self, density: np.ndarray, sigma: float) -> np.ndarray:
        """Fluence and flux at the middles of cells, of an extinction for density 1."""
        depth = sun_optical_depth(density, self.direction, 1.0 / len(density))
        return _flowing(self.visibility * np.exp(-np.float32(sigma) * depth), -self.direction.reshape(3, 1, 1, 1))

    def _phase(self, solver: DiscreteOrdinates, steps: np.ndarray) -> np.ndarray:
        """Henyey-Greenstein phase function (D,) of the beam along steps (D, 3)."""
        cosine = -product(steps, self.direction) / np.sqrt((steps**2).sum(axis=1))
        return henyey_greenstein(cosine, solver.anisotropy)


@dataclass(frozen=True)
class LampBeam(CellSource):
    """Lamps; a `CellSource` of their scattered light. beams: of lamps of power 1, each with a factor."""

    beams: Sequence[tuple[Beam, float]]
    linear = False

    def followers(self, solver: DiscreteOrdinates, fields: Fields, cancel: CancelToken) -> Sequence[Follower]:
        """As of CellSource."""
        beams = np.zeros((len(ORDINATES), *solver.density.shape), np.float32)
        for light, towards in self._lit(solver, cancel):
            beams += scattered_beams(light, towards.astype(np.float32), solver.anisotropy)
        if solver.varies:
            beams *= solver.albedo
        return solver.sweeps.followers(fields.source, fields.swept, beams=beams)

    def arriving(self, solver: DiscreteOrdinates, cancel: CancelToken = NEVER) -> np.ndarray:
        """As of CellSource."""
        return solver.solve(self, cancel) + self._flowing(solver, cancel)

    def unscattered(self, solver: DiscreteOrdinates, cancel: CancelToken = NEVER) -> np.ndarray:
        """As of CellSource."""
        return self._flowing(CubeCells(solver.matter, solver.sigma_hat), cancel)

    def _flowing(self, cells: DiscreteOrdinates | CubeCells, cancel: CancelToken) -> np.ndarray:
        return np.sum([_flowing(light, -towards) for light, towards in self._lit(cells, cancel)], axis=0)

    def _lit(
        self, cells: DiscreteOrdinates | CubeCells, cancel: CancelToken
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for beam, power in self.beams:
            light, towards = beam(cells, cancel)
            yield (light * power).astype(np.float32), towards


@dataclass(frozen=True)
class EnteringLight(CellSource):
    """Light of an environment; a `CellSource` of all of it, unscattered light included, and linear in it.

    radiance: (26,), that arrives from ORDINATES. visible: float32 (26, m, m, m), the share of it that surfaces let
    through to the outermost of the cube's cells, any number of them; None where it is all of it.
    """

    radiance: np.ndarray
    visible: np.ndarray | None = None
    linear = True

    def followers(self, solver: DiscreteOrdinates, fields: Fields, cancel: CancelToken) -> Sequence[Follower]:
        """As of CellSource."""
        if solver.coarser is None and solver.conservative:
            # Exact for even light, which no albedo of 1 changes.
            fields.field[0] = 4.0 * np.pi * (ORDINATE_WEIGHTS @ self.radiance)
        entering, visible = np.asarray(self.radiance, np.float32), self.visible
        if visible is not None:
            n, most = len(solver.density), visible.shape[1] - 1
            nearest = np.rint(np.arange(n) * (most / (n - 1))).astype(int)
            visible = visible[np.ix_(range(len(visible)), *[nearest] * 3)]
        return solver.sweeps.followers(fields.source, fields.swept, entering=entering, visible=visible)


def _flowing(light: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Fluence and flux, float32 (4, x, y, z), of light (x, y, z) that goes along unit vectors, (3, x, y, z) or one."""
    return np.concatenate([light[None], light * along]).astype(np.float32)


def scattered_beams(light: np.ndarray, towards: np.ndarray, anisotropy: float) -> np.ndarray:
    """Light of a beam that scatters along each of ORDINATES, for albedo 1: float32 (26, x, y, z).

    light: float32 (x, y, z). towards: float32 (3, x, y, z), unit vectors against the beam.
    """
    beams = np.zeros((len(ORDINATES), *light.shape), np.float32)
    flat, towards, lit = beams.reshape(len(ORDINATES), -1), towards.reshape(3, -1), np.flatnonzero(light)
    # Henyey and Greenstein's phase function but for a factor, which the quadrature divides out.
    g = np.float32(abs(anisotropy))
    turned = (np.copysign(1.0, anisotropy) * ORDINATES).astype(np.float32)
    weights = (4.0 * np.pi * ORDINATE_WEIGHTS).astype(np.float32)
    for start in range(0, len(lit), BEAMS_PER_BLOCK):
        block = lit[start : start + BEAMS_PER_BLOCK]
        phases = np.maximum(1 - turned @ towards[:, block], np.float32(0.0))
        phases *= 2 * g
        phases += (1 - g) ** 2
        phases *= np.sqrt(phases)
        np.reciprocal(phases, out=phases)
        flat[:, block] = phases * (light.reshape(-1)[block] / np.einsum("dn,d->n", phases, weights))
    return beams
