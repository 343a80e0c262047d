# SPDX-License-Identifier: GPL-3.0-or-later
"""How far light goes between two scatterings: a forward phase function scatters into a ray what comes from there."""

import numpy as np

# Longest mean free path, in edges of the cube.
FARTHEST = 0.125


def mean_free_path(density: np.ndarray, sigma_hat: float) -> float:
    """Between scatterings where most are, in edges of the cube, and at most FARTHEST.

    density: (n, n, n), of cells of the cube. sigma_hat: extinction for density 1, per edge of the cube.
    """
    density = density.astype(np.float64)
    squares = float((density * density).sum()) * sigma_hat
    return min(float(density.sum()) / squares, FARTHEST) if squares > 0.0 else FARTHEST
