# SPDX-License-Identifier: GPL-3.0-or-later
"""How far light goes between two scatterings: a forward phase function scatters into a ray what comes from there."""

from collections.abc import Callable, Sequence

import numpy as np

# Longest mean free path, in edges of the cube.
FARTHEST = 0.125
# Lower bound of the optical depth of a part of a ray.
MIN_DEPTH = 1e-6


def mean_free_path(density: np.ndarray, sigma_hat: float) -> float:
    """Between scatterings where most are, in edges of the cube, and at most FARTHEST.

    density: (n, n, n), of cells of the cube. sigma_hat: extinction for density 1, per edge of the cube.
    """
    density = density.astype(np.float64)
    squares = float((density * density).sum()) * sigma_hat
    return min(float(density.sum()) / squares, FARTHEST) if squares > 0.0 else FARTHEST


def light_ahead(read: Callable[[int, float], tuple[np.ndarray, np.ndarray]], ends: Sequence[float]) -> np.ndarray:
    """Radiance that arrives at points from ahead on their rays, of the shape of what is read.

    read: gives the extinction and the emission of part number k of the rays, at the distance of its middle, per unit of
    the distance. ends: distances at which the parts end, ascending; the first begins at the points.
    """
    found, passed, begin = np.zeros((), np.float32), np.ones((), np.float32), 0.0
    for number, end in enumerate(ends):
        extinction, emission = read(number, 0.5 * (begin + end))
        depth = np.maximum(extinction * (end - begin), MIN_DEPTH)
        lost = -np.expm1(-depth)
        found = found + passed * emission * (lost / depth * (end - begin))
        passed = passed * (1.0 - lost)
        begin = end
    return found
