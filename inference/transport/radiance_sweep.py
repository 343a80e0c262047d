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
    """Fluence (x, y, z) and flux (3, x, y, z) of light that is emitted and attenuated, without scattering.

    extinction, emission: (x, y, z), of cells of edge `cell`; emission is radiance per unit of length. face: directions
    along an edge of each face of a cube, an even number. Conserves energy: a cell
    absorbs its extinction times its fluence. Raises Cancelled.
    """
    swept = np.zeros((4, *extinction.shape))
    slopes, weights = directions(face)
    lengths, kinds = np.unique(np.sqrt(1.0 + (slopes**2).sum(axis=1)).round(12), return_inverse=True)
    cells = _cells(extinction, emission, cell * lengths)
    for axis in range(3):
        for signs in np.ndindex(2, 2, 2):
            cancel.check()
            # Flipped such that all of these directions rise along every axis, and most along the first.
            flips = (slice(None), *(slice(None, None, -1 if sign else 1) for sign in signs))
            unit = np.insert(slopes, axis, 1.0, axis=1) * np.where(signs, -1.0, 1.0) / lengths[kinds][:, None]
            gather = weights[:, None] * np.insert(unit, 0, 1.0, axis=1)
            _follow(cells, slopes, kinds, gather, swept, flips, axis)
    return swept[0], swept[1:]


def _cells(extinction: np.ndarray, emission: np.ndarray, lengths: np.ndarray) -> list[np.ndarray]:
    """What cells do to light that takes so long a way through them, four (K, x, y, z) for lengths (K,).

    Transmittance; mean of exp(-tau) within the cell; and what the cell adds to the radiance that leaves it, and to the
    mean within it.
    """
    lengths = lengths[:, None, None, None]
    depth = np.maximum(extinction * lengths, MIN_DEPTH)
    given, lost = emission * lengths, -np.expm1(-depth)
    lost_fraction = lost / depth
    return [1.0 - lost, lost_fraction, given * lost_fraction, given * (1.0 - lost_fraction) / depth]


def _follow(
    cells: list[np.ndarray],
    slopes: np.ndarray,
    kinds: np.ndarray,
    gather: np.ndarray,
    swept: np.ndarray,
    flips: tuple[slice, ...],
    axis: int,
) -> None:
    """Add the light along directions with slopes (n, 2) to `swept`, (4, x, y, z).

    cells: from `_cells`. kinds: (n,), which of them each direction meets. gather: (n, 4), weights of radiance in sums.
    flips, axis: how the cells are turned such that the directions rise along all axes, and most along the first.
    """
    turned = np.moveaxis(swept[flips], 1 + axis, 1)[0]
    passed, mean, given, added = cells
    call(
        "sweep_radiance",
        shape=np.array(turned.shape),
        strides=np.array(turned.strides) // turned.itemsize,
        directions=len(slopes),
        slopes=slopes,
        weights=gather,
        kinds=kinds.astype(np.int64),
        passed=passed,
        mean=mean,
        given=given,
        added=added,
        cells=turned.size,
        first=(turned.ctypes.data - swept.ctypes.data) // turned.itemsize,
        fluence=tuple(swept),
        scratch=np.empty(2 * (turned.shape[1] + 1) * (turned.shape[2] + 1)),
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
