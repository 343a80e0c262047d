# SPDX-License-Identifier: GPL-3.0-or-later
"""Emitted and attenuated light on coarse cells, swept along directions all over the sphere."""

import numpy as np

from ..runtime.cancellation import NEVER, CancelToken

# Lower bound of the optical thickness of a cell.
MIN_DEPTH = 1e-6


def sweep_radiance(
    extinction: np.ndarray, emission: np.ndarray, cell: float, face: int, cancel: CancelToken = NEVER
) -> tuple[np.ndarray, np.ndarray]:
    """Fluence (x, y, z) and flux (3, x, y, z) of light that is emitted and attenuated, without scattering.

    extinction, emission: (x, y, z), of cells of edge `cell`; emission is radiance per unit of length. face: directions
    along an edge of each face of a cube, an even number. Conserves energy: a cell absorbs its extinction times its
    fluence. Raises Cancelled.
    """
    fluence, flux = np.zeros(extinction.shape), np.zeros((3, *extinction.shape))
    slopes, weights = _directions(face)
    secant = np.sqrt(1.0 + slopes[:, 0] ** 2 + slopes[:, 1] ** 2)
    for axis in range(3):
        for signs in np.ndindex(2, 2, 2):
            cancel.check()
            # Flipped such that all of these directions rise along every axis, and most along the first.
            flips = tuple(slice(None, None, -1 if sign else 1) for sign in signs)
            flipped = [np.moveaxis(values[flips], axis, 0) for values in (extinction, emission, fluence)]
            light = np.zeros((len(slopes), *flipped[0].shape[1:]))
            parts = [np.moveaxis(part[flips], axis, 0) for part in flux]
            others = [a for a in range(3) if a != axis]
            for k in range(len(flipped[0])):
                light, mean = _through(light, flipped[0][k], flipped[1][k], slopes, cell * secant)
                flipped[2][k] += np.tensordot(weights, mean, 1)
                for a, along in ((axis, 1.0), *zip(others, slopes.T)):
                    direction = (-1.0 if signs[a] else 1.0) * along / secant
                    parts[a][k] += np.tensordot(weights * direction, mean, 1)
    return fluence, flux


def _through(
    light: np.ndarray, extinction: np.ndarray, emission: np.ndarray, slopes: np.ndarray, length: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance (n, b, c) that leaves a slice of cells and its mean within them, from that leaving the previous slice.

    light: (n, b, c). extinction, emission: (b, c). slopes: (n, 2) and length: (n,), of the directions.
    """
    f, g = (slopes[:, i, None, None] for i in range(2))
    moved = np.pad(light, [(0, 0), (1, 0), (1, 0)])
    moved = moved[:, 1:] * (1.0 - f) + moved[:, :-1] * f
    moved = moved[:, :, 1:] * (1.0 - g) + moved[:, :, :-1] * g
    depth = np.maximum(extinction * length[:, None, None], MIN_DEPTH)
    given = emission * length[:, None, None]
    lost = -np.expm1(-depth)
    share = lost / depth
    return moved * (1.0 - lost) + given * share, moved * share + given * (1.0 - share) / depth


def _directions(face: int) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (n, 2) and solid angles (n,) of one 24th of the sphere.

    Directions that rise along all axes, and most along the first.
    """
    angles = (np.arange(face // 2) + 0.5) * (np.pi / 2.0 / face)
    slopes = np.tan(np.stack(np.meshgrid(angles, angles, indexing="ij"), axis=-1).reshape(-1, 2))
    # Jacobian of even steps in both angles.
    weights = (1.0 + slopes[:, 0] ** 2) * (1.0 + slopes[:, 1] ** 2) / (1.0 + (slopes**2).sum(axis=1)) ** 1.5
    return slopes, weights * (4.0 * np.pi / 24.0 / weights.sum())
