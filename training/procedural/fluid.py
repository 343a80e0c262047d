# SPDX-License-Identifier: GPL-3.0-or-later
"""A small smoke simulation, for volumes that look like simulated ones.

Stable fluids (Stam 1999) in a periodic box: semi-Lagrangian advection of velocity, pressure projected exactly in
Fourier space, buoyancy, turbulent forcing. Density is advected on a grid twice as fine by MacCormack's scheme (Selle
et al. 2008), which keeps edges sharp.
"""

import numba
import numpy as np
import scipy.fft


@numba.njit(cache=True, fastmath=True, inline="always")
def _neighbours(x, n):
    """Periodic indices of the lower and upper neighbours of x, in cells and |x| below a few n, and the fraction."""
    low = np.floor(x)
    i = int(low)
    while i < 0:
        i += n
    while i >= n:
        i -= n
    return i, (i + 1 if i + 1 < n else 0), np.float32(x - low)


@numba.njit(cache=True, fastmath=True)
def _advect(grid, velocity, ratio, dt, top):
    """`grid` (nx, ny, nz, channels) advected along `velocity` (..., 3), below layer `top`.

    A velocity cell is as wide as `ratio` cells of the grid; velocity is in its own cells per step.
    """
    nx, ny, nz, channels = grid.shape
    mx, my, mz, _ = velocity.shape
    out = np.zeros_like(grid)
    inverse, half, one = np.float32(1.0 / ratio), np.float32(0.5), np.float32(1.0)
    scale = np.float32(ratio * dt)
    highest, peak = np.float32(mz - 1.001), np.float32(nz - 1.001)
    for i in range(nx):
        i0, i1, u = _neighbours((i + half) * inverse - half, mx)
        for j in range(ny):
            j0, j1, v = _neighbours((j + half) * inverse - half, my)
            w00, w01, w10, w11 = (one - u) * (one - v), (one - u) * v, u * (one - v), u * v
            for k in range(min(nz, top)):
                z = min(max((k + half) * inverse - half, np.float32(0.0)), highest)
                k0 = int(z)
                w = np.float32(z - k0)
                move = (np.float32(0.0), np.float32(0.0), np.float32(0.0))
                for l, c in ((k0, one - w), (k0 + 1, w)):
                    a, b = velocity[i0, j0, l], velocity[i0, j1, l]
                    d, e = velocity[i1, j0, l], velocity[i1, j1, l]
                    move = (
                        move[0] + c * (w00 * a[0] + w01 * b[0] + w10 * d[0] + w11 * e[0]),
                        move[1] + c * (w00 * a[1] + w01 * b[1] + w10 * d[1] + w11 * e[1]),
                        move[2] + c * (w00 * a[2] + w01 * b[2] + w10 * d[2] + w11 * e[2]),
                    )
                p0, p1, p = _neighbours(np.float32(i) - move[0] * scale, nx)
                q0, q1, q = _neighbours(np.float32(j) - move[1] * scale, ny)
                z = min(max(np.float32(k) - move[2] * scale, np.float32(0.0)), peak)
                r0 = int(z)
                r = np.float32(z - r0)
                for ch in range(channels):
                    a = grid[p0, q0, r0, ch] * (one - r) + grid[p0, q0, r0 + 1, ch] * r
                    b = grid[p0, q1, r0, ch] * (one - r) + grid[p0, q1, r0 + 1, ch] * r
                    d = grid[p1, q0, r0, ch] * (one - r) + grid[p1, q0, r0 + 1, ch] * r
                    e = grid[p1, q1, r0, ch] * (one - r) + grid[p1, q1, r0 + 1, ch] * r
                    out[i, j, k, ch] = (a * (one - q) + b * q) * (one - p) + (d * (one - q) + e * q) * p
    return out


def _advect_sharp(grid, velocity, ratio, top):
    """MacCormack's scheme: forward, backward, and half the error corrected, without new values below 0."""
    grid = grid[..., None]
    forth = _advect(grid, velocity, ratio, 1.0, top)
    back = _advect(forth, velocity, ratio, -1.0, top)
    sharp = forth + np.float32(0.5) * (grid - back)
    # Where the correction overshoots, keep the first-order value.
    return np.where((sharp < 0) | (sharp > forth * 2 + 1e-3), forth, sharp)[..., 0]


def _project(velocity):
    """The divergence-free part of a periodic velocity field (3, nx, ny, nz)."""
    shape = velocity.shape[1:]
    k = np.meshgrid(*(scipy.fft.fftfreq(n) for n in shape[:2]), scipy.fft.rfftfreq(shape[2]), indexing="ij")
    k = np.stack(k).astype(np.float32)
    square = (k**2).sum(axis=0)
    square[0, 0, 0] = 1.0
    spectrum = scipy.fft.rfftn(velocity, axes=(1, 2, 3))
    spectrum -= k * ((k * spectrum).sum(axis=0) / square)
    return scipy.fft.irfftn(spectrum, s=shape, axes=(1, 2, 3)).astype(np.float32)


def simulate_smoke(rng, cells=32, steps=44):
    """Density float32 (2 cells, 2 cells, 4 cells) of a rising, turbulent smoke column.

    Axis 2 is up, the source lies near its lower end. `rng` draws the source's size
    and wobble, buoyancy, wind and turbulence. Values are unnormalised, >= 0.
    """
    shape = (cells, cells, 2 * cells)
    velocity = np.zeros((3, *shape), np.float32)
    density = np.zeros(tuple(2 * n for n in shape), np.float32)
    radius = rng.uniform(0.05, 0.16) * cells
    lift = rng.uniform(0.25, 0.6)
    wind = rng.uniform(0, 0.5) * rng.choice([0.0, 1.0])
    turbulence = rng.uniform(0.02, 0.12)
    puffing = rng.uniform(0.0, 1.0)
    stop = rng.choice([steps, int(steps * rng.uniform(0.3, 0.8))])
    heading = rng.uniform(0, 2 * np.pi)
    decay = rng.uniform(0.98, 1.0)
    grid = np.stack(np.meshgrid(*(np.arange(n, dtype=np.float32) for n in density.shape), indexing="ij")) / 2
    sponge = np.clip((shape[2] - np.arange(shape[2])) / (0.12 * shape[2]), 0, 1).astype(np.float32)
    phases = rng.uniform(0, 2 * np.pi, 4)
    sources = rng.integers(1, 4) if rng.random() < 0.3 else 1
    places = rng.uniform(-0.22, 0.22, (sources, 2)) * cells * (sources > 1)
    for step in range(steps):
        if step < stop:
            strength = 1 + puffing * np.sin(step * 0.9 + phases[3])
            for px, py in places:
                # A wandering disc with a lumpy rim, so that every simulation breaks its symmetry.
                cx = cells / 2 + px + 0.3 * radius * np.sin(step * 0.35 + phases[0])
                cy = cells / 2 + py + 0.3 * radius * np.cos(step * 0.27 + phases[1])
                part = grid[:, :, :, : max(6, int(0.14 * density.shape[2]))]
                distance = np.sqrt((part[0] - cx) ** 2 + (part[1] - cy) ** 2 + (part[2] - 0.06 * shape[2]) ** 2)
                lumps = 1 + 0.35 * np.sin(3 * np.arctan2(part[1] - cy, part[0] - cx) + phases[2] + 0.5 * step)
                source = np.clip(radius * lumps - distance + 0.5, 0, 1) * strength
                density[:, :, : part.shape[3]] += np.float32(0.35) * source.astype(np.float32)
        coarse = density.reshape(cells, 2, cells, 2, 2 * cells, 2).mean(axis=(1, 3, 5))
        velocity[2] += lift * np.minimum(coarse, 1.5)
        velocity[0] += wind * 0.1 * np.cos(heading) * np.linspace(0, 1, shape[2], dtype=np.float32)
        velocity[1] += wind * 0.1 * np.sin(heading) * np.linspace(0, 1, shape[2], dtype=np.float32)
        velocity += turbulence * rng.standard_normal(velocity.shape, dtype=np.float32) * (coarse > 0.005) * 4
        velocity = _project(velocity) * sponge
        # A limit for stability, not accuracy: at most four cells per step.
        velocity = np.clip(velocity, -4, 4)
        # Nothing moves faster than four coarse cells per step: skip the empty top.
        top = 2 * int(np.flatnonzero(coarse.max(axis=(0, 1)) > 1e-5)[-1] + 6)
        flow = np.ascontiguousarray(np.moveaxis(velocity, 0, -1))
        density = _advect_sharp(density, flow, 2.0, top) * np.float32(decay)
        velocity = np.ascontiguousarray(np.moveaxis(_advect(flow, flow, 1.0, 1.0, shape[2]), -1, 0))
    below_top = (density.shape[2] - np.arange(density.shape[2])) / (0.1 * density.shape[2])
    density *= np.clip(below_top, 0, 1).astype(np.float32)
    return np.maximum(density, 0).astype(np.float32)
