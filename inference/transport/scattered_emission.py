# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that volumes emit and scatter.

Radiance is swept along directions over coarse cells, with scattering reduced to sigma_s' = sigma_s (1 - G), as if it
were isotropic. The first sweep gives the unscattered light; a few more give all light scattered by the fluence phi so
far. The part of the fluence that a sweep still lacks follows from a diffusion equation,

    -div(D grad psi) + sigma_a psi = sigma_s' (phi_new - phi_old),
    D = 1 / (3 sigma_tr),    sigma_tr = sigma_a + sigma_s',

so that four sweeps suffice where light scatters a hundred times (diffusion synthetic acceleration). It is solved on
cells twice as large. The fluence phi and the flux J of the radiance are stored. The forward peak of the phase function
scatters what arrives from ahead on the camera ray, Q, and a point scatters along -omega, times its albedo,

    G^2 Q + (1 - G^2) (phi - 3 G' J . omega) / (4 pi),    G' = G / (1 + G).

Q is what cells ahead emit and scatter beside the peak, dimmed by the extinction without the peak's. Far from the point,
larger cells are read.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..grids.grid import Grid
from ..grids.halving import doubled
from ..grids.merge import resampled
from ..numerics.interpolation import halved_means, sample_padded
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Medium
from ..scene.phase_function import reduced_anisotropy
from .diffusion import THIN, couple, solve
from .mean_free_path import light_ahead
from .radiance_sweep import sweep_radiance

# Cells along the longest edge of the box around the volumes.
CELLS = 64
# Directions along an edge of each face of a cube: for unscattered light, which is sharper, and for scattered light.
DIRECT, SCATTERED = 6, 2
ROUNDS = 4
# Reduced optical thickness of a cell above which the light varies within cells.
THICK = 1.0

# Ends of the parts of a ray on which light is gathered, in cells, and the level that is read there.
ENDS = (1.0, 3.0, 6.0, 10.0, 16.0, 24.0, 36.0, 56.0, 112.0)
LEVELS = (0, 0, 1, 2, 2, 3, 3, 4, 4)
# Lower bound of the light scattered towards the camera over that of isotropic scattering.
MIN_SHARE = 0.02


class Light(NamedTuple):
    """Of a channel, for emission that sums to 1.

    field: float32 (x + 3, y + 3, z + 3, 4), fluence and flux, padded for `sample_padded`. levels: float32 (..., 6)
    each, padded alike, the first of these cells and each other of cells twice as large: extinction without the forward
    peak's, 4 pi times emission, and the fluence and flux that scatter beside the peak.
    """

    field: np.ndarray
    levels: list[np.ndarray]


# Extinction, scattering times powers 0 to 2 of the mean cosine, and normalised emission of a channel.
Terms = tuple[np.ndarray, ...]


class ScatteredEmission:
    """Fluence and flux of the light that some volumes emit, in three colour channels.

    grids, media: Grid and Medium of each volume. lights: of each channel, a Light and its factor, or None without any.
    thickest: largest reduced optical thickness of a cell. Raises Cancelled.
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
        # Even numbers, for cells twice as large.
        shape = 2 * np.maximum(np.ceil(0.5 * (high - low) / self.cell - 1e-6), 1).astype(int)
        self.first = 0.5 * (low + high) - 0.5 * (shape - 1) * self.cell
        frame = np.diag([*[self.cell] * 3, 1.0])
        frame[:3, 3] = self.first
        densities = [resampled(grid, grid.density, frame, shape, cancel).astype(np.float64) for grid in grids]
        scattered = [
            [resampled(grid, part, frame, shape, cancel).astype(np.float64) for part in grid.scattering]
            for grid in grids
        ]
        solved: list[tuple[Terms, Light]] = []
        self.lights: list[tuple[Light, float] | None] = []
        for c in range(3):
            emission = np.zeros(shape)
            # Extinction, and scattering times powers of the mean cosine.
            extinction, *powers = np.zeros((4, *shape))
            for medium, density, varying in zip(media, densities, scattered):
                extinction += medium.sigma_t[c] * density
                albedo, part = medium.albedo[c], density
                if varying:
                    albedo, part = 1.0, varying[c if len(varying) == 3 else 0]
                for power, values in enumerate(powers):
                    values += medium.sigma_t[c] * albedo * medium.anisotropy**power * part
            for grid, medium in zip(grids, media):
                if grid.emission:
                    emission += medium.emission * resampled(
                        grid, grid.emission[c], frame, shape, cancel, grid.emission_power
                    )
            self.lights.append(self._light(solved, extinction, powers, emission, cancel))

    def _light(
        self,
        solved: list[tuple[Terms, Light]],
        extinction: np.ndarray,
        powers: list[np.ndarray],
        emission: np.ndarray,
        cancel: CancelToken,
    ) -> tuple[Light, float] | None:
        """Light and its factor, or None where nothing is emitted or scattered.

        extinction, emission: (x, y, z), of a channel. powers: scattering times powers 0 to 2 of the mean cosine.
        solved: terms and solutions of earlier channels, extended; reused where the emission is proportional, because
        light is linear.
        """
        total = float(emission.sum())
        scattering, once, twice = powers
        if not total > 0.0 or not (scattering - once).any():
            return None
        asked = extinction, *powers, emission / total
        known = next((light for terms, light in solved if all(map(_close, terms, asked))), None)
        if known is None:
            field = self._solve(np.maximum(extinction - scattering, 0.0), scattering - once, emission / total, cancel)
            fluence, *flux = np.moveaxis(field[1:-2, 1:-2, 1:-2], -1, 0)
            beside = [(scattering - twice) * fluence, *(3.0 * (once - twice) * along for along in flux)]
            cells = np.stack([extinction - twice, 4.0 * np.pi / total * emission, *beside], axis=3).astype(np.float32)
            levels = []
            for _ in range(1 + max(LEVELS)):
                levels.append(np.pad(cells, [(1, 2)] * 3 + [(0, 0)]))
                cells = _halved(cells)
            known = Light(field, levels)
            solved.append((asked, known))
        return known, total

    def _solve(
        self, absorption: np.ndarray, reduced: np.ndarray, emission: np.ndarray, cancel: CancelToken
    ) -> np.ndarray:
        """As `_field`, for emission that sums to 1."""
        extinction = absorption + reduced
        self.thickest = max(self.thickest, self.cell * extinction.max())
        edge = 2.0 * self.cell
        diffusion, coarse_diffusion = (
            1.0 / (3.0 * values + THIN / self.edge) for values in (extinction, _means(extinction))
        )
        diagonal, couplings = equation = couple(coarse_diffusion, edge)
        diagonal += _means(absorption) * edge**2
        direct, direct_flux = sweep_radiance(extinction, emission, self.cell, DIRECT, cancel)
        # Before the first round only the direct light is known.
        scattered, flux, missing = np.zeros_like(direct), np.zeros_like(direct_flux), direct
        for number in range(ROUNDS):
            if number:
                source = reduced * (direct + scattered) / (4.0 * np.pi)
                before = scattered
                scattered, flux = sweep_radiance(extinction, source, self.cell, SCATTERED, cancel)
                missing = scattered - before
            more = doubled(solve(equation, _means(reduced * missing) * edge**2, -np.inf, cancel=cancel))
            scattered = scattered + more
            for axis in range(3):
                flux[axis] -= diffusion * np.gradient(more, self.cell, axis=axis)
        fluence, flux = np.maximum(direct + scattered, 0.0), direct_flux + flux
        # The flux of diffusion may exceed that of all light in one direction, which is the largest possible.
        flux *= np.minimum(fluence / np.maximum(np.linalg.norm(flux, axis=0), 1e-30), 1.0)
        # Constant beyond the centres of the outermost cells.
        values = np.moveaxis(np.concatenate([fluence[None], flux]), 0, -1)
        return np.pad(values, [(1, 2)] * 3 + [(0, 0)], mode="edge").astype(np.float32)

    def warnings(self, name: str) -> list[str]:
        """Limits of accuracy that the medium exceeds; name: of the volumes, for messages."""
        if self.thickest < THICK:
            return []
        return [
            f"{name}: very dense, so the glow that it scatters itself is approximate; lower Density if it looks wrong"
        ]

    def scattered(
        self, channels: Sequence[int], positions: np.ndarray, directions: np.ndarray, anisotropy: float
    ) -> np.ndarray:
        """Radiance float32 (C, N) in some colour channels that an albedo of 1 scatters towards the camera.

        positions: (N, 3) in the world. directions: (N, 3) of the camera rays. anisotropy: G.
        """
        index, along = ((positions - self.first) / self.cell).T.astype(np.float32), directions.T.astype(np.float32)
        found, known = np.zeros((len(channels), len(positions)), np.float32), dict[int, np.ndarray]()
        for row, c in zip(found, channels):
            light = self.lights[c]
            if light is not None:
                if id(light[0]) not in known:
                    known[id(light[0])] = self._scattered(light[0], index, along, anisotropy)
                row[:] = known[id(light[0])] * np.float32(light[1])
        return found

    def _scattered(self, light: Light, index: np.ndarray, along: np.ndarray, anisotropy: float) -> np.ndarray:
        """Radiance (N,) of emission that sums to 1; index, along: (3, N), in cells."""
        forward, factor = anisotropy**2, np.float32(3.0 * reduced_anisotropy(anisotropy))
        here = sample_padded(light.field, index)
        radiance = _towards(here[:, 0], factor * here[:, 1:], along)
        if forward > 0.0:

            def read(number: int, distance: float) -> tuple[np.ndarray, np.ndarray]:
                level = LEVELS[number]
                at = (index + np.float32(distance) * along + np.float32(0.5)) / np.float32(2**level) - np.float32(0.5)
                values = sample_padded(light.levels[level], at) * np.float32(self.cell)
                return values[:, 0], values[:, 1] + _towards(values[:, 2], values[:, 3:], along)

            radiance = (1.0 - forward) * radiance + forward * light_ahead(read, ENDS)
        return radiance / (4.0 * np.pi)


def _towards(fluence: np.ndarray, flux: np.ndarray, along: np.ndarray) -> np.ndarray:
    """4 pi times the light (N,) that is scattered towards the camera; flux: (N, 3), along: (3, N)."""
    return np.maximum(fluence - (flux * along.T).sum(axis=1), MIN_SHARE * fluence)


def _means(values: np.ndarray) -> np.ndarray:
    """Means float64 over cells twice as large, of values (x, y, z)."""
    return halved_means(values).astype(np.float64)


def _halved(cells: np.ndarray) -> np.ndarray:
    """Means (..., K) of 2 x 2 x 2 cells (x, y, z, K); outside there is nothing."""
    cells = np.pad(cells, [*((0, n % 2) for n in cells.shape[:3]), (0, 0)])
    for axis in range(3):
        cells = np.moveaxis(cells, axis, 0)
        cells = np.moveaxis(0.5 * (cells[::2] + cells[1::2]), 0, axis)
    return np.ascontiguousarray(cells)


def _close(a: np.ndarray, b: np.ndarray) -> bool:
    return np.allclose(a, b, rtol=1e-4, atol=1e-6 * b.max())
