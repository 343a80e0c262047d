# SPDX-License-Identifier: GPL-3.0-or-later
"""Fluence and flux of scattered light on coarse cells, for networks at points and for camera rays on their way."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..grids.working_cube import Cube
from ..numerics.interpolation import lerp_into
from ..occluders.cell_boundaries import CellBoundaries
from ..scene.phase_function import reduced_anisotropy
from .discrete_ordinates import CELLS

#: Added to the fluence before taking its logarithm.
MIN_FLUENCE = 1e-6
# Distance of the probes from a point, in edges of the cube.
REACH = 1.0 / 32.0
#: Points at which the fluence is read, and columns of `FluenceLattice.read`.
PROBES = 4
COLUMNS = PROBES + 3
# Lower bound of the light scattered towards the camera over that of isotropic scattering.
MIN_SHARE = 0.02
# Lower bound of the reduced fraction of scattering.
MIN_REDUCED_FRACTION = 0.05


def fluence_lattice(light: np.ndarray, boundaries: CellBoundaries | None = None) -> np.ndarray:
    """The logarithm of the fluence, and the flux over the fluence: float16 (n + 2, n + 2, n + 2, 4).

    light: float32 (4, n, n, n) of `DiscreteOrdinates`. boundaries: its CellBoundaries, or None. The outermost cells
    are repeated once beyond each face.
    """
    fluence, flux = light[0], light[1:]
    logs = np.log(fluence + np.float32(MIN_FLUENCE))
    if boundaries is not None:
        logs = boundaries.extrapolate_inside(logs)
    values = np.concatenate([logs[None], flux / (fluence + np.float32(MIN_FLUENCE))])
    return np.pad(np.moveaxis(values, 0, -1), [(1, 1)] * 3 + [(0, 0)], mode="edge").astype(np.float16)


def moment_lattice(moments: np.ndarray, boundaries: CellBoundaries | None = None) -> np.ndarray:
    """Moments as they are, float32 (n + 2, n + 2, n + 2, K), so that interpolation keeps their sum.

    moments: float32 (K, n, n, n) of `DiscreteOrdinates.lamp`. boundaries: as in `fluence_lattice`.
    """
    if boundaries is not None:
        moments = np.stack([boundaries.extrapolate_inside(values) for values in moments])
    lattice = np.empty((*(n + 2 for n in moments.shape[1:]), len(moments)), np.float32)
    lattice[1:-1, 1:-1, 1:-1] = np.moveaxis(moments, 0, -1)
    for axis in range(3):
        along = np.moveaxis(lattice, axis, 0)
        along[0], along[-1] = along[1], along[-2]
    return lattice


def fluence_and_flux(cells: np.ndarray) -> np.ndarray:
    """Fluence and flux float16 (n, n, n, 4) of a `fluence_lattice`."""
    light = cells[1:-1, 1:-1, 1:-1].astype(np.float32)
    light[..., 0] = np.exp(light[..., 0])
    light[..., 1:] *= light[..., :1]
    return light.astype(np.float16)


class FluenceLattice:
    """Scattered light around points, as networks read it.

    cells: of `fluence_lattice`, or of `moment_lattice` for `values`.
    """

    def __init__(self, cells: np.ndarray) -> None:
        self._edge = len(cells)
        self._cells = cells.astype(np.float32, copy=False).reshape(-1, cells.shape[-1])

    @property
    def cells(self) -> np.ndarray:
        """Of which values are interpolated, float32 (n, n, n, K)."""
        return self._cells.reshape(self._edge, self._edge, self._edge, -1)

    @cached_property
    def _logs(self) -> np.ndarray:
        """The first of the values, float32: three of four probes read nothing else."""
        return np.ascontiguousarray(self._cells[:, 0])

    def values(self, positions: np.ndarray) -> np.ndarray:
        """All values of the cells, interpolated, float32 (N, K) at positions (N, 3) in the cube's frame."""
        return _interpolate(self._cells, self.index(positions), self._edge)

    def index(self, positions: np.ndarray) -> np.ndarray:
        """Places float32 (3, N), in cells, of positions (N, 3) in the cube's frame."""
        return ((positions.T + 0.5) * (self._edge - 2) + 0.5).astype(np.float32)

    def read(self, positions: np.ndarray, omega: np.ndarray, sun: np.ndarray, anisotropy: float) -> np.ndarray:
        """Features float32 (N, 7).

        positions, omega: (N, 3) in the cube's frame. sun: (3,), or (N, 3) of each point. anisotropy: G. Columns: the
        logarithm of the fluence at the point, ahead of and behind it on its ray, and towards the sun; the logarithm of
        4 pi times the light scattered towards the camera, phi - 3 G' F . omega; and the flux over the fluence, along
        the ray and towards the sun.
        """
        out = np.empty((len(positions), COLUMNS), np.float32)
        along = np.ascontiguousarray(omega.T, np.float32)
        index = self.index(positions)
        here = _interpolate(self._cells, index, self._edge)
        out[:, 0] = here[:, 0]
        step = np.float32(REACH * (self._edge - 2))
        towards = np.broadcast_to(np.reshape(sun, (-1, 3)).T.astype(np.float32), along.shape)
        probes = np.concatenate([index + step * along, index - step * along, index + step * towards], axis=1)
        out[:, 1:PROBES] = _interpolate(self._logs, probes, self._edge).reshape(PROBES - 1, -1).T
        flux = here[:, 1:].T
        ahead = flux[0] * along[0] + flux[1] * along[1] + flux[2] * along[2]
        anisotropic = np.maximum(np.float32(1.0) - np.float32(3.0 * reduced_anisotropy(anisotropy)) * ahead, MIN_SHARE)
        out[:, PROBES] = here[:, 0] + np.log(anisotropic)
        out[:, PROBES + 1] = ahead
        out[:, PROBES + 2] = flux[0] * towards[0] + flux[1] * towards[1] + flux[2] * towards[2]
        return out


def _interpolate(flat: np.ndarray, index: np.ndarray, n: int) -> np.ndarray:
    """Trilinear interpolation at indices (3, N): (N,) from values (n^3,), or (N, k) from (n^3, k)."""
    index = np.clip(index, np.float32(0.0), np.float32(n - 1 - 1e-3))
    cell = index.astype(np.int32)
    fx, fy, fz = (index - cell).reshape(3, -1, *[1] * (flat.ndim - 1))
    base = (cell[0] * np.intp(n) + cell[1]) * n + cell[2]

    def edge(offset: int) -> np.ndarray:
        return lerp_into(flat[offset:].take(base, axis=0), flat[offset + 1 :].take(base, axis=0), fz)

    return lerp_into(lerp_into(edge(0), edge(n), fy), lerp_into(edge(n * n), edge(n * n + n), fy), fx)


@dataclass
class ScatteredFluence:
    """Scattered light of each sun in one volume, for lookups along camera rays.

    linear: (3, 3) and offset: (3,), indices from world positions. lights: `fluence_and_flux` of each sun, float32
    (n, n, n, 4). anisotropy: G. scales: factor of each of them, or None for suns.
    """

    linear: np.ndarray
    offset: np.ndarray
    lights: list[np.ndarray]
    anisotropy: float
    scales: list[float] | None = None

    @classmethod
    def in_cube(
        cls, cube: Cube, lights: list[np.ndarray], anisotropy: float, scales: list[float] | None = None
    ) -> "ScatteredFluence":
        """From the solution in the working cube of a volume."""
        return cls(*_placement(cube, _edge(lights)), lights, anisotropy, scales)

    def placed(self, cube: Cube) -> "ScatteredFluence":
        """The same in another instance of the volume."""
        linear, offset = _placement(cube, _edge(self.lights))
        return replace(self, linear=linear, offset=offset)

    def of_parts(self, numbers: Sequence[int]) -> "ScatteredFluence":
        """For each of some suns or lamps the light of the one with a number."""
        scales = self.scales and [self.scales[number] for number in numbers]
        return replace(self, lights=[self.lights[number] for number in numbers], scales=scales)

    @property
    def reduced_fraction(self) -> float:
        """Fraction of the scattering outside the phase function's forward peak, 1 - G^2."""
        return max(1.0 - self.anisotropy**2, MIN_REDUCED_FRACTION)

    def flux_from_world(self) -> np.ndarray:
        """float64 (3, 3): weights of the flux in the light scattered against a ray, from its direction."""
        return self.linear * (-3.0 * reduced_anisotropy(self.anisotropy) / np.linalg.norm(self.linear[0]))


def _edge(lights: Sequence[np.ndarray]) -> int:
    """Cells along an edge of the lights."""
    return len(lights[0]) if lights else CELLS


def _placement(cube: Cube, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """linear (3, 3) and offset (3,) of the cells of a cube, so many along its edge."""
    linear = cube.rotation.T * (cells / cube.edge)
    return linear, 0.5 * cells - linear @ cube.centre
