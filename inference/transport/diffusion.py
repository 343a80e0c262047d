# SPDX-License-Identifier: GPL-3.0-or-later
"""The diffusion equation on cells, -div(D grad phi) = source, which light obeys far from where it enters.

At the outer faces light leaves and none enters (Marshak's boundary condition).
"""

import numpy as np

from ..kernels import library, structures
from ..occluders.cell_boundaries import CellBoundaries
from ..runtime.cancellation import NEVER, CancelToken

#: Added to 3 sigma_tr in D = 1 / (3 sigma_tr), in units of 1 / edge, so that D stays finite in empty space.
THIN = 2.0
TOLERANCE, MAX_ITERATIONS = 1e-3, 400
# Iterations that one call of the kernel takes.
ITERATIONS_PER_CALL = 50


def couple(diffusion: np.ndarray, h: float, boundaries: CellBoundaries | None = None) -> tuple[np.ndarray, np.ndarray]:
    """The operator -div(D grad phi) on cells of edge h, times h^2: diagonal (x, y, z) and couplings (3, x, y, z).

    diffusion: D of each cell, float64. boundaries: surfaces at which light ends as at the outer faces, or None.
    """
    diagonal, couplings = np.zeros_like(diffusion), np.zeros((3, *diffusion.shape))
    for axis in range(3):
        d = np.moveaxis(diffusion, axis, 0)
        coupling = np.moveaxis(couplings[axis], axis, 0)
        total = np.moveaxis(diagonal, axis, 0)
        # The harmonic mean makes the flux through a face equal to that through both half cells.
        coupling[:-1] = 2.0 * d[1:] * d[:-1] / (d[1:] + d[:-1])
        if boundaries is not None:
            boundaries.end(axis, coupling, total, d, h)
        total += coupling
        total[1:] += coupling[:-1]
        for side in (0, -1):
            total[side] += 0.5 * h / (1.0 + h / (4.0 * d[side]))
    return diagonal, couplings


def solve(
    equation: tuple[np.ndarray, np.ndarray],
    source: np.ndarray,
    least: float = 0.0,
    tolerance: float = TOLERANCE,
    iterations: int = MAX_ITERATIONS,
    cancel: CancelToken = NEVER,
) -> np.ndarray:
    """Solve the equation by conjugate gradients with the diagonal as preconditioner.

    equation: diagonal and couplings, from `couple`. source: (x, y, z). least: lower bound of the solution. tolerance:
    of the residual, relative to the first. iterations: at most. Returns float64 (x, y,
    z). Raises Cancelled.
    """
    diagonal, couplings = (np.ascontiguousarray(array) for array in equation)
    x = np.zeros(source.shape)
    residual = np.array(source, np.float64, order="C")
    p = residual / diagonal
    # BLAS would wake its threads for a dot product, which then spin (`numerics.small_matmul`).
    rz = float((residual * p).sum())
    limit = rz * tolerance**2
    system = structures.Diffusion(
        shape=np.array(source.shape),
        diagonal=diagonal,
        couplings=couplings,
        x=x,
        residual=residual,
        direction=p,
        product=np.empty_like(x),
        rz=rz,
        limit=limit,
    )
    for done in range(0, iterations, ITERATIONS_PER_CALL):
        cancel.check()
        system.iterations = min(ITERATIONS_PER_CALL, iterations - done)
        if library.load_kernels().call("conjugate_gradients", system) < system.iterations:
            break
    return np.maximum(x, least)
