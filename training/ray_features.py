"""The light along the camera ray, for training data.

The same as inference.ray_light, computed the other way round: instead of marching each camera ray once
for all of its points, each point of the data marches its own.
"""

import numba
import numpy as np

from inference.ray_light import DIFFUSED_SCALES, SCALES
from training.diffusion import read_log
from training.transport import F0, F1, HALF, interpolate, prepare

#: Of steps along the ray, in cells.
STEP = np.float32(0.5)
#: Optical depth beyond which light from ahead does not count.
FAR = np.float32(40.0)


@numba.njit(cache=True, fastmath=True)
def _sun_depth(x, y, z, depth, s):
    """Trilinear optical depth towards sun s at a position in cells, clamped at the rim."""
    last = np.float32(depth.shape[1] - 1.001)
    x, y, z = min(max(x - HALF, F0), last), min(max(y - HALF, F0), last), min(max(z - HALF, F0), last)
    i, j, k = int(x), int(y), int(z)
    u, v, w = x - np.float32(i), y - np.float32(j), z - np.float32(k)
    a = depth[s, i, j, k] + w * (depth[s, i, j, k + 1] - depth[s, i, j, k])
    b = depth[s, i, j + 1, k] + w * (depth[s, i, j + 1, k + 1] - depth[s, i, j + 1, k])
    c = depth[s, i + 1, j, k] + w * (depth[s, i + 1, j, k + 1] - depth[s, i + 1, j, k])
    d = depth[s, i + 1, j + 1, k] + w * (depth[s, i + 1, j + 1, k + 1] - depth[s, i + 1, j + 1, k])
    a += v * (b - a)
    c += v * (d - c)
    return a + u * (c - a)


@numba.njit(cache=True, fastmath=True, parallel=True)
def _march(padded, depth, positions, directions, sigma, scales, fields, place, to_fields, diffused_scales):
    """sigma: per cube edge; positions: in cells; to_fields: (3, 4) of the fields' indices from cells."""
    n = np.float32(padded.shape[0] - 2)
    count, suns = positions.shape[0], depth.shape[0]
    tau_sun = np.zeros((count, suns), np.float32)
    tau_ahead = np.zeros(count, np.float32)
    ahead = np.zeros((count, suns, len(scales)), np.float32)
    diffused = np.zeros((count, suns, len(diffused_scales)), np.float32)
    last = np.float32(fields.shape[2] - 1.001)
    for p in numba.prange(count):
        x, y, z = positions[p, 0], positions[p, 1], positions[p, 2]
        for s in range(suns):
            tau_sun[p, s] = sigma[p] * _sun_depth(x, y, z, depth, s)
        t = HALF * STEP
        while True:
            px, py, pz = x + t * directions[p, 0], y + t * directions[p, 1], z + t * directions[p, 2]
            if px < F0 or py < F0 or pz < F0 or px > n or py > n or pz > n:
                break
            d = interpolate(px, py, pz, padded) * STEP * sigma[p] / n
            if d > F0 and tau_ahead[p] < FAR:
                m = to_fields
                fx = min(max(m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + m[0, 3], F0), last)
                fy = min(max(m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + m[1, 3], F0), last)
                fz = min(max(m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz + m[2, 3], F0), last)
                for s in range(suns):
                    fluence = np.exp(read_log(fields[s], place[p], fx, fy, fz))
                    for e in range(len(diffused_scales)):
                        a = diffused_scales[e]
                        diffused[p, s, e] += fluence * (F1 - np.exp(-a * d)) * np.exp(-a * tau_ahead[p])
                    tau = tau_ahead[p] + sigma[p] * _sun_depth(px, py, pz, depth, s)
                    for j in range(len(scales)):
                        a = scales[j]
                        ahead[p, s, j] += (F1 - np.exp(-a * d)) * np.exp(-a * tau)
            tau_ahead[p] += d
            t += STEP
    return tau_sun, tau_ahead, ahead, diffused


def describe_rays(density, sun_tau, positions, omega, sigma, fields, place, to_fields):
    """Optical depths and light along each point's ray, as in inference.ray_light.RayLight.

    density: (N, N, N) or what `transport.prepare` made of it; sun_tau: (S, N, N, N) for sigma 1; positions:
    (P, 3), cube units; omega: (P, 3) unit vectors; sigma: (P,) per cube edge. fields: of `diffusion.log_fluences`;
    place: (P,) between REDUCED; to_fields: (3, 4), the fields' indices from cells. Returns float32: the optical
    depth to each sun (P, S), that ahead (P,), and the light ahead (P, S, 3) at inference's SCALES and the diffused
    light ahead (P, S, 2) at its DIFFUSED_SCALES.
    """
    grid = prepare(density)
    cells = np.float32(grid.cells)
    return _march(
        grid.padded, np.ascontiguousarray(sun_tau, np.float32), ((positions + 0.5) * cells).astype(np.float32),
        np.ascontiguousarray(omega, np.float32), np.ascontiguousarray(sigma, np.float32),
        np.array(SCALES, np.float32), fields, place.astype(np.float32), to_fields.astype(np.float32),
        np.array(DIFFUSED_SCALES, np.float32),
    )
