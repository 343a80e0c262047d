"""The light that has been scattered, on coarse cells: as networks read it at points, and camera rays on their way."""

from dataclasses import dataclass

import numpy as np

from ..numerics.interpolation import between
from .discrete_ordinates import CELLS, reduced_anisotropy

#: Added to the fluence before its logarithm.
LEAST = 1e-6
# Distance of the probes around a point, in the cube.
REACH = 1.0 / 32.0
#: Places at which the fluence is read, and columns of `read_fluence`.
PROBES = 4
COLUMNS = PROBES + 3
# Least share of the fluence's mean radiance that a point counts as scattering towards the camera.
LEAST_SHARE = 0.02
# Least share of scattering that counts as turning light.
LEAST_REDUCED = 0.05


def fluence_lattice(light, boundaries=None) -> np.ndarray:
    """What points read, float16 (66, 66, 66, 4): the logarithm of the fluence and the flux over it.

    light: float32 (4, 64, 64, 64) of `DiscreteOrdinates`; boundaries: its CellBoundaries, or None. One more cell of the same lies beyond each face.
    """
    fluence, flux = light[0], light[1:]
    logs = np.log(fluence + np.float32(LEAST))
    if boundaries is not None:
        logs = boundaries.spread_inside(logs)
    values = np.concatenate([logs[None], flux / (fluence + np.float32(LEAST))])
    return np.pad(np.moveaxis(values, 0, -1), [(1, 1)] * 3 + [(0, 0)], mode="edge").astype(np.float16)


def fluence_and_flux(cells) -> np.ndarray:
    """Fluence and flux float16 (64, 64, 64, 4) of `fluence_lattice`."""
    light = cells[1:-1, 1:-1, 1:-1].astype(np.float32)
    light[..., 0] = np.exp(light[..., 0])
    light[..., 1:] *= light[..., :1]
    return light.astype(np.float16)


def read_fluence(cells, positions, omega, sun, anisotropy: float) -> np.ndarray:
    """What a network sees of the scattered light around points, float32 (N, 7).

    cells: of `fluence_lattice`, float32; positions, omega: (N, 3) in the cube's frame; sun: (3,); anisotropy: G.
    The logarithm of the fluence at a point, ahead and behind on its ray, and towards the sun; that of what scatters
    towards the camera, times 4 pi, phi - 3 G' F . omega; and the flux along the ray and towards the sun, over the fluence.
    """
    offsets = REACH * np.stack([omega, -omega, np.broadcast_to(sun, omega.shape)])
    out = np.empty((len(positions), COLUMNS), np.float32)
    here = _interpolate(cells.reshape(-1, 4), _index(positions), len(cells))
    out[:, 0] = here[:, 0]
    logs = np.ascontiguousarray(cells[..., 0]).reshape(-1)
    for i, offset in enumerate(offsets, start=1):
        out[:, i] = _interpolate(logs, _index(positions + offset), len(cells))
    along = np.einsum("nk,nk->n", here[:, 1:], omega)
    share = np.maximum(1.0 - 3.0 * reduced_anisotropy(anisotropy) * along, LEAST_SHARE)
    out[:, PROBES] = here[:, 0] + np.log(share)
    out[:, PROBES + 1] = along
    out[:, PROBES + 2] = here[:, 1:] @ sun
    return out


def _index(positions):
    """Continuous indices into `fluence_lattice`, float32 (3, N)."""
    index = (positions + 0.5) * CELLS + 0.5
    return np.clip(index, 0.0, CELLS + 1 - 1e-3).astype(np.float32).T


def _interpolate(flat, index, n: int):
    """Trilinear at indices (3, N): (N,) of values (n^3,), or (N, k) of (n^3, k)."""
    cell = index.astype(np.int32)
    fx, fy, fz = (index - cell).reshape(3, -1, *[1] * (flat.ndim - 1))
    base = (cell[0] * np.intp(n) + cell[1]) * n + cell[2]

    def edge(offset):
        return between(flat[offset:].take(base, axis=0), flat[offset + 1 :].take(base, axis=0), fz)

    return between(between(edge(0), edge(n), fy), between(edge(n * n), edge(n * n + n), fy), fx)


@dataclass
class ScatteredFluence:
    """Each sun's light that has scattered in one volume, for camera rays to look up on their way.

    linear: (3, 3) and offset: (3,), indices from world positions. lights: float16 (64, 64, 64, 4) of `fluence_and_flux` for each sun.
    anisotropy: G.
    """

    linear: np.ndarray
    offset: np.ndarray
    lights: list[np.ndarray]
    anisotropy: float

    @classmethod
    def in_cube(cls, cube, lights, anisotropy: float):
        """In the working cube of a volume."""
        linear = cube.rotation.T * (CELLS / cube.edge)
        return cls(linear, 0.5 * CELLS - linear @ cube.centre, lights, anisotropy)

    @property
    def reduced_fraction(self) -> float:
        """The share of scattering that is not in the phase function's forward peak, 1 - G^2."""
        return max(1.0 - self.anisotropy**2, LEAST_REDUCED)

    def towards(self, directions) -> np.ndarray:
        """float32 (R, 4): factors of fluence and flux in what is scattered against rays along (R, 3), phi - 3 G' F . omega."""
        omega = directions @ (self.linear.T / np.linalg.norm(self.linear[0]))
        flux = (-3.0 * reduced_anisotropy(self.anisotropy)) * omega
        return np.concatenate([np.ones((len(omega), 1)), flux], axis=1).astype(np.float32)

    def cells(self, index) -> np.ndarray:
        """Flat offsets (N,) into the lights of indices float32 (3, N)."""
        x, y, z = np.clip(index, np.float32(0.0), np.float32(CELLS - 1)).astype(np.int32)
        return (x * np.intp(CELLS) + y) * np.intp(CELLS) + z
