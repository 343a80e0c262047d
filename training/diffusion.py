"""The diffusion approximation at points of training data, which have an optical density each.

The equation depends on the reduced extinction alone. It is solved for values SOLVED, and the logarithm of the
fluence is interpolated between them in the logarithm of the extinction: by a cubic spline at values REDUCED, and
linearly from there.
"""

import numba
import numpy as np
from scipy.interpolate import CubicSpline

from inference.diffusion import CELLS, LEAST, MOST_ITERATIONS, TOLERANCE, diffusion_equation, probe_points
from inference.transmittance import sun_optical_depth

SOLVED = np.geomspace(0.04, 2700.0, 17)
REDUCED = np.geomspace(0.04, 2700.0, 33)


@numba.njit(cache=True, fastmath=True)
def _conjugate_gradients(diagonal, cx, cy, cz, source, tolerance, limit):
    """Arrays with a layer of zeros around the cells, so that no cell asks whether it lies at a face."""
    n = source.shape[0] - 2
    x = np.zeros_like(source)
    r = source.copy()
    p = np.zeros_like(source)
    ap = np.zeros_like(source)
    inverse = np.zeros_like(source)
    rz = np.float32(0.0)
    for i in range(1, n + 1):
        for j in range(1, n + 1):
            for k in range(1, n + 1):
                inverse[i, j, k] = np.float32(1.0) / diagonal[i, j, k]
                p[i, j, k] = r[i, j, k] * inverse[i, j, k]
                rz += r[i, j, k] * p[i, j, k]
    enough = rz * tolerance * tolerance
    for _ in range(limit):
        if rz <= enough:
            break
        pap = np.float32(0.0)
        for i in range(1, n + 1):
            for j in range(1, n + 1):
                for k in range(1, n + 1):
                    v = (
                        diagonal[i, j, k] * p[i, j, k]
                        - cx[i, j, k] * p[i + 1, j, k] - cx[i - 1, j, k] * p[i - 1, j, k]
                        - cy[i, j, k] * p[i, j + 1, k] - cy[i, j - 1, k] * p[i, j - 1, k]
                        - cz[i, j, k] * p[i, j, k + 1] - cz[i, j, k - 1] * p[i, j, k - 1]
                    )
                    ap[i, j, k] = v
                    pap += v * p[i, j, k]
        step = rz / pap
        before, rz = rz, np.float32(0.0)
        for i in range(1, n + 1):
            for j in range(1, n + 1):
                for k in range(1, n + 1):
                    x[i, j, k] += step * p[i, j, k]
                    r[i, j, k] -= step * ap[i, j, k]
                    rz += r[i, j, k] * r[i, j, k] * inverse[i, j, k]
        ratio = rz / before
        for i in range(1, n + 1):
            for j in range(1, n + 1):
                for k in range(1, n + 1):
                    p[i, j, k] = r[i, j, k] * inverse[i, j, k] + ratio * p[i, j, k]
    return x


def solve(diagonal, couplings, source):
    """inference.diffusion.solve, compiled and in single precision."""
    padded = [np.pad(a, 1).astype(np.float32) for a in (diagonal, *couplings, source)]
    x = _conjugate_gradients(*padded, np.float32(TOLERANCE), MOST_ITERATIONS)
    return np.maximum(x[1:-1, 1:-1, 1:-1], 0.0)


@numba.njit(cache=True, fastmath=True)
def read_log(fields, place, x, y, z):
    """Trilinear at continuous indices, and linear in `place`, between fields (R, n, n, n)."""
    f = min(int(place), fields.shape[0] - 2)
    i, j, k = int(x), int(y), int(z)
    t, u, v, w = place - f, x - i, y - j, z - k
    total = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = (u if a else 1.0 - u) * (v if b else 1.0 - v) * (w if c else 1.0 - w)
                near, far = fields[f, i + a, j + b, k + c], fields[f + 1, i + a, j + b, k + c]
                total += weight * ((1.0 - t) * near + t * far)
    return total


@numba.njit(cache=True, fastmath=True)
def _read(fields, index, place):
    count, probes = index.shape[0], index.shape[1]
    out = np.empty((count, probes), np.float32)
    for p in range(count):
        for q in range(probes):
            out[p, q] = read_log(fields, place[p], index[p, q, 0], index[p, q, 1], index[p, q, 2])
    return out


def log_fluences(density, suns):
    """The logarithm of the fluence for each sun and each of REDUCED: float32 (S, 33, 34, 34, 34).

    density: (32, 32, 32), level 3 of the pyramid; suns: (S, 3) in the cube's frame.
    """
    fields = []
    for sun in suns:
        tau = sun_optical_depth(density, sun, 1.0 / CELLS).astype(np.float64)
        logs = [np.log(solve(*diffusion_equation(density, tau, s)) + LEAST) for s in SOLVED]
        between = CubicSpline(np.log(SOLVED), logs)(np.log(REDUCED)).astype(np.float32)
        fields.append(np.pad(between, ((0, 0), (1, 1), (1, 1), (1, 1)), mode="edge"))
    return np.array(fields)


def place_in_reduced(reduced):
    """Where values lie between REDUCED, as continuous indices."""
    return np.interp(np.log(reduced), np.log(REDUCED), np.arange(len(REDUCED)))


def describe_diffusion(fields, positions, omega, sun, reduced):
    """The logarithms of one sun's fluence at points' probes, float32 (N, 4), as inference.diffusion reads them.

    fields: of the sun, from `log_fluences`; positions, omega: (N, 3) in the cube's frame; sun: (3,);
    reduced: (N,) sigma_hat (1 - G) of each point.
    """
    return _read(fields, probe_points(positions, omega, sun), place_in_reduced(reduced))
