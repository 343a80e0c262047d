"""Henyey-Greenstein phase function and its integral over cones (A.4).

The phase function carries 1/(4 pi) and integrates to 1 over the sphere.
"""

import numpy as np

from ..plan.resolution import LEVEL0_CELLS
from ..scene.phase_function import henyey_greenstein
from .stencil import LAYER_MIPS, LAYER_POINTS, LOW_POINTS, Stencil


def cumulative_phase(cosine, half_angle, anisotropy: float):
    """Eq. 3: the phase function integrated over a cone, dimensionless in [0, 1].

    cosine: between the light's direction and the cone's axis; half_angle: c/2 in
    [0, pi]; arrays broadcast. Sums the Legendre series of the phase function,
    whose coefficients are g^l, term by term over the cone: exact up to the
    truncation at g^l < 1e-7.
    """
    x = np.asarray(cosine, np.float64)
    z = np.cos(np.asarray(half_angle, np.float64))
    g = float(anisotropy)
    terms = 1 if g == 0.0 else int(np.ceil(np.log(1e-7) / np.log(abs(g)))) + 1
    total = np.broadcast_to((1.0 - z) / 2.0, np.broadcast_shapes(x.shape, z.shape)).copy()
    # P_{l-1}, P_l at x, and P_{l-1}, P_l, P_{l+1} at the cone's edge, by Bonnet's recursion.
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


def cone_half_angles(distance, mip) -> np.ndarray:
    """c/2 under which a ball of one mip cell is seen from `distance` (cube edges); pi inside it."""
    radius = 0.5 * 2.0 ** np.asarray(mip) / LEVEL0_CELLS
    outside = distance > radius
    return np.where(outside, np.arcsin(np.minimum(radius / np.where(outside, distance, 1.0), 1.0)), np.pi)


class PhaseFeatures:
    """Feature P of every stencil point, as a table over gamma.

    The stencil's frame follows both omega and the sun, so P depends on nothing but the
    angle gamma between them and the anisotropy.
    """

    KNOTS = 513

    def __init__(self, stencil: Stencil, anisotropy: float):
        gamma = np.linspace(0.0, np.pi, self.KNOTS)
        sun = np.stack([np.sin(gamma), np.zeros_like(gamma), np.cos(gamma)], axis=1)
        mips = np.repeat(LAYER_MIPS, LAYER_POINTS)
        # Low-frequency points: v is fixed in the frame, the sun turns with gamma.
        distance = np.linalg.norm(stencil.low, axis=1)
        v = stencil.low.astype(np.float64) / np.maximum(distance, 1e-12)[:, None]
        half_angle = cone_half_angles(distance, mips[:LOW_POINTS])
        to_camera = cumulative_phase(v[:, 2], half_angle, anisotropy)
        to_sun = cumulative_phase(sun @ v.T, half_angle, anisotropy)
        low = to_camera * to_sun
        # The centre has no direction: the phase function itself.
        low[:, distance == 0.0] = henyey_greenstein(np.cos(gamma), anisotropy)[:, None]
        # High-frequency points: v is the sun's direction.
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
