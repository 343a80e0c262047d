# SPDX-License-Identifier: GPL-3.0-or-later
"""How baked light differs from direction to direction."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..numerics.interpolation import pad_with_zeros, sample_padded
from ..numerics.small_matmul import affine_inverse, product
from ..scene.phase_function import henyey_greenstein

#: Polynomials of a direction's components in the quadratic and the cubic term: harmonic, so that they are orthogonal to
#: each other and to the terms before.
QUADRATIC, CUBIC = 5, 7
#: Coefficients per point of what is smooth in a DirectionalFactor: constant, linear, quadratic, cubic and of the lobe.
SMOOTH = 1 + 3 + QUADRATIC + CUBIC + 1
#: Largest absolute value of the factor's logarithm.
MAX_LOGARITHM = 8.0
#: How fast detail fades with the angle to the view that was baked, over the square of the anisotropy.
DETAIL_SHARPNESS = 8.0
#: Cosine of the angle to the baked view's ray from which on light is shown as it was baked.
SAME_DIRECTION = 1.0 - 1e-6


def _anchors(rings: Sequence[tuple[float, int]]) -> np.ndarray:
    """Unit vectors (K, 3) about the third axis, the first of each ring on the first axis: (degrees, count) of rings."""
    found = []
    for degrees, count in rings:
        turn, angle = 2.0 * np.pi * np.arange(count) / count, np.full(count, np.radians(degrees))
        found.append(np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1))
    return np.concatenate(found)


#: Rays, in the frame of `BakedView.local`, for which the smooth directions are corrected: the baked one, and others
#: that fill the cone about it. SHARPNESS: how fast a correction fades with the angle to its ray; those of neighbours
#: meet half way.
ANCHORS = _anchors(((0.0, 1), (20.0, 6), (40.0, 12)))
SHARPNESS = 24.0


@dataclass(frozen=True)
class BakedView:
    """Where the rays come from along which light was baked.

    position: (3,) of the camera in the world, or None. direction: (3,), of the parallel rays of an orthographic
    camera, or None; neither, where the mean over all directions was baked. up: (3,), the camera's vertical axis.
    """

    position: np.ndarray | None = None
    direction: np.ndarray | None = None
    up: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

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

    def frames(self, positions: np.ndarray) -> np.ndarray | None:
        """Axes (N, 3, 3) at world positions (N, 3): across the baked ray, above it and along it, one per row.

        None where there is no view.
        """
        along = self.directions(positions)
        if along is None:
            return None
        across = np.cross(along, self.up)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
        return np.stack([across, np.cross(across, along), along], axis=1)


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
class NodeGrid:
    """Coefficients at coarse points of a volume.

    values: float32 (nx, ny, nz, K), trilinear between the points and constant beyond the outermost. world_from_index:
    (4, 4).
    """

    values: np.ndarray
    world_from_index: np.ndarray

    def sample(self, positions: np.ndarray) -> np.ndarray:
        """float32 (N, K) at world positions (N, 3)."""
        index_from_world = affine_inverse(self.world_from_index)
        index = product(positions, index_from_world[:3, :3].T) + index_from_world[:3, 3]
        index = np.clip(index, 0.0, np.array(self.values.shape[:3], np.float64) - 1.0).T.astype(np.float32)
        channels = range(self.values.shape[3])
        return np.stack([sample_padded(pad_with_zeros(self.values[..., k]), index) for k in channels], axis=1)


@dataclass(frozen=True)
class DirectionalFactor:
    """Ratio of the light scattered in any direction to the light that was baked.

    The light that density 1 scatters towards the viewer of a ray along w is modelled as

        L(w) = exp(f(w) + sum_k r_k exp(SHARPNESS (w . v_k - 1))) (L / exp(d))^exp(s (w . v - 1)),
        f(w) = a + b . w + q(w) + p(w) + c log lobe(w),

    with v the direction of the baked view's ray, v_k ANCHORS about it, L the light that was baked, d its logarithm in
    the coarse voxel, and q(w) and p(w) the sums of q_k times `quadratic_terms` and p_k times `cubic_terms`. The
    corrections r_k make it what was predicted along each v_k, and L along v. Along v itself, where interpolated
    coefficients would miss it by a little, it is L. The detail L / exp(d) fades beside it, because with forward
    scattering one direction does not show what another shows. Without a view there are no anchors, and detail is that
    at a right angle to one.

    That is the mean over the colours. Where their light differs from direction to direction, each is multiplied with
    exp(g . (w - v)), v being 0 without a view.

    smooth: SMOOTH coefficients, of a, b (3), q (5), p (7) and c. anchors: of d and r_k. colours: of g, 3 for each
    colour, or None where all are alike. lobe, view: see there. sharpness: s.
    """

    smooth: NodeGrid
    anchors: NodeGrid
    colours: NodeGrid | None
    lobe: Lobe
    view: BakedView
    sharpness: float

    def __call__(self, positions: np.ndarray, directions: np.ndarray, baked: np.ndarray) -> np.ndarray:
        """Factors float32 (N, 3) at world positions (N, 3), for camera rays along unit directions (N, 3).

        baked: (N,), light that was baked there for a density of 1, mean over the colours.
        """
        terms, anchors = directional_terms(directions, self.lobe), self.anchors.sample(positions)
        fine, detail = np.log(np.maximum(baked, 1e-30)), np.full(len(positions), np.exp(-self.sharpness))
        logarithm = np.einsum("nk,nk->n", self.smooth.sample(positions), terms) - fine
        frames, turned = self.view.frames(positions), directions
        if frames is not None:
            local = np.einsum("nij,nj->ni", frames, directions)
            logarithm += np.einsum("nk,nk->n", anchors[:, 1:], anchor_terms(local))
            detail, turned = np.exp(self.sharpness * (local[:, 2] - 1.0)), directions - frames[:, 2]
        logarithm += (fine - anchors[:, 0]) * detail
        logarithms = np.repeat(logarithm[:, None], 3, axis=1)
        if self.colours is not None:
            slopes = self.colours.sample(positions).reshape(-1, 3, 3)
            logarithms += np.einsum("ncj,nj->nc", slopes, turned)
        if frames is not None:
            logarithms[local[:, 2] > SAME_DIRECTION] = 0.0
        return np.exp(np.clip(logarithms, -MAX_LOGARITHM, MAX_LOGARITHM)).astype(np.float32)


def anchor_terms(local: np.ndarray) -> np.ndarray:
    """What the corrections of a DirectionalFactor multiply: (N, K), for unit directions (N, 3) in a view's frames.

    Of the dtype of the directions.
    """
    terms: np.ndarray = np.exp(SHARPNESS * (product(local, ANCHORS.T.astype(local.dtype)) - 1.0))
    return terms


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
    """What the smooth coefficients of a DirectionalFactor multiply: (N, SMOOTH)."""
    one, bright = np.ones((len(directions), 1)), lobe.logarithm(directions)[:, None]
    return np.concatenate([one, directions, quadratic_terms(directions), cubic_terms(directions), bright], axis=1)
