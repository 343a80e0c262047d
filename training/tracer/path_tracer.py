"""Unbiased volumetric path tracing in the working cube (METHOD: delta tracking, next-event estimation).

All positions are in cube units, [-1/2, 1/2]^3; density is trilinear between cell centres
and 0 outside the cube; sigma is the optical density per cube edge where density is 1.
The sun's irradiance is 1. The phase function is Henyey-Greenstein and carries 1/(4 pi).
Results depend on the arguments alone, not on the number of threads; another compilation of the same
code may round the last bits differently.
"""

import numba
import numpy as np

from .transport import (
    F0, F1, F2, HALF, draw, fly, interpolate, jitter, phase_hg, prepare, scatter, seed_state, transmit, two_uniforms,
)

#: Collisions after which a path is dropped. In a solid block of optical depth 1000 and albedo 1
#: a limit of 4096 loses up to 5 % of the light, this one nothing that shows, for a fifth more time.
MAX_COLLISIONS = 65536
#: Rays tried for one scattering point before it is given up.
MAX_TRIES = 2000

#: Optical depth a cell above which a field of that grid's resolution is too coarse.
FIELD_LIMIT = np.float32(5.0)

_ROULETTE = np.float32(0.05)
_NEGLIGIBLE = np.float32(1e-12)
_OPAQUE = np.float32(30.0)


@numba.njit(cache=True, fastmath=True)
def _sun_light(x, y, z, dx, dy, dz, g, sigma, suns, depth, padded, majorant, light, state):
    """Fill light[s] with transmittance(x -> sun s) times the phase function towards it."""
    count = suns.shape[0]
    if depth.shape[0] == 0 or sigma > FIELD_LIMIT:
        for s in range(count):
            through, state = transmit(x, y, z, suns[s, 0], suns[s, 1], suns[s, 2], sigma, padded, majorant, state)
            cosine = dx * suns[s, 0] + dy * suns[s, 1] + dz * suns[s, 2]
            light[s] = through * phase_hg(cosine, g)
        return state
    # The suns' optical depths at one of the eight cells around, chosen with its trilinear
    # weight: on average the transmittance is interpolated, which where shadows have sharp
    # edges is much closer than exp(-interpolated depth), always too dark (exp is convex).
    cells = padded.shape[0] - 2
    m = depth.shape[0]
    scale = np.float32(m) / np.float32(cells)
    state, i, j, k = jitter(scale, x, y, z, state)
    i, j, k = min(max(i - 1, 0), m - 1), min(max(j - 1, 0), m - 1), min(max(k - 1, 0), m - 1)
    # from that cell's centre to here, in cells
    sx = x - (np.float32(i) + HALF) / scale
    sy = y - (np.float32(j) + HALF) / scale
    sz = z - (np.float32(k) + HALF) / scale
    between = interpolate(x - HALF * sx, y - HALF * sy, z - HALF * sz, padded)
    # depth is for sigma 1 per cube edge; sigma here is per cell
    sigma_cube = sigma * np.float32(cells)
    for s in range(count):
        # along the sun's direction the depth's derivative is the density itself
        nearer = sx * suns[s, 0] + sy * suns[s, 1] + sz * suns[s, 2]
        tau = max(sigma_cube * depth[i, j, k, s] - sigma * between * nearer, F0)
        if tau < _OPAQUE:
            cosine = dx * suns[s, 0] + dy * suns[s, 1] + dz * suns[s, 2]
            light[s] = np.exp(-tau) * phase_hg(cosine, g)
        else:
            light[s] = F0
    return state


@numba.njit(cache=True, fastmath=True)
def _walk(x, y, z, dx, dy, dz, g, sigma, suns, depth, padded, majorant, albedos, power, light, total, limit, state):
    """Follow a path that has just left a vertex; add power * light of every later one to total (S, A)."""
    for _ in range(limit):
        hit, x, y, z, state = fly(x, y, z, dx, dy, dz, sigma, padded, majorant, state)
        if not hit:
            break
        largest = F0
        for a in range(albedos.shape[0]):
            power[a] *= albedos[a]
            if power[a] < _NEGLIGIBLE:
                power[a] = F0
            largest = max(largest, power[a])
        if largest < _ROULETTE:
            state, bits = draw(state)
            u, _ = two_uniforms(bits)
            if u > HALF or largest == F0:
                break
            for a in range(albedos.shape[0]):
                power[a] *= F2
        state = _sun_light(x, y, z, dx, dy, dz, g, sigma, suns, depth, padded, majorant, light, state)
        for s in range(suns.shape[0]):
            if light[s] > F0:
                for a in range(albedos.shape[0]):
                    total[s, a] += power[a] * light[s]
        dx, dy, dz, state = scatter(dx, dy, dz, g, state)
    return state


@numba.njit(cache=True, fastmath=True, parallel=True)
def _points_kernel(padded, majorant, suns, depth, positions, directions, sigma, g, albedos, paths, limit, seed):
    count, lights, powers = positions.shape[0], suns.shape[0], albedos.shape[1]
    out = np.zeros((count, lights, powers), np.float32)
    for p in numba.prange(count):
        state = seed_state(seed, p)
        power = np.empty(powers, np.float32)
        light = np.empty(lights, np.float32)
        total = np.empty((lights, powers), np.float32)
        if sigma[p] > F0:
            for _ in range(paths):
                total[:] = F0
                power[:] = F1
                dx, dy, dz, state = scatter(directions[p, 0], directions[p, 1], directions[p, 2], g[p], state)
                state = _walk(
                    positions[p, 0], positions[p, 1], positions[p, 2], dx, dy, dz, g[p], sigma[p], suns, depth,
                    padded, majorant, albedos[p], power, light, total, limit, state,
                )
                out[p] += total
        out[p] /= np.float32(paths)
    return out


@numba.njit(cache=True, fastmath=True)
def _enter(x, y, z, dx, dy, dz, cells):
    """Where a line from outside enters [0, cells]^3: (meets it, x, y, z)."""
    near, far = 0.0, 1e30
    for p, d in ((x, dx), (y, dy), (z, dz)):
        if abs(d) < 1e-12:
            if p < 0.0 or p > cells:
                return False, F0, F0, F0
        else:
            a, b = -p / d, (cells - p) / d
            near, far = max(near, min(a, b)), min(far, max(a, b))
    if near >= far:
        return False, F0, F0, F0
    top = np.float32(cells)
    return (
        True,
        min(max(np.float32(x + near * dx), F0), top),
        min(max(np.float32(y + near * dy), F0), top),
        min(max(np.float32(z + near * dz), F0), top),
    )


@numba.njit(cache=True, fastmath=True, parallel=True)
def _scattering_kernel(padded, majorant, sigma, directions, tries, seed):
    cells = padded.shape[0] - 2
    count = sigma.shape[0]
    places = np.zeros((count, 3), np.float32)
    valid = np.zeros(count, np.bool_)
    for p in numba.prange(count):
        state = seed_state(seed, p)
        dx, dy, dz = directions[p, 0], directions[p, 1], directions[p, 2]
        # a frame around the direction (Duff et al. 2017)
        sign = F1 if dz >= F0 else -F1
        q = -F1 / (sign + dz)
        r = dx * dy * q
        radius = np.float32(0.8661) * np.float32(cells)
        for _ in range(tries):
            if sigma[p] <= F0:
                break
            # uniform over the disc that holds the cube's shadow
            state, bits = draw(state)
            a, b = two_uniforms(bits)
            a, b = (F2 * a - F1) * radius, (F2 * b - F1) * radius
            centre = HALF * np.float32(cells)
            x = centre + a * (F1 + sign * dx * dx * q) + b * r - F2 * radius * dx
            y = centre + a * sign * r + b * (sign + dy * dy * q) - F2 * radius * dy
            z = centre - a * sign * dx - b * dy - F2 * radius * dz
            meets, x, y, z = _enter(x, y, z, dx, dy, dz, cells)
            if meets:
                hit, x, y, z, state = fly(x, y, z, dx, dy, dz, sigma[p], padded, majorant, state)
                if hit:
                    places[p, 0], places[p, 1], places[p, 2] = x, y, z
                    valid[p] = True
                    break
    return places, valid


@numba.njit(cache=True, fastmath=True, parallel=True)
def _pixels_kernel(padded, majorant, suns, camera, rays, sigma, g, albedo, spp, limit, seed):
    cells = padded.shape[0] - 2
    depth = np.empty((0, 0, 0, 0), np.float32)
    image = np.zeros((rays.shape[0], 4), np.float32)
    for p in numba.prange(rays.shape[0]):
        state = seed_state(seed, p)
        dx, dy, dz = rays[p, 0], rays[p, 1], rays[p, 2]
        meets, x, y, z = _enter(camera[0], camera[1], camera[2], rays[p, 0], rays[p, 1], rays[p, 2], cells)
        if meets and sigma > F0:
            power = np.empty(3, np.float32)
            light = np.empty(1, np.float32)
            total = np.empty((1, 3), np.float32)
            for _ in range(spp):
                hit, px, py, pz, state = fly(x, y, z, dx, dy, dz, sigma, padded, majorant, state)
                if hit:
                    # single scattering at the first vertex, then the walk
                    state = _sun_light(px, py, pz, dx, dy, dz, g, sigma, suns, depth, padded, majorant, light, state)
                    power[:] = albedo
                    total[0] = albedo * light[0]
                    wx, wy, wz, state = scatter(dx, dy, dz, g, state)
                    state = _walk(
                        px, py, pz, wx, wy, wz, g, sigma, suns, depth,
                        padded, majorant, albedo, power, light, total, limit, state,
                    )
                    image[p, :3] += total[0]
                    image[p, 3] += F1
            image[p] /= np.float32(spp)
    return image


def _per_point(values, count, name, width=None):
    values = np.asarray(values, np.float32)
    shape = (count,) if width is None else (count, width)
    try:
        values = np.broadcast_to(values, shape)
    except ValueError:
        raise ValueError(f"{name} must have shape {shape}, not {values.shape}") from None
    return np.ascontiguousarray(values)


def _directions(values, name):
    values = np.atleast_2d(np.asarray(values, np.float64))
    length = np.linalg.norm(values, axis=1, keepdims=True)
    if values.shape[1] != 3 or not np.all(length > 0):
        raise ValueError(f"{name} must be vectors of three numbers, none of them zero")
    return np.ascontiguousarray(values / length, dtype=np.float32)


def trace_points(
    density, suns, sun_tau, positions, directions, sigma, anisotropy, albedos, paths: int, seed: int,
    max_collisions: int = MAX_COLLISIONS,
) -> np.ndarray:
    """Multiple scattering at points: mean over `paths` paths, E = 1, per sun and albedo.

    density: (N, N, N) or what `transport.prepare` made of it (prepare once for many calls).
    suns: (S, 3) unit vectors towards the suns. sun_tau: optical depth towards each sun for
    sigma 1, (S, M, M, M), cell-centred on the cube; None for unbiased ratio tracking,
    several times slower. The field's own resolution is its only error: under 1 % of the mean
    up to an optical depth of 1 a density cell, 1 to 3 % at 2.5; above FIELD_LIMIT it is not used.
    positions: (P, 3) in the cube; directions: (P, 3) of the camera ray, away from the camera.
    sigma, anisotropy: (P,) or scalar; albedos: (P, A) or (A,).

    Returns float32 (P, S, A): light scattered at least once before it reaches the point,
    then towards the camera; without the point's own albedo. Raises ValueError on shapes
    that do not fit or points outside the cube.
    """
    grid = prepare(density)
    suns = _directions(suns, "suns")
    positions = np.ascontiguousarray(positions, dtype=np.float32).reshape(-1, 3)
    count = len(positions)
    if count and np.abs(positions).max() > 0.5:
        raise ValueError("positions must lie in the cube [-0.5, 0.5]^3")
    directions = _directions(directions, "directions")
    if len(directions) != count:
        raise ValueError(f"{count} positions but {len(directions)} directions")
    albedos = np.atleast_1d(np.asarray(albedos, np.float32))
    if sun_tau is None:
        depth = np.empty((0, 0, 0, 0), np.float32)
    else:
        depth = np.ascontiguousarray(np.moveaxis(np.asarray(sun_tau, np.float32), 0, -1))
        if depth.ndim != 4 or depth.shape[3] != len(suns) or len(set(depth.shape[:3])) != 1 or depth.shape[0] < 1:
            raise ValueError(f"sun_tau must be ({len(suns)}, M, M, M)")
    return _points_kernel(
        grid.padded, grid.majorant, suns, depth, (positions + np.float32(0.5)) * np.float32(grid.cells), directions,
        _per_point(sigma, count, "sigma") / np.float32(grid.cells), _per_point(anisotropy, count, "anisotropy"),
        _per_point(albedos, count, "albedos", albedos.shape[-1]), int(paths), int(max_collisions), int(seed),
    )


def sample_scattering_points(density, sigma, directions, seed: int, tries: int = MAX_TRIES):
    """Where camera rays of given directions scatter first.

    Each ray crosses the cube at a random place, uniform over the plane perpendicular to its
    direction; a ray that does not scatter is replaced, `tries` times at most.
    sigma: (P,) or scalar; directions: (P, 3). Returns positions float32 (P, 3), cube units,
    and valid bool (P,): False where no ray scattered.
    """
    grid = prepare(density)
    directions = _directions(directions, "directions")
    sigma = _per_point(sigma, len(directions), "sigma") / np.float32(grid.cells)
    places, valid = _scattering_kernel(grid.padded, grid.majorant, sigma, directions, int(tries), int(seed))
    places = places / np.float32(grid.cells) - np.float32(0.5)
    return np.clip(places, -0.5, 0.5), valid


def camera_rays(position, look_at, up, fov_deg: float, resolution: int) -> np.ndarray:
    """Unit directions float32 (H, W, 3) through the pixel centres of a square perspective image.

    Rows from the top, columns along right = forward x up; fov across the image.
    """
    forward = np.asarray(look_at, np.float64) - np.asarray(position, np.float64)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, np.float64))
    right /= np.linalg.norm(right)
    above = np.cross(right, forward)
    axis = ((np.arange(resolution) + 0.5) / resolution * 2 - 1) * np.tan(np.radians(fov_deg) / 2)
    rays = forward + axis[None, :, None] * right - axis[:, None, None] * above
    return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype(np.float32)


def trace_pixels(
    density, camera_position, look_at, up, fov_deg: float, resolution: int, sun, sigma: float, anisotropy: float,
    albedo, spp: int, seed: int, max_collisions: int = MAX_COLLISIONS,
) -> np.ndarray:
    """A reference image with every order of scattering, a sun of irradiance 1, no background.

    camera_position, look_at: cube units; sun: (3,) towards it; albedo: (3,) or scalar.
    Returns float32 (H, W, 4): RGB radiance of `spp` paths a pixel, and alpha, the share of
    them that scattered.
    """
    grid = prepare(density)
    rays = camera_rays(camera_position, look_at, up, fov_deg, resolution)
    camera = (np.asarray(camera_position, np.float64) + 0.5) * grid.cells
    image = _pixels_kernel(
        grid.padded, grid.majorant, _directions(sun, "sun"), camera, rays.reshape(-1, 3),
        np.float32(sigma / grid.cells), np.float32(anisotropy),
        np.ascontiguousarray(np.broadcast_to(np.asarray(albedo, np.float32), (3,))),
        int(spp), int(max_collisions), int(seed),
    )
    return image.reshape(resolution, resolution, 4)
