# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that arrives at points from directions around the camera ray (final gathering).

Light that forward scattering turns into the camera ray comes from directions close to it. Along 8 directions, on four
cones around the camera ray that stand for quarters of the probability of Henyey-Greenstein's phase function, a few
steps gather the light that reaches the point:

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
from ..kernels.library import call
from ..scene.phase_function import reduced_anisotropy

#: Level of the density pyramid that rays read.
LEVEL = 1
# Cones around the camera ray, with two directions each: across the sun's on the first and the third cone, towards the
# sun and away from it on the second and the fourth.
RINGS, AZIMUTHS = 4, 2
RAYS = RINGS * AZIMUTHS
#: Directions that networks read, in which the two across the sun's on a cone are averaged; and values per direction.
DIRECTIONS, VALUES = 6, 4
#: Indices of the values of light: unscattered, with reduced extinction, and from the coarse transport.
SINGLE, REDUCED, SCATTERED = range(3)
STEPS = 8
# Optical thickness of a step where tau is 0, and by what factor a step may be longer than the step before.
THICKNESS, GROWTH = 0.4, 1.6
#: a, for light that is scattered forwards, and the lower bound of phi - 3 G' F . w over phi; the kernel holds both.
SCALE, MIN_SHARE = 1.0 / 3.0, 0.02
# Optical depth that stands for the shadow of surfaces.
SHADOW_DEPTH = 16.0


@functools.lru_cache(maxsize=64)
def gather_directions(anisotropy: float) -> np.ndarray:
    """Unit vectors float32 (3, RAYS), ring after ring, in the frame of the camera ray (`stencil.frames`)."""
    fraction, g = (np.arange(RINGS) + 0.5) / RINGS, anisotropy
    if abs(g) < 1e-3:
        cosine = 1.0 - 2.0 * fraction
    else:
        s = (1.0 - g * g) / (1.0 - g + 2.0 * g * (1.0 - fraction))
        cosine = (1.0 + g * g - s * s) / (2.0 * g)
    cosine = np.clip(cosine, -1.0, 1.0)[:, None]
    azimuth = np.pi * (np.arange(AZIMUTHS) + 0.5 * (np.arange(RINGS) % 2 == 0)[:, None])
    sine = np.sqrt(1.0 - cosine**2)
    vectors = [sine * np.cos(azimuth), sine * np.sin(azimuth), np.broadcast_to(cosine, (RINGS, AZIMUTHS))]
    return np.ascontiguousarray(np.stack(vectors).reshape(3, RAYS), np.float32)


def unit_sun_depth(density: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Optical depth float32 (n, n, n) of level LEVEL towards a sun for sigma_hat = 1; sun: (3,) in the cube's frame."""
    return sun_optical_depth(density, sun, 1.0 / len(density))


def shadowed_depth(depth: np.ndarray, visibility: np.ndarray, sigma_hat: float) -> np.ndarray:
    """A depth for sigma_hat = 1 that includes the shadow of surfaces: visibility from 0 to 1, both (n, n, n)."""
    return depth - np.log(np.maximum(visibility, np.exp(-SHADOW_DEPTH))) / np.float32(max(sigma_hat, 1e-30))


@functools.cache
def _shifts() -> np.ndarray:
    """float32 (3, RAYS) in [-1/2, 1/2): where rays look up the nearest cell, so that not all leave it at once."""
    return np.mod(np.outer([0.819, 0.671, 0.549], np.arange(RAYS) + 0.5), 1.0).astype(np.float32) - np.float32(0.5)


@dataclass(frozen=True)
class FinalGather:
    """Gathers the light of one sun of irradiance 1 in one medium.

    media: float32 (n + 3, n + 3, n + 3, 2), a level of the density pyramid and the optical depth towards the sun for
    sigma_hat = 1, padded along each axis by a cell below and two above: with zeros, and with the outermost depths.
    light: float32 (m, m, m, 4), fluence and flux of the coarse transport.
    """

    media: np.ndarray
    light: np.ndarray
    sigma_hat: float
    anisotropy: float

    @classmethod
    def of(
        cls,
        density: np.ndarray,
        depth: np.ndarray,
        light: np.ndarray,
        medium: tuple[float, float],
    ) -> "FinalGather":
        """From level LEVEL (n, n, n) of the density pyramid and the coarse transport's light (m, m, m, 4).

        depth: (n, n, n), optical depth towards the light for sigma_hat = 1. medium: sigma_hat and mean cosine.
        """
        n, edge = len(density), [0, *range(len(density)), -1, -1]
        media = np.zeros((n + 3, n + 3, n + 3, 2), np.float32)
        media[1:-2, 1:-2, 1:-2, 0] = density
        media[..., 1] = depth[np.ix_(edge, edge, edge)]
        return cls(media, np.ascontiguousarray(light, np.float32), *medium)

    def __call__(self, positions: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """float32 (N, DIRECTIONS, VALUES) at positions (N, 3) in the cube's frame.

        turned: (N, 3, 3), of the camera rays and the light, from `stencil.frames`. Values as in the module's docstring,
        in its order.
        """
        at = np.ascontiguousarray(positions, np.float32)
        turned = np.ascontiguousarray(turned, np.float32)
        values = np.empty((len(at), RAYS, VALUES), np.float32)
        call(
            "gather_light",
            points=len(at),
            positions=at,
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
            out=values,
        )
        pairs = values.reshape(len(at), RINGS // 2, 2, AZIMUTHS, VALUES)
        gathered = np.empty((len(at), RINGS // 2, 1 + AZIMUTHS, VALUES), np.float32)
        gathered[:, :, 0] = np.float32(0.5) * (pairs[:, :, 0, 0] + pairs[:, :, 0, 1])
        gathered[:, :, 1:] = pairs[:, :, 1]
        return gathered.reshape(len(at), DIRECTIONS, VALUES)
