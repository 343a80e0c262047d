"""What a photon does: random numbers, Henyey-Greenstein scattering, free flights.

Everything is float32 and runs inside numba. Positions are in cells: [0, N]^3 is the
cube, cell (i, j, k) has its centre at (i, j, k) + 0.5. Extinction is `sigma` times
density, per cell. A 64-bit counter with splitmix64's mixing (Steele et al. 2014) is the
random number generator; its state is handed from call to call, so that a path depends on
nothing but where its state began.
"""

from dataclasses import dataclass

import numba
import numpy as np

F0, F1, F2, HALF = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)
TINY, HUGE = np.float32(1e-9), np.float32(1e9)
INV_4PI = np.float32(0.25 / np.pi)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1, _MIX2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_U27, _U30, _U31 = np.uint64(27), np.uint64(30), np.uint64(31)
_U40, _U43, _U22, _U21 = np.uint64(40), np.uint64(43), np.uint64(22), np.uint64(21)
_MASK24, _MASK21 = np.uint64(0xFFFFFF), np.uint64(0x1FFFFF)
_TO24, _TO21 = np.float32(2.0**-24), np.float32(2.0**-21)

#: Edge of a block of the majorant grid, in cells.
BLOCK = 8


@dataclass
class DensityGrid:
    """A density made ready for tracking.

    padded: float32 (N + 2, N + 2, N + 2), a layer of zeros around the cells.
    majorant: float32 (B, B, B), bound of the trilinear density in blocks of BLOCK cells.
    cells: N.
    """

    padded: np.ndarray
    majorant: np.ndarray
    cells: int


def prepare(density) -> DensityGrid:
    """Pad a cubic density (N, N, N) and bound it by blocks; a DensityGrid passes through.

    Raises ValueError where the grid is not cubic, not finite or negative.
    """
    if isinstance(density, DensityGrid):
        return density
    density = np.asarray(density, np.float32)
    if density.ndim != 3 or len(set(density.shape)) != 1:
        raise ValueError(f"density must be a cube of cells, not {density.shape}")
    if not (np.isfinite(density.min()) and np.isfinite(density.max())) or density.min() < 0:
        raise ValueError("density must be finite and not negative")
    cells = density.shape[0]
    padded = np.pad(density, 1)
    blocks = -(-cells // BLOCK)
    # interpolation in block b reads padded cells b * BLOCK to b * BLOCK + BLOCK + 1, both included
    bound = padded
    for axis in range(3):
        bound = np.moveaxis(bound, axis, 0)
        slabs = [bound[b * BLOCK : b * BLOCK + BLOCK + 2].max(axis=0) for b in range(blocks)]
        bound = np.moveaxis(np.stack(slabs), 0, axis)
    # rounding must never lift the interpolated density above its bound
    majorant = np.ascontiguousarray(bound * np.float32(1 + 1e-6))
    return DensityGrid(padded, majorant, cells)


@numba.njit(cache=True, fastmath=True)
def seed_state(seed, index):
    """The generator's first state for item `index` of a run with `seed`."""
    z = np.uint64(seed) * _MIX1 + np.uint64(index) * _MIX2 + _GOLDEN
    z = (z ^ (z >> _U30)) * _MIX1
    z = (z ^ (z >> _U27)) * _MIX2
    return z ^ (z >> _U31)


@numba.njit(cache=True, fastmath=True)
def draw(state):
    """The next state and 64 random bits."""
    state = state + _GOLDEN
    z = (state ^ (state >> _U30)) * _MIX1
    z = (z ^ (z >> _U27)) * _MIX2
    return state, z ^ (z >> _U31)


@numba.njit(cache=True, fastmath=True)
def two_uniforms(bits):
    """Two independent numbers in (0, 1) from 64 random bits."""
    a = (np.float32(np.int32(bits >> _U40)) + HALF) * _TO24
    b = (np.float32(np.int32(bits & _MASK24)) + HALF) * _TO24
    return a, b


@numba.njit(cache=True, fastmath=True)
def phase_hg(cosine, g):
    """Henyey-Greenstein phase function, 1/sr."""
    d = F1 + g * g - F2 * g * cosine
    return INV_4PI * (F1 - g * g) / (d * np.sqrt(d))


@numba.njit(cache=True, fastmath=True)
def scatter(dx, dy, dz, g, state):
    """A direction drawn from the phase function around (dx, dy, dz), and the next state."""
    state, bits = draw(state)
    u, _ = two_uniforms(bits)
    if abs(g) < np.float32(1e-3):
        cosine = F1 - F2 * u
    else:
        s = (F1 - g * g) / (F1 - g + F2 * g * u)
        cosine = (F1 + g * g - s * s) / (F2 * g)
    cosine = min(max(cosine, -F1), F1)
    sine = np.sqrt(F1 - cosine * cosine)
    # an azimuth without trigonometry: a random point of the disc, projected to its rim
    while True:
        state, bits = draw(state)
        a, b = two_uniforms(bits)
        a, b = F2 * a - F1, F2 * b - F1
        square = a * a + b * b
        if square <= F1 and square > TINY:
            break
    scale = sine / np.sqrt(square)
    a, b = a * scale, b * scale
    # a frame around the direction (Duff et al. 2017)
    sign = F1 if dz >= F0 else -F1
    p = -F1 / (sign + dz)
    q = dx * dy * p
    x = a * (F1 + sign * dx * dx * p) + b * q + cosine * dx
    y = a * sign * q + b * (sign + dy * dy * p) + cosine * dy
    z = -a * sign * dx - b * dy + cosine * dz
    length = F1 / np.sqrt(x * x + y * y + z * z)
    return x * length, y * length, z * length, state


@numba.njit(cache=True, fastmath=True)
def _inverse(d):
    """1 / d, finite for every d."""
    if abs(d) < TINY:
        return HUGE if d >= F0 else -HUGE
    return F1 / d


@numba.njit(cache=True, fastmath=True)
def jitter(scale, x, y, z, state):
    """One of the eight cells around a position, chosen with its trilinear weight.

    `scale` converts to the cells of the grid; its cell (i, j, k) is returned as
    (i + 1, j + 1, k + 1), as a grid with one layer of padding is indexed.
    Returns (state, i, j, k).
    """
    state, bits = draw(state)
    i = int(x * scale + HALF + np.float32(np.int32(bits >> _U43)) * _TO21)
    j = int(y * scale + HALF + np.float32(np.int32((bits >> _U22) & _MASK21)) * _TO21)
    k = int(z * scale + HALF + np.float32(np.int32(bits & _MASK21)) * _TO21)
    return state, i, j, k


@numba.njit(cache=True, fastmath=True)
def interpolate(x, y, z, padded):
    """Trilinear density at a position."""
    i, j, k = int(x + HALF), int(y + HALF), int(z + HALF)
    u, v, w = x + HALF - np.float32(i), y + HALF - np.float32(j), z + HALF - np.float32(k)
    a = padded[i, j, k] + w * (padded[i, j, k + 1] - padded[i, j, k])
    b = padded[i, j + 1, k] + w * (padded[i, j + 1, k + 1] - padded[i, j + 1, k])
    c = padded[i + 1, j, k] + w * (padded[i + 1, j, k + 1] - padded[i + 1, j, k])
    d = padded[i + 1, j + 1, k] + w * (padded[i + 1, j + 1, k + 1] - padded[i + 1, j + 1, k])
    a += v * (b - a)
    c += v * (d - c)
    return a + u * (c - a)


@numba.njit(cache=True, fastmath=True)
def _corner(x, y, z, padded, state):
    """Density at one of the eight cells around a position, chosen with its trilinear weight.

    Its mean is the trilinear density, and every use here is linear in the density: one
    read instead of eight, without bias.
    """
    state, i, j, k = jitter(F1, x, y, z, state)
    return padded[i, j, k], state


@numba.njit(cache=True, fastmath=True)
def _enter_blocks(x, y, z, dx, dy, dz, cells, blocks):
    """Block of a position, distances to its walls ahead and between walls, distance to the exit."""
    ix, iy, iz = _inverse(dx), _inverse(dy), _inverse(dz)
    edge = np.float32(BLOCK)
    i = min(max(int(x / edge), 0), blocks - 1)
    j = min(max(int(y / edge), 0), blocks - 1)
    k = min(max(int(z / edge), 0), blocks - 1)
    wx = (np.float32(i + (1 if dx >= F0 else 0)) * edge - x) * ix
    wy = (np.float32(j + (1 if dy >= F0 else 0)) * edge - y) * iy
    wz = (np.float32(k + (1 if dz >= F0 else 0)) * edge - z) * iz
    n = np.float32(cells)
    ex = ((n if dx >= F0 else F0) - x) * ix
    ey = ((n if dy >= F0 else F0) - y) * iy
    ez = ((n if dz >= F0 else F0) - z) * iz
    end = max(min(ex, min(ey, ez)), F0)
    return i, j, k, wx, wy, wz, edge * abs(ix), edge * abs(iy), edge * abs(iz), end


@numba.njit(cache=True, fastmath=True, inline="always")
def _next_block(wall, i, j, k, wx, wy, wz, sx, sy, sz, dx, dy, dz, blocks):
    """Step through the wall that was reached: (whether still in the grid, block, its next walls)."""
    if wall == wx:
        wx += sx
        i += 1 if dx >= F0 else -1
    elif wall == wy:
        wy += sy
        j += 1 if dy >= F0 else -1
    else:
        wz += sz
        k += 1 if dz >= F0 else -1
    inside = i >= 0 and i < blocks and j >= 0 and j < blocks and k >= 0 and k < blocks
    return inside, i, j, k, wx, wy, wz


@numba.njit(cache=True, fastmath=True)
def fly(x, y, z, dx, dy, dz, sigma, padded, majorant, state):
    """Delta tracking (Woodcock) to the next collision, with a majorant for each block.

    Starts inside the cube. Returns (collided, x, y, z, state).
    """
    cells = padded.shape[0] - 2
    blocks = majorant.shape[0]
    i, j, k, wx, wy, wz, sx, sy, sz, end = _enter_blocks(x, y, z, dx, dy, dz, cells, blocks)
    inverse_sigma = F1 / sigma
    state, bits = draw(state)
    u, v = two_uniforms(bits)
    need = -np.log(u) * inverse_sigma
    t = F0
    while True:
        bound = majorant[i, j, k]
        wall = min(min(wx, wy), min(wz, end))
        supply = (wall - t) * bound
        if need < supply:
            t += need / bound
            px, py, pz = x + dx * t, y + dy * t, z + dz * t
            here, state = _corner(px, py, pz, padded, state)
            if here > v * bound:
                return True, px, py, pz, state
            state, bits = draw(state)
            u, v = two_uniforms(bits)
            need = -np.log(u) * inverse_sigma
        else:
            need -= supply
            t = wall
            if wall >= end:
                return False, x, y, z, state
            inside, i, j, k, wx, wy, wz = _next_block(wall, i, j, k, wx, wy, wz, sx, sy, sz, dx, dy, dz, blocks)
            if not inside:
                return False, x, y, z, state


@numba.njit(cache=True, fastmath=True)
def transmit(x, y, z, dx, dy, dz, sigma, padded, majorant, state):
    """Unbiased transmittance from inside the cube out along a direction, by ratio tracking.

    Novak et al. 2014, with Russian roulette below 0.1. Returns (transmittance, state).
    """
    cells = padded.shape[0] - 2
    blocks = majorant.shape[0]
    i, j, k, wx, wy, wz, sx, sy, sz, end = _enter_blocks(x, y, z, dx, dy, dz, cells, blocks)
    inverse_sigma = F1 / sigma
    state, bits = draw(state)
    u, v = two_uniforms(bits)
    need = -np.log(u) * inverse_sigma
    t = F0
    through = F1
    while True:
        bound = majorant[i, j, k]
        wall = min(min(wx, wy), min(wz, end))
        supply = (wall - t) * bound
        if need < supply:
            t += need / bound
            here, state = _corner(x + dx * t, y + dy * t, z + dz * t, padded, state)
            through *= F1 - here / bound
            if through < np.float32(0.1):
                if v > HALF:
                    return F0, state
                through *= F2
            state, bits = draw(state)
            u, v = two_uniforms(bits)
            need = -np.log(u) * inverse_sigma
        else:
            need -= supply
            t = wall
            if wall >= end:
                return through, state
            inside, i, j, k, wx, wy, wz = _next_block(wall, i, j, k, wx, wy, wz, sx, sy, sz, dx, dy, dz, blocks)
            if not inside:
                return through, state
