# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedos that vary in space, seen through the orders of scattering.

Networks know uniform albedos. Where the albedo varies, light that has scattered many times has met many of them, and
what a point receives is that of a uniform albedo in between. The coarse transport tells which: it is solved for the
albedo as it varies and for a few uniform ones, and at each point the two of these are taken between which its fluence
lies. With L_k the prediction for uniform albedo k and phi_k its fluence,

    log L = log L_k + f (log L_(k+1) - log L_k),    f = (log phi - log phi_k) / (log phi_(k+1) - log phi_k).

The point is one ahead on the camera ray (`network.albedos`). Where the albedo is uniform after all this is exact,
whatever the transport is worth.
"""

from collections.abc import Callable

import numpy as np

from ..grids.halving import halve
from ..grids.working_cube import Cube, level0_density
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Volume
from .discrete_ordinates import CellSource, DiscreteOrdinates

#: Cells along an edge of the working cube on which the transport is solved for albedos that vary.
CELLS = 32
# Uniform albedos are at most so far apart in the square root of 1 - albedo, in which light fades about evenly.
SPACING = 0.12
# Ranges of albedo narrower than this are one albedo.
SAME = 1e-5
# Lowest uniform albedo: below, almost nothing is scattered twice.
LOWEST = 0.02
# Cells of less than this part of the largest density do not widen the range of albedos.
NEGLIGIBLE = 1e-3
# Fluences below this are equal.
MIN_FLUENCE = 1e-12


class CoarseAlbedo:
    """The albedo of one volume on coarse cells. Raises Cancelled.

    density: float32 (n, n, n), of these cells. channels: the albedo (n, n, n), once for all colour channels or for each
    of three. uniform: float64 (K,), ascending uniform albedos. enclosing: of each channel, int (L,), those of them that
    enclose its albedo; one where it does not vary.
    """

    def __init__(
        self,
        volume: Volume,
        cube: Cube,
        coarse: np.ndarray,
        cancel: CancelToken = NEVER,
    ) -> None:
        """coarse: the density on these cells or on smaller ones."""
        assert volume.scattering is not None
        self.density = _cells(coarse)
        self.channels = []
        for grid in volume.scattering:
            part = Volume(grid, volume.world_from_index, volume.name)
            scattering = _cells(level0_density(part, cube, cancel))
            albedo = np.divide(scattering, self.density, out=np.zeros_like(scattering), where=self.density > 0.0)
            self.channels.append(np.clip(albedo, 0.0, 1.0))
        filled = self.density > NEGLIGIBLE * self.density.max()
        ends = [(float(albedo[filled].min()), float(albedo[filled].max())) for albedo in self.channels]
        self.uniform, self.enclosing = _enclosing(np.maximum(ends, LOWEST))

    def solver(
        self, sigma_hat: float, anisotropy: float, triangles: np.ndarray | None, albedo: float | np.ndarray
    ) -> DiscreteOrdinates:
        """Solver for an albedo, a number or (n, n, n); arguments as of DiscreteOrdinates."""
        return DiscreteOrdinates(self.density, sigma_hat, anisotropy, triangles, albedo)

    def places(
        self, solver_of: Callable[..., DiscreteOrdinates], source: CellSource, cancel: CancelToken = NEVER
    ) -> np.ndarray:
        """Where the albedo lies among those enclosing it, seen through all scattering, in [0, L - 1].

        float32 (n + 2, n + 2, n + 2, C) of C = 1 or 3 channels, the outermost cells repeated once beyond each face.
        solver_of: a solver for an albedo. source: of light. Raises Cancelled.
        """
        n, uniform = len(self.density), {}
        places = np.zeros((n, n, n, len(self.channels)), np.float32)
        for c, (albedo, enclosing) in enumerate(zip(self.channels, self.enclosing)):
            if len(enclosing) == 1:
                continue
            for number in enclosing:
                if number not in uniform:
                    uniform[number] = _logarithm(source.scattered(solver_of(float(self.uniform[number])), cancel))
            # More is never less, whatever the solver's accuracy.
            known = np.maximum.accumulate([uniform[number] for number in enclosing], axis=0)
            here = _logarithm(source.scattered(solver_of(albedo), cancel))
            for below, above in zip(known[:-1], known[1:]):
                places[..., c] += np.clip((here - below) / np.maximum(above - below, 1e-6), 0.0, 1.0)
            # Where no light comes the albedo is what it is there.
            dark = known[-1] <= np.log(MIN_FLUENCE)
            places[dark, c] = np.interp(albedo[dark], self.uniform[enclosing], np.arange(float(len(enclosing))))
        return np.pad(places, [(1, 1)] * 3 + [(0, 0)], mode="edge")


def _enclosing(ends: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Ascending uniform albedos (K,), and those of them, int (L,), that enclose each of some ranges (C, 2)."""
    varies = ends[:, 1] - ends[:, 0] > SAME
    common = np.zeros(0)
    if varies.any():
        # In the square root of 1 - albedo.
        high, low = np.sqrt(1.0 - np.array([ends[varies, 0].min(), ends[varies, 1].max()]))
        common = 1.0 - np.linspace(high, low, int(np.ceil((high - low) / SPACING - 1e-6)) + 1) ** 2
    uniform = np.unique(np.concatenate([common, ends[~varies, 1]]))
    own = np.searchsorted(uniform, common)
    return uniform, [own if some else np.searchsorted(uniform, end[1:]) for some, end in zip(varies, ends)]


def _cells(values: np.ndarray) -> np.ndarray:
    """Means over CELLS cells along an edge."""
    while len(values) > CELLS:
        means = np.empty([n // 2 for n in values.shape], np.float32)
        halve(np.ascontiguousarray(values, np.float32), means)
        values = means
    return values


def _logarithm(fluence: np.ndarray) -> np.ndarray:
    return np.log(np.maximum(fluence.astype(np.float64), MIN_FLUENCE))


def between(rows: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Radiance (N, ...) at places (N,) among predictions (L, N, ...) for uniform albedos."""
    if len(rows) == 1:
        return rows[0]
    below = np.clip(place.astype(np.int32), 0, len(rows) - 2)
    logs = np.log(np.maximum(rows, np.float32(1e-30)))
    number = np.arange(len(place))
    share = np.clip(place - below, 0.0, 1.0).astype(np.float32).reshape(-1, *[1] * (logs.ndim - 2))
    first, second = logs[below, number], logs[below + 1, number]
    return np.exp(first + share * (second - first))
