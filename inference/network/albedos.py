# SPDX-License-Identifier: GPL-3.0-or-later
"""For which uniform albedos networks are asked, and what their answers are for the albedo of each point."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..environments.environment_light import read_lattice
from ..grids.working_cube import Cube
from ..transport.varying_albedo import between


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

    values, enclosing: uniform ones, and which of them enclose those of each channel. places: as of
    `CoarseAlbedo.places`, in the frame of the cube. indices: the colour channels. ahead: distance along camera rays, in
    edges of the cube, at which they are read: a forward phase function scatters into a ray what arrives from ahead.
    """

    values: list[float]
    enclosing: list[np.ndarray]
    places: np.ndarray
    cube: Cube
    indices: Sequence[int]
    ahead: float

    @property
    def channels(self) -> list[list[int]]:
        """As `Albedos`."""
        return [[c] for c in self.indices] if self.places.shape[-1] == 3 else [list(self.indices)]

    def by_channel(
        self, rows: np.ndarray, positions: np.ndarray, directions: np.ndarray
    ) -> Iterator[tuple[int, np.ndarray]]:
        """As `Albedos`."""
        points = self.cube.positions(positions) + self.ahead * self.cube.directions(directions)
        places = read_lattice(self.places, points)
        known: dict[int, np.ndarray] = {}
        for c in self.indices:
            column = c if places.shape[1] == 3 else 0
            if column not in known:
                known[column] = between(rows[self.enclosing[column]], places[:, column])
            yield c, known[column]
