# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light: what a volume scatters more than once, as emission on a grid of its own."""

from dataclasses import dataclass, field

import numpy as np

from ..numerics.interpolation import pad_with_zeros, sample_padded
from ..numerics.small_matmul import product
from ..runtime.report import Report
from ..scene.phase_function import henyey_greenstein

#: Polynomials of a direction's components in the quadratic and the cubic term: harmonic, so that they are orthogonal to
#: each other and to the terms before.
QUADRATIC, CUBIC = 5, 7
#: Coefficients per point of a DirectionalFactor: constant, linear, quadratic, cubic, of the lobe, its correction along
#: the baked view, and what was baked there.
COEFFICIENTS = 1 + 3 + QUADRATIC + CUBIC + 1 + 2
#: Largest absolute value of the factor's logarithm.
MAX_LOGARITHM = 8.0
#: How fast the correction fades with the angle to the view that was baked, and how fast detail does, over the square of
#: the anisotropy.
SHARPNESS, DETAIL_SHARPNESS = 12.0, 8.0


@dataclass(frozen=True)
class BakedView:
    """Where the rays come from along which light was baked.

    position: (3,) of the camera in the world, or None. direction: (3,), of the parallel rays of an orthographic
    camera, or None; neither, where the mean over all directions was baked.
    """

    position: np.ndarray | None = None
    direction: np.ndarray | None = None

    def directions(self, positions: np.ndarray) -> np.ndarray | None:
        """Unit directions (N, 3) of the rays to world positions (N, 3); None where there is no view."""
        if self.direction is not None:
            return np.broadcast_to(self.direction, positions.shape).copy()
        if self.position is None:
            return None
        away = positions - self.position
        length = np.linalg.norm(away, axis=1, keepdims=True)
        # A point at the camera itself is seen from no direction: any one will do.
        return np.where(length > 0.0, away / np.maximum(length, 1e-30), [0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Lobe:
    """Mean of Henyey-Greenstein phase functions about lights, the same everywhere.

    directions: (L, 3), unit vectors towards the lights. weights: (L,), sum to 1. anisotropy: of the lobes.
    """

    directions: np.ndarray
    weights: np.ndarray
    anisotropy: float

    def logarithm(self, directions: np.ndarray) -> np.ndarray:
        """Logarithm (N,) of 4 pi times the mean, for camera rays along unit directions (N, 3)."""
        cosine = product(directions, self.directions.T)
        return np.log(4.0 * np.pi * product(henyey_greenstein(cosine, self.anisotropy), self.weights))


@dataclass(frozen=True)
class DirectionalFactor:
    """Ratio of the light scattered in any direction to the light that was baked, the same for all colours.

    The mean over the colours of the light that density 1 scatters towards the viewer of a ray along w is modelled as

        L(w) = exp(f(w) + r exp(SHARPNESS (w . v - 1))) (L / exp(d))^exp(s (w . v - 1)),
        f(w) = a + b . w + q(w) + p(w) + c log lobe(w),

    with v the direction of the baked view's ray, L the light that was baked, d its logarithm in the coarse voxel, and
    q(w) and p(w) the sums of q_k times `quadratic_terms` and p_k times `cubic_terms`. The correction r = d - f(v) makes
    it L along the baked view. The detail L / exp(d) fades beside it, because with forward scattering one direction does
    not show what another shows. Without a view, detail is that at a right angle to one.

    coefficients: float32 (nx, ny, nz, COEFFICIENTS), of a, b (3), q (5), p (7), c, r and d; trilinear between
    voxel centres and constant beyond the outermost. world_from_index: (4, 4) of this grid. lobe, view: see there.
    sharpness: s.
    """

    coefficients: np.ndarray
    world_from_index: np.ndarray
    lobe: Lobe
    view: BakedView
    sharpness: float

    def __call__(self, positions: np.ndarray, directions: np.ndarray, baked: np.ndarray) -> np.ndarray:
        """Factors float32 (N,) at world positions (N, 3), for camera rays along unit directions (N, 3).

        baked: (N,), light that was baked there for a density of 1, mean over the colours.
        """
        index_from_world = np.linalg.inv(self.world_from_index)
        index = product(positions, index_from_world[:3, :3].T) + index_from_world[:3, 3]
        most = np.array(self.coefficients.shape[:3], np.float64) - 1.0
        index = np.clip(index, 0.0, most).T.astype(np.float32)
        found = np.stack(
            [
                sample_padded(pad_with_zeros(self.coefficients[..., k]), index)
                for k in range(self.coefficients.shape[3])
            ],
            axis=1,
        )
        terms = directional_terms(directions, self.lobe)
        fine = np.log(np.maximum(baked, 1e-30))
        logarithm = np.einsum("nk,nk->n", found[:, :-2], terms) - fine
        along = self.view.directions(positions)
        cosine = np.zeros(len(positions)) if along is None else np.einsum("nk,nk->n", along, directions)
        logarithm = logarithm + found[:, -2] * np.exp(SHARPNESS * (cosine - 1.0))
        logarithm = logarithm + (fine - found[:, -1]) * np.exp(self.sharpness * (cosine - 1.0))
        return np.exp(np.clip(logarithm, -MAX_LOGARITHM, MAX_LOGARITHM)).astype(np.float32)


def quadratic_terms(directions: np.ndarray) -> np.ndarray:
    """(N, QUADRATIC): x y, y z, x z, x^2 - y^2 and 3 z^2 - 1 of unit directions (N, 3)."""
    x, y, z = directions.T
    return np.stack([x * y, y * z, x * z, x * x - y * y, 3.0 * z * z - 1.0], axis=1)


def cubic_terms(directions: np.ndarray) -> np.ndarray:
    """(N, CUBIC): x^3 - 3 x y^2, 3 x^2 y - y^3, z (x^2 - y^2), x y z, x (5 z^2 - 1), y (5 z^2 - 1) and z (5 z^2 - 3) of
    unit directions (N, 3).
    """
    x, y, z = directions.T
    squares, axial = x * x - y * y, 5.0 * z * z - 1.0
    first, second = x * (x * x - 3.0 * y * y), y * (3.0 * x * x - y * y)
    return np.stack([first, second, z * squares, x * y * z, x * axial, y * axial, z * (axial - 2.0)], axis=1)


def directional_terms(directions: np.ndarray, lobe: Lobe) -> np.ndarray:
    """What the coefficients of a DirectionalFactor but the last two multiply: (N, COEFFICIENTS - 2)."""
    one, bright = np.ones((len(directions), 1)), lobe.logarithm(directions)[:, None]
    return np.concatenate([one, directions, quadratic_terms(directions), cubic_terms(directions), bright], axis=1)


@dataclass(frozen=True)
class LitVolume:
    """The light that one volume scatters more than once, and what it scatters of its own emission.

    density: float32 (nx, ny, nz), of the volume, 0 in the outermost voxels.
    scattered: float32 (nx, ny, nz, 3), what a density of 1 scatters towards the camera: extinction times albedo times
        the predicted radiance, W/(m^2 sr) per world unit of path length. It is continued beyond the density, so that
        both can be interpolated and then multiplied: light varies little across the edge of a volume, where density
        falls to 0, and interpolating their product would make the edge too bright.
    world_from_index: float64 (4, 4), as in Volume; the grid need not be the volume's.
    directional: what makes other directions right, or None.
    name: of the volume.
    report: of the bake, the same for all volumes baked together.
    """

    density: np.ndarray
    scattered: np.ndarray
    world_from_index: np.ndarray
    directional: DirectionalFactor | None = None
    name: str = "volume"
    report: Report = field(default_factory=Report)

    @property
    def emission(self) -> np.ndarray:
        """float32 (nx, ny, nz, 3), radiance per world unit of path length, W/(m^2 sr) per unit, at voxel centres.

        Scattered towards the camera: density times extinction times albedo times the predicted radiance. It is not
        attenuated.
        """
        return self.density[..., None] * self.scattered

    def towards(self, positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Emission float32 (N, 3) at world positions (N, 3), for camera rays along unit directions (N, 3)."""
        index_from_world = np.linalg.inv(self.world_from_index)
        index = (product(positions, index_from_world[:3, :3].T) + index_from_world[:3, 3]).T.astype(np.float32)
        channels = [sample_padded(pad_with_zeros(self.scattered[..., c]), index) for c in range(3)]
        scattered = np.stack(channels, axis=1)
        if self.directional is not None:
            scattered *= self.directional(positions, directions, scattered.mean(axis=1))[:, None]
        return scattered * sample_padded(pad_with_zeros(self.density), index)[:, None]
