# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that arrives at points from directions around the camera ray (final gathering).

Light that forward scattering turns into the camera ray comes from directions close to it. Along 8 of these, on four
cones around the camera ray that stand for quarters of the probability of Henyey-Greenstein's phase function, a few
steps gather what reaches the point:

    single    = integral of exp(-tau - tau_sun) dtau,
    reduced   = integral of exp(-a (tau + tau_sun)) a dtau,
    scattered = integral of exp(-tau) (phi - 3 G' F . w) dtau,

and the transmittance exp(-tau) of all steps. tau counts from the point, phi and F are the coarse transport's fluence
and flux, a is SCALE and G' the reduced mean cosine.
"""

import functools
from dataclasses import dataclass

import numpy as np

from ..grids.optical_depth_sweep import sun_optical_depth
from ..kernels.field_structures import LightGather
from ..kernels.library import Kernels
from ..scene.phase_function import reduced_anisotropy

#: Level of the density pyramid that rays read.
LEVEL = 1
# Cones around the camera ray. On the first and the third lie the two directions across the sun's, on the second and the
# fourth those towards it and away from it.
RINGS, AZIMUTHS = 4, 2
RAYS = RINGS * AZIMUTHS
#: Directions that networks tell apart: two across, on one cone, are averaged; and values per direction.
DIRECTIONS, VALUES = 6, 4
#: Which of the values the light gives: unscattered, and that of the coarse transport.
SINGLE, REDUCED, SCATTERED = range(3)
STEPS = 8
# Optical thickness of a step where tau is 0, and how much longer than the one before a step may be.
THICKNESS, GROWTH = 0.4, 1.6
#: a, for light that is scattered forwards, and the lower bound of phi - 3 G' F . w over phi; the kernel holds both.
SCALE, MIN_SHARE = 1.0 / 3.0, 0.02
# Optical depth that stands for the shadow of surfaces.
SHADOW_DEPTH = 16.0


@functools.lru_cache(maxsize=64)
def gather_directions(anisotropy: float) -> np.ndarray:
    """Unit vectors float32 (3, RAYS), ring after ring, in the frame of the camera ray (`stencil.frames`)."""
    share, g = (np.arange(RINGS) + 0.5) / RINGS, anisotropy
    if abs(g) < 1e-3:
        cosine = 1.0 - 2.0 * share
    else:
        s = (1.0 - g * g) / (1.0 - g + 2.0 * g * (1.0 - share))
        cosine = (1.0 + g * g - s * s) / (2.0 * g)
    cosine = np.clip(cosine, -1.0, 1.0)[:, None]
    azimuth = np.pi * (np.arange(AZIMUTHS) + 0.5 * (np.arange(RINGS) % 2 == 0)[:, None])
    sine = np.sqrt(1.0 - cosine**2)
    vectors = [sine * np.cos(azimuth), sine * np.sin(azimuth), np.broadcast_to(cosine, (RINGS, AZIMUTHS))]
    return np.ascontiguousarray(np.stack(vectors).reshape(3, RAYS), np.float32)


def unit_sun_depth(density: np.ndarray, sun: np.ndarray, kernels: Kernels | None = None) -> np.ndarray:
    """Optical depth float32 (n, n, n) of level LEVEL towards a sun for sigma_hat = 1; sun: (3,) in the cube's frame."""
    return sun_optical_depth(density, sun, 1.0 / len(density), kernels)


def shadowed_depth(depth: np.ndarray, visibility: np.ndarray, sigma_hat: float) -> np.ndarray:
    """A depth for sigma_hat = 1 with what surfaces take of the light: visibility from 0 to 1, both (n, n, n)."""
    return depth - np.log(np.maximum(visibility, np.exp(-SHADOW_DEPTH))) / np.float32(max(sigma_hat, 1e-30))


@functools.cache
def _shifts() -> np.ndarray:
    """float32 (3, RAYS) in [-1/2, 1/2): where rays look up the nearest cell, so that not all leave it at once."""
    return np.mod(np.outer([0.819, 0.671, 0.549], np.arange(RAYS) + 0.5), 1.0).astype(np.float32) - np.float32(0.5)


@dataclass(frozen=True)
class FinalGather:
    """Gathers the light of one sun of irradiance 1 in one medium.

    media: float32 (n + 3, n + 3, n + 3, 2), a level of the density pyramid and the optical depth towards the sun, for
    sigma_hat = 1, with one cell more below and two above along each axis: zeros, and the outermost depths. light:
    float32 (m, m, m, 4), fluence and flux of the coarse transport. kernels: compiled ones, or None.
    """

    media: np.ndarray
    light: np.ndarray
    sigma_hat: float
    anisotropy: float
    kernels: Kernels | None = None

    @classmethod
    def of(
        cls,
        density: np.ndarray,
        depth: np.ndarray,
        light: np.ndarray,
        medium: tuple[float, float],
        kernels: Kernels | None = None,
    ) -> "FinalGather":
        """From level LEVEL (n, n, n) of the density pyramid and the coarse transport's light (m, m, m, 4).

        depth: (n, n, n), optical depth towards the light for sigma_hat = 1. medium: sigma_hat and mean cosine.
        """
        n, edge = len(density), [0, *range(len(density)), -1, -1]
        media = np.zeros((n + 3, n + 3, n + 3, 2), np.float32)
        media[1:-2, 1:-2, 1:-2, 0] = density
        media[..., 1] = depth[np.ix_(edge, edge, edge)]
        return cls(media, np.ascontiguousarray(light, np.float32), *medium, kernels)

    def __call__(self, positions: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """float32 (N, DIRECTIONS, VALUES) at positions (N, 3) in the cube's frame.

        turned: (N, 3, 3), of the camera rays and the light, from `stencil.frames`. Values as in the module's docstring,
        in its order.
        """
        at = np.ascontiguousarray(positions, np.float32)
        turned = np.ascontiguousarray(turned, np.float32)
        found = np.empty((len(at), RAYS, VALUES), np.float32)
        if self.kernels is None:
            self._gather(at, turned, found)
        else:
            self._gather_compiled(self.kernels, at, turned, found)
        pairs = found.reshape(len(at), RINGS // 2, 2, AZIMUTHS, VALUES)
        gathered = np.empty((len(at), RINGS // 2, 1 + AZIMUTHS, VALUES), np.float32)
        gathered[:, :, 0] = np.float32(0.5) * (pairs[:, :, 0, 0] + pairs[:, :, 0, 1])
        gathered[:, :, 1:] = pairs[:, :, 1]
        return gathered.reshape(len(at), DIRECTIONS, VALUES)

    def _gather_compiled(self, kernels: Kernels, positions: np.ndarray, turned: np.ndarray, found: np.ndarray) -> None:
        data = LightGather(
            points=len(positions),
            positions=positions,
            frames=turned,
            rays=RAYS,
            directions=gather_directions(self.anisotropy),
            steps=STEPS,
            thickness=THICKNESS,
            growth=GROWTH,
            shifts=_shifts(),
            media=self.media,
            edge=len(self.media),
            light=self.light,
            light_edge=len(self.light),
            sigma=self.sigma_hat,
            flux=3.0 * reduced_anisotropy(self.anisotropy),
        )
        data.out = found.ctypes.data
        kernels.prepare("gather_light", data)

    def _gather(self, positions: np.ndarray, turned: np.ndarray, found: np.ndarray) -> None:
        """Twin of the kernel, in its order of operations: rounding decides which cell is the nearest."""
        local = gather_directions(self.anisotropy)
        towards = np.stack([sum(row[:, i, None] * local[i] for i in range(3)) for row in np.moveaxis(turned, 1, 0)], -1)
        cells, coarse = np.float32(len(self.media) - 3), len(self.light)
        flux = np.float32(3.0 * reduced_anisotropy(self.anisotropy))
        sigma, scale = np.float32(self.sigma_hat), np.float32(SCALE)
        start, least = positions[:, None] + np.float32(0.5), np.float32(1e-6)
        thickness, growth = np.float32(THICKNESS), np.float32(GROWTH)
        shrinkage = np.float32(1.0) / growth
        distance, tau, single, reduced, scattered = np.zeros((5, *towards.shape[:2]), np.float32)
        extinction = sigma * _sample(self.media, start * cells)[..., 0]
        step = np.broadcast_to(np.minimum(1 / cells, thickness / np.maximum(extinction, least)), tau.shape)
        for _ in range(STEPS):
            place = start + (distance + np.float32(0.5) * step)[..., None] * towards
            density, sun = np.moveaxis(sigma * _sample(self.media, place * cells), -1, 0)
            gained, sun = density * step, np.maximum(sun, 0.0)
            cell = np.clip(place * np.float32(coarse) + _shifts().T, 0.0, coarse - 1).astype(int)
            fluence, *flow = np.moveaxis(self.light[tuple(np.moveaxis(cell, -1, 0))], -1, 0)
            source = fluence - flux * sum(part * along for part, along in zip(flow, np.moveaxis(towards, -1, 0)))
            passed = np.exp(-tau) * -np.expm1(-gained)
            single += passed * np.exp(-sun)
            scattered += passed * np.maximum(source, np.float32(MIN_SHARE) * fluence)
            reduced += np.exp(-scale * (tau + sun)) * -np.expm1(-scale * gained)
            tau += gained
            distance = distance + step
            thin = thickness * (1 + tau) / np.maximum(density, least)
            step = np.minimum(step * growth, np.maximum(thin, step * shrinkage))
        found[...] = np.stack([single, reduced, scattered, np.exp(-tau)], axis=-1)


def _sample(padded: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Trilinear values (..., 2) at places (..., 3) in cells, of which the first, behind the padding, begins at 0."""
    at = np.clip(cells + np.float32(0.5), 0.0, len(padded) - 2)
    cell = at.astype(int)
    i, j, k = np.moveaxis(cell, -1, 0)
    x, y, z = np.moveaxis(at - cell, -1, 0)[..., None]
    rows = [
        padded[i + a, j, k + c] + y * (padded[i + a, j + 1, k + c] - padded[i + a, j, k + c])
        for c in (0, 1)
        for a in (0, 1)
    ]
    low, high = rows[0] + x * (rows[1] - rows[0]), rows[2] + x * (rows[3] - rows[2])
    return low + z * (high - low)
