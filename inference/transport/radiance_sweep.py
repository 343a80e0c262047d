# SPDX-License-Identifier: GPL-3.0-or-later
"""Emitted and attenuated light on coarse cells, swept along directions all over the sphere."""

import numpy as np

from ..kernels.library import call
from ..runtime.cancellation import NEVER, CancelToken

# Lower bound of the optical thickness of a cell.
MIN_DEPTH = 1e-6


def sweep_radiance(
    extinction: np.ndarray,
    emission: np.ndarray,
    cell: float,
    face: int,
    cancel: CancelToken = NEVER,
) -> tuple[np.ndarray, np.ndarray]:
    """Fluence (x, y, z) and flux (3, x, y, z), float32, of light that is emitted and attenuated, without scattering.

    extinction, emission: (x, y, z), of cells of edge `cell`; emission is radiance per unit of length. face: directions
    along an edge of each face of a cube, an even number. Conserves energy: a cell
    absorbs its extinction times its fluence. Raises Cancelled.
    """
    swept = np.zeros((4, *extinction.shape), np.float32)
    slopes, weights = directions(face)
    lengths, kinds = np.unique(np.sqrt(1.0 + (slopes**2).sum(axis=1)).round(12), return_inverse=True)
    cells = _cells(extinction, emission, cell * lengths)
    for axis in range(3):
        # What directions rise most along goes before the axis whose neighbours follow one another in memory.
        ahead = axis == 2
        turned = np.ascontiguousarray(np.moveaxis(cells, -1, 2)) if ahead else cells
        sums = np.zeros((4, *turned.shape[2:]), np.float32) if ahead else swept
        for signs in np.ndindex(2, 2, 2):
            cancel.check()
            along = np.where(signs, -1, 1)
            unit = np.insert(slopes, axis, 1.0, axis=1) * along / lengths[kinds][:, None]
            gather = weights[:, None] * np.insert(unit, 0, 1.0, axis=1)
            _follow(turned, (slopes, kinds, gather), sums, along, axis)
        if ahead:
            swept += np.moveaxis(sums, 1, -1)
    return swept[0], swept[1:]


def _cells(extinction: np.ndarray, emission: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """What cells do to light that takes so long a way through them, float32 (4, K, x, y, z) for lengths (K,).

    Transmittance; mean of exp(-tau) within the cell; and what the cell adds to the radiance that leaves it, and to the
    mean within it.
    """
    lengths = lengths[:, None, None, None]
    depth = np.maximum(extinction * lengths, MIN_DEPTH)
    given, lost = emission * lengths, -np.expm1(-depth)
    lost_fraction = lost / depth
    parts = 1.0 - lost, lost_fraction, given * lost_fraction, given * (1.0 - lost_fraction) / depth
    return np.stack(parts).astype(np.float32)


def _follow(
    cells: np.ndarray,
    directions: tuple[np.ndarray, np.ndarray, np.ndarray],
    sums: np.ndarray,
    signs: np.ndarray,
    axis: int,
) -> None:
    """Add the light along directions to sums, float32 (4, x, y, z), the last axis before the others if it is `axis`.

    cells: from `_cells`. directions: slopes (n, 2); which of the cells each direction meets, (n,); and weights of its
    radiance in sums, (n, 4). signs: (3,), 1 or -1, of the way along each axis. axis: along which it is the steepest.
    """
    slopes, kinds, gather = directions
    passed, mean, given, added = cells
    # Of the arrays' axes, the steepest and the other two.
    order = (1, 0, 2) if axis == 1 else (0, 1, 2)
    shape, strides = np.array(sums.shape[1:])[[*order]], np.array(sums.strides[1:])[[*order]] // sums.itemsize
    call(
        "sweep_radiance",
        shape=shape,
        strides=strides[:2],
        signs=np.concatenate([signs[[axis]], np.delete(signs, axis)]),
        directions=len(slopes),
        slopes=slopes.astype(np.float32),
        weights=gather.astype(np.float32),
        kinds=kinds.astype(np.int64),
        passed=passed,
        mean=mean,
        given=given,
        added=added,
        cells=sums[0].size,
        fluence=sums,
        scratch=np.empty(2 * len(slopes) * (shape[1] + 2) * (shape[2] + 2), np.float32),
    )


def directions(face: int) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (n, 2) and solid angles (n,) of one 24th of the sphere.

    Directions that rise along all axes, and most along the first.
    """
    angles = (np.arange(face // 2) + 0.5) * (np.pi / 2.0 / face)
    slopes = np.tan(np.stack(np.meshgrid(angles, angles, indexing="ij"), axis=-1).reshape(-1, 2))
    # Jacobian of even steps in both angles.
    weights = (1.0 + slopes[:, 0] ** 2) * (1.0 + slopes[:, 1] ** 2) / (1.0 + (slopes**2).sum(axis=1)) ** 1.5
    return slopes, weights * (4.0 * np.pi / 24.0 / weights.sum())
