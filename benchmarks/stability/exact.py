# SPDX-License-Identifier: GPL-3.0-or-later
"""Alpha and single scattering of a trilinear density in double precision, without steps of a fixed size.

Between two planes of voxel centres the density along a ray is a cubic, which two Gauss–Legendre nodes integrate
exactly. Depths are even quantiles of the ray's opacity, which is accurate however steep the density is.
"""

import numpy as np
from scipy.ndimage import map_coordinates

from inference.numerics.intersection import box_interval
from inference.scene.camera_rays import camera_rays

# Midpoints of even shares of a ray's opacity at which the transmittance to the sun is evaluated.
QUANTILES = 192
HALVINGS = 60
GAUSS = 0.5 / np.sqrt(3.0)


class ExactVolume:
    """A density (nx, ny, nz) with 0 outside, placed by `world_from_index`, with an extinction per unit density."""

    def __init__(self, volume, sigma_t: float):
        self.density = np.pad(volume.density.astype(np.float64), 2)
        inverse = np.linalg.inv(volume.world_from_index)
        self.linear, self.offset, self.sigma_t = inverse[:3, :3], inverse[:3, 3], sigma_t
        self.box = np.full(3, -1.0), np.array(volume.density.shape, np.float64)

    def extinction(self, index):
        """At continuous indices (..., 3)."""
        places = index.reshape(-1, 3).T + 2.0
        values = map_coordinates(self.density, places, order=1, mode="constant", output=np.float64)
        return self.sigma_t * values.reshape(index.shape[:-1])

    def depths(self, origins, slopes, near, far):
        """Distances (R, S + 1) at which rays cross planes of voxel centres, and the optical depth up to each.

        origins, slopes: (R, 3) in indices and indices per distance; near, far: (R,).
        """
        cuts = [near[:, None], far[:, None]]
        for axis in range(3):
            planes = np.arange(-1, self.density.shape[axis] - 3)
            with np.errstate(divide="ignore", invalid="ignore"):
                t = (planes - origins[:, axis, None]) / slopes[:, axis, None]
            cuts.append(np.where(np.isfinite(t), t, near[:, None]))
        cuts = np.sort(np.clip(np.concatenate(cuts, axis=1), near[:, None], far[:, None]), axis=1)
        tau = self.through(origins[:, None], slopes[:, None], cuts[:, :-1], cuts[:, 1:])
        return cuts, np.concatenate([np.zeros((len(near), 1)), np.cumsum(tau, axis=1)], axis=1)

    def through(self, origins, slopes, start, end):
        """Optical depth between two distances with no plane of voxel centres in between."""
        middle, width = 0.5 * (start + end), end - start
        total = 0.0
        for side in (-GAUSS, GAUSS):
            total = total + self.extinction(origins + (middle + side * width)[..., None] * slopes)
        return 0.5 * width * total

    def to_sun(self, index, direction):
        """Optical depth (N,) from indices (N, 3) along a world direction (3,)."""
        slopes = np.broadcast_to(self.linear @ direction, index.shape)
        _, far = box_interval(index, slopes, *self.box)
        return self.depths(index, slopes, np.zeros(len(index)), np.maximum(far, 0.0))[1][:, -1]


def exact_view(volume, sigma_t: float, suns, camera):
    """Alpha (R,) and, for albedo, phase function and irradiance of 1, single scattering (R, L) of a camera's rays."""
    exact = ExactVolume(volume, sigma_t)
    origins, directions, clip_near, clip_far = camera_rays(camera)
    origins, slopes = origins @ exact.linear.T + exact.offset, directions @ exact.linear.T
    near, far = box_interval(origins, slopes, *exact.box)
    near, far = np.maximum(near, clip_near), np.minimum(far, clip_far)
    alpha, single = np.zeros(len(near)), np.zeros((len(near), len(suns)))
    hit = np.flatnonzero(near < far)
    if not len(hit):
        return alpha, single
    cuts, tau = exact.depths(origins[hit], slopes[hit], near[hit], far[hit])
    alpha[hit] = -np.expm1(-tau[:, -1])
    places = _at_quantiles(exact, origins[hit], slopes[hit], cuts, tau)
    for l, sun in enumerate(suns):
        through = np.exp(-exact.to_sun(places.reshape(-1, 3), sun.direction)).reshape(places.shape[:2])
        single[hit, l] = alpha[hit] * through.mean(axis=1)
    return alpha, single


def _at_quantiles(exact, origins, slopes, cuts, tau):
    """Indices (R, QUANTILES, 3) where each ray has reached even shares of its opacity."""
    share = (np.arange(QUANTILES) + 0.5) / QUANTILES
    wanted = -np.log1p(share * np.expm1(-tau[:, -1:]))
    cell = np.stack([np.searchsorted(t[1:], w) for t, w in zip(tau, wanted)])
    cell = np.minimum(cell, cuts.shape[1] - 2)
    ray = np.arange(len(cuts))[:, None]
    start, rest = cuts[ray, cell], wanted - tau[ray, cell]
    low, high = start.copy(), cuts[ray, cell + 1]
    origins, slopes = origins[:, None], slopes[:, None]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        short = exact.through(origins, slopes, start, middle) < rest
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return origins + low[..., None] * slopes
