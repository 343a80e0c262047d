"""The diffusion equation on cells, -div(D grad phi) = source, which light obeys far from where it enters.

At the faces of all cells light leaves and none comes in (Marshak's condition).
"""

import numpy as np

#: Added to 3 sigma_tr in D = 1 / (3 sigma_tr): in empty space light crosses a good part of the cells.
THIN = 2.0
TOLERANCE, MOST_ITERATIONS = 1e-3, 400


def couple(spread, h: float, boundaries=None):
    """What -div(D grad phi) is on cells of edge h, times h^2: diagonal (x, y, z), and couplings (3, x, y, z).

    spread: D of each cell, float64; boundaries: where light ends as at the faces of all, or None.
    """
    diagonal, couplings = np.zeros_like(spread), np.zeros((3, *spread.shape))
    for axis in range(3):
        d = np.moveaxis(spread, axis, 0)
        coupling = np.moveaxis(couplings[axis], axis, 0)
        total = np.moveaxis(diagonal, axis, 0)
        # Harmonic means, so that the flux through a face is that through both half cells.
        coupling[:-1] = 2.0 * d[1:] * d[:-1] / (d[1:] + d[:-1])
        if boundaries is not None:
            boundaries.end(axis, coupling, total, d, h)
        total += coupling
        total[1:] += coupling[:-1]
        for side in (0, -1):
            total[side] += 0.5 * h / (1.0 + h / (4.0 * d[side]))
    return diagonal, couplings


def _apply(diagonal, couplings, x):
    y = diagonal * x
    for axis in range(3):
        c, u, v = (np.moveaxis(a, axis, 0) for a in (couplings[axis], x, y))
        v[:-1] -= c[:-1] * u[1:]
        v[1:] -= c[:-1] * u[:-1]
    return y


def solve(diagonal, couplings, source, least: float = 0.0, tolerance=TOLERANCE, iterations=MOST_ITERATIONS):
    """Conjugate gradients with the diagonal as preconditioner; (x, y, z) of the source's type, >= least."""
    x = np.zeros_like(source)
    residual = source.copy()
    z = residual / diagonal
    p, rz = z.copy(), float(np.vdot(residual, z))
    enough = rz * tolerance**2
    for _ in range(iterations):
        if rz <= enough:
            break
        ap = _apply(diagonal, couplings, p)
        step = rz / float(np.vdot(p, ap))
        x += step * p
        residual -= step * ap
        z = residual / diagonal
        rz, before = float(np.vdot(residual, z)), rz
        p = z + (rz / before) * p
    return np.maximum(x, least)
