# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that arrives at points from directions around the camera ray (final gathering).

Light that forward scattering turns into the camera ray comes from directions close to it. Along 16 of these, drawn from
Henyey-Greenstein's phase function at the midpoints of equal probabilities, a few steps gather what reaches the point:

    single    = integral of exp(-tau - tau_sun) dtau,
    reduced   = integral of exp(-a (tau + tau_sun)) a dtau,
    scattered = integral of exp(-tau) (phi - 3 G' F . w) dtau,

and the transmittance exp(-tau) of all steps. tau counts from the point, phi and F are the coarse transport's fluence and
flux.
"""

from dataclasses import dataclass

import numpy as np

from ..grids.optical_depth_sweep import sun_optical_depth
from ..kernels.field_structures import LightGather
from ..kernels.library import Kernels
from ..kernels.structures import Grid
from ..transport.discrete_ordinates import reduced_anisotropy
from .stencil import frames

# Cones around the camera ray, and directions on each: towards the sun, across, away from it, across.
RINGS, AZIMUTHS = 4, 4
RAYS = RINGS * AZIMUTHS
#: Directions that networks tell apart: the two across are averaged; and values per direction.
DIRECTIONS, VALUES = RINGS * 3, 4
STEPS = 8
# Optical thickness of a step where tau is 0, and how much longer than the one before a step may be.
THICKNESS, GROWTH = 0.4, 1.6
#: a, for light that is scattered forwards.
SCALE = 0.334
# Lower bound of phi - 3 G' F . w over phi.
MIN_SHARE = 0.02


def gather_directions(anisotropy: float) -> np.ndarray:
    """Unit vectors float32 (3, RAYS), ring after ring, in the frame of the camera ray (`stencil.frames`)."""
    share, g = (np.arange(RINGS) + 0.5) / RINGS, anisotropy
    if abs(g) < 1e-3:
        cosine = 1.0 - 2.0 * share
    else:
        s = (1.0 - g * g) / (1.0 - g + 2.0 * g * (1.0 - share))
        cosine = (1.0 + g * g - s * s) / (2.0 * g)
    cosine = np.clip(cosine, -1.0, 1.0)[:, None]
    azimuth = 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    sine = np.sqrt(1.0 - cosine**2)
    vectors = [sine * np.cos(azimuth), sine * np.sin(azimuth), np.broadcast_to(cosine, (RINGS, AZIMUTHS))]
    return np.ascontiguousarray(np.stack(vectors).reshape(3, RAYS), np.float32)


@dataclass(frozen=True)
class FinalGather:
    """Gathers the light of one sun of irradiance 1 in one medium.

    density, depth: float32 (n + 3, n + 3, n + 3), of a level of the density pyramid with one cell more below and two
    above along each axis: of density zeros, and of the optical depth towards the sun, for sigma_hat = 1, the outermost
    cells. light: fluence and flux float32 (4, m + 3, m + 3, m + 3), likewise. kernels: compiled ones, or None.
    """

    density: np.ndarray
    depth: np.ndarray
    light: np.ndarray
    sigma_hat: float
    anisotropy: float
    kernels: Kernels | None = None

    @classmethod
    def of(
        cls,
        density: np.ndarray,
        light: np.ndarray,
        sun: np.ndarray,
        medium: tuple[float, float],
        kernels: Kernels | None = None,
    ) -> "FinalGather":
        """From a level (n, n, n) of the density pyramid and the coarse transport's light (4, m, m, m).

        sun: (3,) unit vector in the cube's frame. medium: sigma_hat and mean cosine.
        """
        depth = sun_optical_depth(density, sun, 1.0 / len(density), kernels)
        return cls(
            np.pad(density, (1, 2)),
            np.pad(depth, (1, 2), mode="edge"),
            np.pad(light, ((0, 0), *[(1, 2)] * 3), mode="edge"),
            *medium,
            kernels,
        )

    def __call__(self, positions: np.ndarray, omega: np.ndarray, sun: np.ndarray) -> np.ndarray:
        """float32 (N, DIRECTIONS, VALUES) at positions, seen along omega, (N, 3) each in the cube's frame.

        sun: (3,) or (N, 3), unit vectors. Values as in the module's docstring, in its order.
        """
        at = np.ascontiguousarray(positions, np.float32)
        turned = np.ascontiguousarray(frames(omega, sun), np.float32)
        found = np.empty((len(at), RAYS, VALUES), np.float32)
        if self.kernels is None:
            self._gather(at, turned, found)
        else:
            self._gather_compiled(self.kernels, at, turned, found)
        rings = found.reshape(len(at), RINGS, AZIMUTHS, VALUES)
        across = 0.5 * (rings[:, :, 1] + rings[:, :, 3])
        return np.stack([rings[:, :, 0], across, rings[:, :, 2]], axis=2).reshape(len(at), DIRECTIONS, VALUES)

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
            density=_described(self.density),
            depth=_described(self.depth),
            sigma=self.sigma_hat,
            scale=SCALE,
            flux=3.0 * reduced_anisotropy(self.anisotropy),
        )
        for k, values in enumerate(self.light):
            data.light[k] = _described(values)
        data.out = found.ctypes.data
        kernels.prepare("gather_light", data)

    def _gather(self, positions: np.ndarray, turned: np.ndarray, found: np.ndarray) -> None:
        """Twin of the kernel."""
        towards = np.einsum("nij,jr->nri", turned, gather_directions(self.anisotropy))
        cells, coarse = len(self.density) - 3, self.light.shape[1] - 3
        flux = np.float32(3.0 * reduced_anisotropy(self.anisotropy))
        sigma, scale = np.float32(self.sigma_hat), np.float32(SCALE)
        start = positions[:, None] + np.float32(0.5)
        distance, tau, single, reduced, scattered = np.zeros((5, *towards.shape[:2]), np.float32)
        extinction = sigma * _sample(self.density, start * np.float32(cells))
        step = np.minimum(np.float32(1.0 / cells), THICKNESS / np.maximum(extinction, np.float32(1e-6)))
        step = np.broadcast_to(step, tau.shape)
        for _ in range(STEPS):
            place = start + (distance + np.float32(0.5) * step)[..., None] * towards
            extinction = sigma * _sample(self.density, place * np.float32(cells))
            gained = extinction * step
            sun = np.maximum(sigma * _sample(self.depth, place * np.float32(cells)), 0.0)
            fluence, *flow = (_sample(values, place * np.float32(coarse)) for values in self.light)
            source = fluence - flux * sum(part * along for part, along in zip(flow, np.moveaxis(towards, -1, 0)))
            passed = np.exp(-tau) * -np.expm1(-gained)
            single += passed * np.exp(-sun)
            scattered += passed * np.maximum(source, np.float32(MIN_SHARE) * fluence)
            reduced += np.exp(-scale * (tau + sun)) * -np.expm1(-scale * gained)
            tau += gained
            distance = distance + step
            thin = np.float32(THICKNESS) * (1 + tau) / np.maximum(extinction, np.float32(1e-6))
            step = np.minimum(step * np.float32(GROWTH), np.maximum(thin, step / np.float32(GROWTH)))
        found[...] = np.stack([single, reduced, scattered, np.exp(-tau)], axis=-1)


def _described(padded: np.ndarray) -> Grid:
    return Grid(values=np.ascontiguousarray(padded), size=np.array(padded.shape), shape=np.array(padded.shape) - 3)


def _sample(padded: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Trilinear values (...) at places (..., 3) in cells, of which the first, behind the padding, begins at 0."""
    at = np.clip(cells + np.float32(0.5), 0.0, len(padded) - 2)
    cell = at.astype(int)
    i, j, k = np.moveaxis(cell, -1, 0)
    x, y, z = np.moveaxis(at - cell, -1, 0)
    rows = [
        padded[i + a, j + b, k] + z * (padded[i + a, j + b, k + 1] - padded[i + a, j + b, k])
        for a in (0, 1)
        for b in (0, 1)
    ]
    low, high = rows[0] + y * (rows[1] - rows[0]), rows[2] + y * (rows[3] - rows[2])
    return low + x * (high - low)
