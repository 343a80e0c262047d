# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedos that vary in space, seen through the orders of scattering.

Networks know uniform albedos. Where the albedo varies, light that has scattered many times has met many of them, and
what a point receives is that of a uniform albedo in between. The coarse transport tells which: it is solved for the
albedo as it varies and for a few uniform ones. `network.albedos` takes the two of these between which the light lies
that a point scatters towards the camera. Where the albedo is uniform after all this is exact, whatever the transport is
worth.
"""

from collections.abc import Callable

import numpy as np

from ..grids.halving import halve
from ..grids.working_cube import Cube, mean_density
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Volume
from .discrete_ordinates import CellSource, DiscreteOrdinates

# Uniform albedos are at most so far apart in the square root of 1 - albedo, in which light fades about evenly.
SPACING = 0.24
# Ranges of albedo narrower than this are one albedo.
SAME = 1e-5
# Lowest uniform albedo: below, almost nothing is scattered twice.
LOWEST = 0.02
# Cells of less than this part of the largest density do not widen the range of albedos.
NEGLIGIBLE = 1e-3


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
        """coarse: the density on these cells."""
        assert volume.scattering is not None
        self.density = coarse
        self.channels = []
        for grid in volume.scattering:
            part = Volume(grid, volume.world_from_index, volume.name)
            scattering = _cells(mean_density(part, cube, cancel), len(coarse))
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

    def light(
        self, solver_of: Callable[..., DiscreteOrdinates], source: CellSource, cancel: CancelToken = NEVER
    ) -> np.ndarray:
        """What `network.albedos` reads: float32 (n + 2, n + 2, n + 2, 1 + C + 4 (K + C + 1)) of C = 1 or 3 channels.

        Density, that times the albedo of each channel, and fluence and flux, each for all uniform albedos and channels,
        and of light that has not scattered. The density ends at the faces; the light of the outermost cells goes on.
        solver_of: a solver for an albedo. source: of light. Raises Cancelled.
        """
        n = len(self.density)
        albedos = [*map(float, self.uniform), *self.channels]
        varying = [number for number, enclosing in enumerate(self.enclosing) if len(enclosing) > 1]
        used = {int(uniform) for number in varying for uniform in self.enclosing[number]}
        matter = np.stack([self.density, *(albedo * self.density for albedo in self.channels)], axis=3)
        light = np.zeros((n, n, n, 4, len(albedos) + 1), np.float32)
        for number in [*sorted(used), *(len(self.uniform) + number for number in varying)]:
            solver = solver_of(albedos[number])
            light[..., number] = np.moveaxis(source.arriving(solver, cancel), 0, -1)
        if used:
            light[..., -1] = np.moveaxis(source.unscattered(solver, cancel), 0, -1)
        border = [(1, 1)] * 3 + [(0, 0)]
        light = np.pad(light.reshape(n, n, n, -1), border, mode="edge")
        return np.concatenate([np.pad(matter, border), light], axis=3).astype(np.float32)


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


def _cells(values: np.ndarray, count: int) -> np.ndarray:
    """Means over so many cells along an edge."""
    while len(values) > count:
        means = np.empty([n // 2 for n in values.shape], np.float32)
        halve(np.ascontiguousarray(values, np.float32), means)
        values = means
    return values


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
