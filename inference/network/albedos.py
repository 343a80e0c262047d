# SPDX-License-Identifier: GPL-3.0-or-later
"""For which uniform albedos networks are asked, and what their answers are for the albedo of each point."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..environments.environment_light import read_lattice
from ..grids.working_cube import Cube
from ..scene.phase_function import reduced_anisotropy
from ..transport.mean_free_path import light_ahead
from ..transport.scattered_fluence import MIN_SHARE
from ..transport.varying_albedo import between

# Ends of the parts of a ray on which the light ahead is read, in mean free paths.
PARTS = (0.2, 0.6, 1.2, 2.0, 3.2, 5.0, 8.0)
# Light below this is none.
MIN_LIGHT = 1e-12


class Albedos(Protocol):
    """Albedos of some colour channels of one medium, in one light."""

    @property
    def values(self) -> list[float]:
        """A uniform ones, for which networks are asked."""

    @property
    def channels(self) -> list[list[int]]:
        """Colour channels by number, those of the same albedo together; some whose albedo is 0 may be missing."""

    def by_channel(
        self, rows: np.ndarray, positions: np.ndarray, directions: np.ndarray
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Yield colour channels, by number, and their light (N, ...) at world positions (N, 3) on rays along directions
        (N, 3).

        rows: (A, N, ...), predicted for each of the values. The channels are those of `channels`.
        """


@dataclass(frozen=True)
class UniformAlbedos:
    """Albedos that are the same everywhere; distinct: of `plan.distinct_albedos`."""

    distinct: Sequence[tuple[float, list[int]]]

    @property
    def values(self) -> list[float]:
        """The distinct ones."""
        return [value for value, _ in self.distinct]

    @property
    def channels(self) -> list[list[int]]:
        """As `Albedos`."""
        return [channels for _, channels in self.distinct]

    def by_channel(
        self, rows: np.ndarray, positions: np.ndarray, directions: np.ndarray
    ) -> Iterator[tuple[int, np.ndarray]]:
        """As `Albedos`."""
        for (_, channels), row in zip(self.distinct, rows):
            for c in channels:
                yield c, row


@dataclass(frozen=True)
class VaryingAlbedos:
    """Albedos that vary in space.

    values, enclosing: uniform ones, and which of them enclose those of each channel. light: of `CoarseAlbedo.light`, in
    the frame of the cube. indices: the colour channels. sigma_hat, anisotropy: of the medium. free_path: mean, in
    edges of the cube.
    """

    values: list[float]
    enclosing: list[np.ndarray]
    light: np.ndarray
    cube: Cube
    indices: Sequence[int]
    sigma_hat: float
    anisotropy: float
    free_path: float

    @property
    def channels(self) -> list[list[int]]:
        """As `Albedos`."""
        return [[c] for c in self.indices] if len(self.enclosing) == 3 else [list(self.indices)]

    def by_channel(
        self, rows: np.ndarray, positions: np.ndarray, directions: np.ndarray
    ) -> Iterator[tuple[int, np.ndarray]]:
        """As `Albedos`."""
        light, albedo = self._scattered(self.cube.positions(positions), self.cube.directions(directions))
        uniform, varying = light[:, : len(self.values)], light[:, len(self.values) :]
        known: dict[int, np.ndarray] = {}
        for c in self.indices:
            column = c if len(self.enclosing) == 3 else 0
            if column not in known:
                enclosing = self.enclosing[column]
                place = _place(uniform[:, enclosing].T, varying[:, column])
                # Where no light comes the albedo is what it is there.
                dark = uniform[:, enclosing[-1]] <= MIN_LIGHT
                own = np.interp(albedo[dark, column], np.take(self.values, enclosing), np.arange(float(len(enclosing))))
                place[dark] = own
                known[column] = between(rows[enclosing], place)
            yield c, known[column]

    def _scattered(self, positions: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Light of the coarse transport that points scatter towards the camera, and their albedos (N, C).

        float32 (N, K + C), for each uniform albedo and channel. positions, omega: (N, 3) in the cube's frame. The
        forward peak scatters what arrives from ahead on the ray.
        """
        forward = self.anisotropy**2
        matter, found, unscattered = self._read(positions, omega)
        found -= unscattered
        albedo = matter[:, len(self.values) + 1 :] / np.maximum(matter[:, :1], 1e-30)
        if forward > 0.0:

            def read(number: int, distance: float) -> tuple[np.ndarray, np.ndarray]:
                matter, source, _ = self._read(positions + distance * omega, omega)
                extinction = np.float32(self.sigma_hat) * (matter[:, :1] - np.float32(forward) * matter[:, 1:])
                return extinction, np.float32(self.sigma_hat * (1.0 - forward)) * matter[:, 1:] * source

            ahead = light_ahead(read, [part * self.free_path for part in PARTS])
            found = (1.0 - forward) * found + forward * ahead
        return found, albedo

    def _read(self, positions: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Density and that times each albedo, (N, 1 + K + C), and the light that is scattered along -omega.

        That for each albedo, (N, K + C), and the part that had not scattered before, (N, 1).
        """
        values, flux = read_lattice(self.light, positions), (3.0 * reduced_anisotropy(self.anisotropy)) * omega.T
        count, channels = len(self.values), len(self.enclosing)
        matter, light = (
            values[:, : 1 + channels],
            values[:, 1 + channels :].reshape(len(values), 4, count + channels + 1),
        )
        uniform = matter[:, :1] * np.asarray(self.values, np.float32)
        source = light[:, 0].copy()
        for axis, along in enumerate(flux.astype(np.float32), 1):
            source -= along[:, None] * light[:, axis]
        np.maximum(source, MIN_SHARE * light[:, 0], out=source)
        return np.concatenate([matter[:, :1], uniform, matter[:, 1:]], axis=1), source[:, :-1], source[:, -1:]


def _place(known: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Where light (N,) lies among L that is known, (L, N), in [0, L - 1]."""
    # More is never less, whatever the solver's accuracy.
    logs = np.log(np.maximum(np.maximum.accumulate(known, axis=0), MIN_LIGHT))
    here, place = np.log(np.maximum(light, MIN_LIGHT)), np.zeros(len(light))
    for below, above in zip(logs[:-1], logs[1:]):
        place += np.clip((here - below) / np.maximum(above - below, 1e-6), 0.0, 1.0)
    return place
