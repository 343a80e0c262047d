# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that has scattered by a wide angle once, swept along directions all over the sphere.

Its source in a cell is light that comes from around a few directions, scattered by the part p_w of the phase function
that `forward_peak` tells. Radiance travels as in `radiance_sweep`, interpolated between the cells of one slice and
those of the next; what is kept are its moments by `spherical_harmonics`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..kernels.library import call
from ..numerics.exponential import one_minus_exp
from ..numerics.spherical_harmonics import spherical_harmonics
from ..runtime.cancellation import NEVER, CancelToken
from ..transport.radiance_sweep import directions
from .forward_peak import ForwardPeak
from .held_cells import with_neighbours

#: Directions along an edge of each face of a cube.
FACE = 4
MOMENTS = 16
#: Most lobes of a cell whose directions are kept apart.
KEPT = 2
# Kinds of cells.
EMPTY, NEIGHBOUR, FILLED = 0, 1, 2
# Lower bound of the optical thickness of a cell.
MIN_DEPTH = np.float32(1e-6)


@dataclass(frozen=True)
class Lobe:
    """Light that comes from around one direction in each cell.

    amount: (x, y, z), its fluence. along: (3, x, y, z), unit vectors along which it goes. straightness: (x, y, z), the
    mean cosine around them, in [0, 1], or one of all cells.
    """

    amount: np.ndarray
    along: np.ndarray
    straightness: np.ndarray | float

    @classmethod
    def of(cls, fluence: np.ndarray, flux: np.ndarray) -> "Lobe":
        """Light of a fluence (x, y, z) and a flux (3, x, y, z)."""
        size, least = np.sqrt((flux**2).sum(axis=0)), np.float32(1e-30)
        return cls(fluence, flux / np.maximum(size, least), np.minimum(size / np.maximum(fluence, least), 1.0))

    def chosen(self, where: np.ndarray, other: "Lobe") -> "Lobe":
        """This one in the cells of a mask (x, y, z), another elsewhere."""
        parts = zip((self.amount, self.along, self.straightness), (other.amount, other.along, other.straightness))
        return Lobe(*(np.where(where, mine, others) for mine, others in parts))


class JoinedLobes:
    """The sum of many lobes: the brightest of each cell, and one of the mean direction of all others."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        zeros = np.zeros((3, *shape), np.float32)
        self._kept: list[Lobe] = []
        self._fluence, self._flux = zeros[0], zeros

    def add(self, lobe: Lobe) -> None:
        """Add a lobe; those added may be kept as they are."""
        if len(self._kept) < KEPT:
            self._kept.append(lobe)
            return
        for number, kept in enumerate(self._kept):
            brighter = lobe.amount > kept.amount
            self._kept[number] = lobe.chosen(brighter, kept)
            lobe = kept.chosen(brighter, lobe)
        self._fluence = self._fluence + lobe.amount
        self._flux = self._flux + lobe.amount * lobe.straightness * lobe.along

    @property
    def lobes(self) -> list[Lobe]:
        """At most KEPT and one."""
        return [*self._kept, *([Lobe.of(self._fluence, self._flux)] if self._fluence.any() else [])]


def scattered_wide(lobes: Sequence[Lobe], peak: ForwardPeak, along: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Light float32 (D, x, y, z), 1/sr, of lobes that scatters by wide angles along unit vectors (D, 3), over 1 - G^2.

    shares: (D,), of the sphere. As much in all as scatters, whatever the directions.
    """
    scattered = np.zeros((len(along), *lobes[0].amount.shape), np.float32)
    for lobe in lobes:
        row = _row(lobe, peak)
        phases = np.stack([peak.table[row, _column(lobe, one, peak)] for one in along])
        sums = sum(np.float32(4.0 * np.pi * share) * phase for share, phase in zip(shares, phases))
        scattered += phases * (lobe.amount * np.float32(peak.share / (1.0 - peak.anisotropy**2)) / sums)
    return scattered


def wide_light(
    depth: np.ndarray,
    albedo: float,
    lobes: Sequence[Lobe],
    peak: ForwardPeak,
    cancel: CancelToken = NEVER,
) -> np.ndarray:
    """Moments float32 (16, x, y, z) of light that has scattered by a wide angle once: radiance times harmonics.

    depth: float32 (x, y, z), optical thickness of a cell's edge, and albedo, both delta-scaled. Raises Cancelled.
    """
    slopes, weights = directions(FACE)
    lengths = np.sqrt(1.0 + (slopes**2).sum(axis=1))
    different, kinds = np.unique(lengths.round(12), return_inverse=True)
    thickness = np.maximum(depth * different.astype(np.float32)[:, None, None, None], MIN_DEPTH)
    lost = one_minus_exp(thickness)
    # Transmittance along each direction, and the mean of exp(-tau) within a cell.
    passed = np.stack([np.float32(1.0) - lost[kind] for kind in kinds], axis=-1)
    mean = np.stack([lost[kind] / thickness[kind] for kind in kinds], axis=-1)
    packed = np.empty((*depth.shape, len(lobes), 5), np.float32)
    for number, lobe in enumerate(lobes):
        packed[..., number, 0] = lobe.amount * np.float32(albedo)
        packed[..., number, 1:4] = np.moveaxis(lobe.along, 0, -1)
        packed[..., number, 4] = _row(lobe, peak)
    swept, held = np.zeros((*depth.shape, MOMENTS), np.float32), _held(depth)
    cells = passed, mean, packed, held, swept
    for axis in range(3):
        for signs in np.ndindex(2, 2, 2):
            cancel.check()
            along = np.insert(slopes, axis, 1.0, axis=1) * np.where(signs, -1.0, 1.0) / lengths[:, None]
            harmonics = weights[:, None] * spherical_harmonics(along).T
            _follow(cells, (axis, signs), (slopes, along, harmonics), peak)
    return np.moveaxis(swept, -1, 0)


def _held(depth: np.ndarray) -> np.ndarray:
    """Kinds of cells, uint8 (x, y, z): EMPTY, NEIGHBOUR of matter, within which light is interpolated, or FILLED."""
    filled = depth > 0.0
    near = with_neighbours(filled)
    return np.where(filled, np.uint8(FILLED), np.where(near, np.uint8(NEIGHBOUR), np.uint8(EMPTY)))


def _row(lobe: Lobe, peak: ForwardPeak) -> np.ndarray:
    last = len(peak.table) - 1
    row = np.clip(np.asarray(lobe.straightness, np.float32) * np.float32(last) + np.float32(0.5), 0.0, last)
    return np.broadcast_to(row.astype(np.int32), lobe.amount.shape)


def _column(lobe: Lobe, along: np.ndarray, peak: ForwardPeak) -> np.ndarray:
    last = peak.table.shape[1] - 1
    cosine = sum(np.float32(part) * values for part, values in zip(along, lobe.along))
    return ((np.clip(cosine, -1.0, 1.0) + 1.0) * np.float32(0.5 * last) + np.float32(0.5)).astype(np.int32)


Cells = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Turn = tuple[int, tuple[int, ...]]
Ways = tuple[np.ndarray, np.ndarray, np.ndarray]


def _follow(cells: Cells, turn: Turn, ways: Ways, peak: ForwardPeak) -> None:
    """Add the light along directions that rise most along an axis, once cells are flipped along those with a sign.

    cells: transmittances and means (x, y, z, D), lobes (x, y, z, L, 5), kinds of `_held`, and moments (x, y, z, 16),
    added to. turn: the axis and the signs. ways: slopes (D, 2), unit vectors (D, 3) and weights (D, 16) of directions.
    """
    (passed, mean, packed, held, swept), (axis, signs), (slopes, along, harmonics) = cells, turn, ways
    flips = tuple(slice(None, None, -1 if sign else 1) for sign in signs)
    turned = np.moveaxis(held[flips], axis, 0)
    call(
        "sweep_moments",
        shape=np.array(turned.shape),
        strides=np.array(turned.strides),
        first=turned.ctypes.data - held.ctypes.data,
        kinds=held,
        slopes=np.ascontiguousarray(slopes.T, np.float32),
        along=np.ascontiguousarray(along.T, np.float32),
        weights=np.ascontiguousarray(harmonics, np.float32),
        passed=passed,
        mean=mean,
        lobes=packed.shape[3],
        light=packed,
        rows=peak.table.shape[0],
        columns=peak.table.shape[1],
        table=peak.table,
        moments=swept,
        scratch=np.empty(2 * len(slopes) * (turned.shape[1] + 1) * (turned.shape[2] + 1), np.float32),
    )
