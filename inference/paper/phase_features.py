# SPDX-License-Identifier: GPL-3.0-or-later
"""The Henyey-Greenstein phase function integrated over cones (appendix A.4 of the paper).

The phase function carries 1/(4 pi) and integrates to 1 over the sphere.
"""

import numpy as np
from numpy.typing import ArrayLike

from ..features.stencil import LAYER_MIPS, LAYER_POINTS, LOW_POINTS, Stencil
from ..plan.resolution import LEVEL0_CELLS
from ..scene.phase_function import henyey_greenstein


def cumulative_phase(cosine: ArrayLike, half_angle: ArrayLike, anisotropy: float) -> np.ndarray:
    """Eq. 3: the phase function integrated over a cone, dimensionless in [0, 1].

    cosine: between the direction of the light and the cone's axis. half_angle: c/2 in [0, pi]. Arrays broadcast.
    Integrates the Legendre series of the phase function, whose coefficients are g^l, term by term; exact up to the
    truncation at g^l < 1e-7.
    """
    x = np.asarray(cosine, np.float64)
    z = np.cos(np.asarray(half_angle, np.float64))
    g = float(anisotropy)
    terms = 1 if g == 0.0 else int(np.ceil(np.log(1e-7) / np.log(abs(g)))) + 1
    total = np.broadcast_to((1.0 - z) / 2.0, np.broadcast_shapes(x.shape, z.shape)).copy()
    # P_{l-1} and P_l at x, and P_{l-1}, P_l and P_{l+1} at the cone's edge, by Bonnet's recursion.
    px_before, px = np.ones_like(x), x
    pz_before, pz = np.ones_like(z), z
    power = 1.0
    for l in range(1, terms):
        power *= g
        pz_after = ((2 * l + 1) * z * pz - l * pz_before) / (l + 1)
        total += 0.5 * power * px * (pz_before - pz_after)
        px_before, px = px, ((2 * l + 1) * x * px - l * px_before) / (l + 1)
        pz_before, pz = pz, pz_after
    return np.clip(total, 0.0, 1.0)


def cone_half_angles(distance: ArrayLike, mip: ArrayLike) -> np.ndarray:
    """Half angle c/2 that a ball of the size of a cell of `mip` subtends.

    distance: from the centre of the ball, in cube edges. Returns pi inside the ball. Arrays broadcast.
    """
    radius = 0.5 * 2.0 ** np.asarray(mip) / LEVEL0_CELLS
    distance = np.asarray(distance)
    outside = distance > radius
    return np.where(outside, np.arcsin(np.minimum(radius / np.where(outside, distance, 1.0), 1.0)), np.pi)


class PhaseFeatures:
    """Feature P of every stencil point, tabulated over gamma.

    The stencil's frame follows both omega and the sun, so P depends only on the angle gamma between them and on the
    anisotropy.
    """

    KNOTS = 513

    def __init__(self, stencil: Stencil, anisotropy: float):
        gamma = np.linspace(0.0, np.pi, self.KNOTS)
        sun = np.stack([np.sin(gamma), np.zeros_like(gamma), np.cos(gamma)], axis=1)
        mips = np.repeat(LAYER_MIPS, LAYER_POINTS)
        # Low-frequency points: v is fixed in the frame, and the sun rotates with gamma.
        distance = np.linalg.norm(stencil.low, axis=1)
        v = stencil.low.astype(np.float64) / np.maximum(distance, 1e-12)[:, None]
        half_angle = cone_half_angles(distance, mips[:LOW_POINTS])
        to_camera = cumulative_phase(v[:, 2], half_angle, anisotropy)
        to_sun = cumulative_phase(sun @ v.T, half_angle, anisotropy)
        low = to_camera * to_sun
        # The centre has no direction and takes the phase function itself.
        low[:, distance == 0.0] = henyey_greenstein(np.cos(gamma), anisotropy)[:, None]
        # High-frequency points: v is the direction of the sun.
        half_angle = cone_half_angles(stencil.high.astype(np.float64), mips[LOW_POINTS:])
        high = cumulative_phase(np.cos(gamma)[:, None], half_angle, anisotropy) * cumulative_phase(
            1.0, half_angle, anisotropy
        )
        self.table = np.log1p(np.concatenate([low, high], axis=1)).astype(np.float32)

    def __call__(self, gamma: np.ndarray) -> np.ndarray:
        """float32 (N, 192) at angles gamma (N,), linear between knots."""
        position = np.clip(np.asarray(gamma, np.float32) / np.float32(np.pi), 0, 1) * np.float32(self.KNOTS - 1)
        knot = np.minimum(position.astype(np.int32), self.KNOTS - 2)
        fraction = (position - knot)[:, None]
        return self.table[knot] * (1.0 - fraction) + self.table[knot + 1] * fraction
