# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that volumes emit and scatter.

Radiance is swept along directions over coarse cells, with scattering reduced to sigma_s' = sigma_s (1 - G), as if it
were isotropic. The first sweep gives the unscattered light; a few more give all light scattered by the fluence phi so
far. The part of the fluence that a sweep still lacks follows from a diffusion equation,

    -div(D grad psi) + sigma_a psi = sigma_s' (phi_new - phi_old),
    D = 1 / (3 sigma_tr),    sigma_tr = sigma_a + sigma_s',

so that three sweeps suffice where light scatters a hundred times (diffusion synthetic acceleration). The fluence phi
and the flux J of the radiance are stored, and a point scatters towards the camera, along -omega,

    albedo / (4 pi) (phi - 3 G J . omega).
"""

from collections.abc import Sequence

import numpy as np

from ..grids.grid import Grid
from ..grids.merge import resampled
from ..numerics.interpolation import sample_padded
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Medium
from .diffusion import THIN, couple, solve
from .radiance_sweep import sweep_radiance

# Cells along the longest edge of the box around the volumes.
CELLS = 32
# Directions along an edge of each face of a cube: for unscattered light, which is sharper, and for scattered light.
DIRECT, SCATTERED = 6, 4
ROUNDS = 3
# Reduced optical thickness of a cell above which the light varies within cells.
THICK = 1.0

# Absorption, reduced scattering and normalised emission of a channel, and their fluence and flux.
Solved = tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class ScatteredEmission:
    """Fluence and flux of the light that some volumes emit, in three colour channels.

    grids, media: Grid and Medium of each volume. thickest: largest reduced optical
    thickness of a cell. Raises Cancelled.
    """

    def __init__(
        self,
        grids: Sequence[Grid],
        media: Sequence[Medium],
        cancel: CancelToken = NEVER,
    ) -> None:
        corners = np.concatenate([grid.corners() for grid in grids])
        low, high = corners.min(axis=0), corners.max(axis=0)
        self.edge = float((high - low).max())
        self.cell, self.thickest = self.edge / CELLS, 0.0
        shape = np.maximum(np.ceil((high - low) / self.cell - 1e-6), 1).astype(int)
        self.first = 0.5 * (low + high) - 0.5 * (shape - 1) * self.cell
        frame = np.diag([*[self.cell] * 3, 1.0])
        frame[:3, 3] = self.first
        densities = [resampled(grid, grid.density, frame, shape, cancel).astype(np.float64) for grid in grids]
        scattered = [
            [resampled(grid, part, frame, shape, cancel).astype(np.float64) for part in grid.scattering]
            for grid in grids
        ]
        solved: list[Solved] = []
        self.fields: list[np.ndarray | None] = []
        for c in range(3):
            extinction, scattering, reduced, emission = np.zeros((4, *shape))
            for medium, density, varying in zip(media, densities, scattered):
                extinction += medium.sigma_t[c] * density
                albedo, part = medium.albedo[c], density
                if varying:
                    albedo, part = 1.0, varying[c if len(varying) == 3 else 0]
                scattering += medium.sigma_t[c] * albedo * part
                reduced += medium.sigma_t[c] * albedo * (1.0 - medium.anisotropy) * part
            for grid, medium in zip(grids, media):
                if grid.emission:
                    emission += medium.emission * resampled(
                        grid, grid.emission[c], frame, shape, cancel, grid.emission_power
                    )
            self.fields.append(self._field(solved, np.maximum(extinction - scattering, 0.0), reduced, emission, cancel))

    def _field(
        self,
        solved: list[Solved],
        absorption: np.ndarray,
        reduced: np.ndarray,
        emission: np.ndarray,
        cancel: CancelToken,
    ) -> np.ndarray | None:
        """Fluence and flux, (4, ...) padded for `sample_padded`, or None where nothing is emitted or scattered.

        absorption, reduced, emission: (x, y, z), coefficients and emission of a channel. solved: terms and solutions of
        earlier channels, extended; reused where the emission is proportional, because light is linear.
        """
        total = emission.sum()
        if not total > 0.0 or not reduced.any():
            return None
        asked = absorption, reduced, emission / total
        known = next((field for terms, field in solved if all(map(_close, terms, asked))), None)
        if known is None:
            known = self._solve(*asked, cancel)
            solved.append((asked, known))
        return known * np.float32(total)

    def _solve(
        self, absorption: np.ndarray, reduced: np.ndarray, emission: np.ndarray, cancel: CancelToken
    ) -> np.ndarray:
        """As `_field`, for emission that sums to 1."""
        extinction = absorption + reduced
        self.thickest = max(self.thickest, self.cell * extinction.max())
        diffusion = 1.0 / (3.0 * extinction + THIN / self.edge)
        diagonal, couplings = equation = couple(diffusion, self.cell)
        diagonal += absorption * self.cell**2
        direct, direct_flux = sweep_radiance(extinction, emission, self.cell, DIRECT, cancel)
        # Before the first round only the direct light is known.
        scattered, flux, missing = np.zeros_like(direct), np.zeros_like(direct_flux), direct
        for number in range(ROUNDS):
            if number:
                source = reduced * (direct + scattered) / (4.0 * np.pi)
                before = scattered
                scattered, flux = sweep_radiance(extinction, source, self.cell, SCATTERED, cancel)
                missing = scattered - before
            more = solve(equation, reduced * missing * self.cell**2, -np.inf, cancel=cancel)
            scattered = scattered + more
            for axis in range(3):
                if more.shape[axis] > 1:
                    flux[axis] -= diffusion * np.gradient(more, self.cell, axis=axis)
        fluence, flux = np.maximum(direct + scattered, 0.0), direct_flux + flux
        # The flux of diffusion may exceed that of all light in one direction, which is the largest possible.
        flux *= np.minimum(fluence / np.maximum(np.linalg.norm(flux, axis=0), 1e-30), 1.0)
        # Constant beyond the centres of the outermost cells.
        values = np.concatenate([fluence[None], flux])
        return np.pad(values, [(0, 0), (1, 2), (1, 2), (1, 2)], mode="edge").astype(np.float32)

    def warnings(self, name: str) -> list[str]:
        """Limits of accuracy that the medium exceeds; name: of the volumes, for messages."""
        if self.thickest < THICK:
            return []
        return [
            f"{name}: the glow that it emits and scatters is approximate in a medium as dense as this; "
            "a lower Density makes it more accurate"
        ]

    def scattered(self, c: int, positions: np.ndarray, directions: np.ndarray, anisotropy: float) -> np.ndarray:
        """Radiance (N,) in channel c that an albedo of 1 scatters towards the camera.

        positions: (N, 3) in the world. directions: (N, 3) of the camera rays. anisotropy: G.
        """
        field = self.fields[c]
        if field is None:
            return np.zeros(len(positions), np.float32)
        index = ((positions - self.first) / self.cell).T.astype(np.float32)
        fluence, *flux = (sample_padded(values, index) for values in field)
        along = sum(flux_axis * directions[:, axis] for axis, flux_axis in enumerate(flux))
        return np.maximum(fluence - 3.0 * anisotropy * along, 0.0) / (4.0 * np.pi)


def _close(a: np.ndarray, b: np.ndarray) -> bool:
    return np.allclose(a, b, rtol=1e-4, atol=1e-6 * b.max())
