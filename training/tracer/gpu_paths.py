# SPDX-License-Identifier: GPL-3.0-or-later
"""The paths of `light_paths` on a GPU (numba's CUDA target), compiled from the same functions.

Radiance has the distribution of the CPU's, from other random numbers. Needs numba-cuda and an NVIDIA GPU; nothing in
this project needs this module.
"""

import functools
from collections.abc import Sequence

import numba
import numpy as np
from numba import cuda

from .henyey_greenstein import scatter
from .light_paths import Paths, _Path, _walk
from .random_numbers import seed_state
from .scene import Sampling
from .tracking import Glow, Ray

#: Threads of a block: few, since paths end at very different times.
BLOCK_THREADS = 64
#: Most threads of a launch.
MOST_THREADS = 1 << 18

_F0, _F1 = np.float32(0.0), np.float32(1.0)


def available() -> bool:
    """Whether there is a GPU that numba can use."""
    return bool(cuda.is_available())


@functools.cache
def _kernel(lights: int, channels: int, unscattered: int, emissions: int):
    """Kernel for numbers of lights: fill the sums of paths, radiance (P, T, K, C) and once (P, T, W + E).

    Each of T threads of a vertex follows every T-th of its paths.
    """

    @cuda.jit(fastmath=True)
    def trace(media, illumination, positions, directions, sampling, radiance, once):
        number = cuda.grid(1)
        threads = radiance.shape[1]
        if number >= radiance.shape[0] * threads:
            return
        p, first = number // threads, number % threads
        throughput = cuda.local.array(channels, numba.float32)
        albedo = cuda.local.array(channels, numba.float32)
        light = cuda.local.array((lights, channels), numba.float32)
        early = cuda.local.array(unscattered, numba.float32)
        gathered = cuda.local.array(emissions, numba.float32)
        for k in range(lights):
            for c in range(channels):
                light[k, c] = _F0
        for k in range(unscattered):
            early[k] = _F0
        path = _Path(throughput, albedo, light, early, Glow(illumination.emission, gathered))
        state = seed_state(sampling.seed, number)
        x, y, z = positions[p, 0], positions[p, 1], positions[p, 2]
        for _ in range(first, sampling.paths, threads):
            for c in range(channels):
                throughput[c] = _F1
            dx, dy, dz, state = scatter(directions[p, 0], directions[p, 1], directions[p, 2], media.shadow.g, state)
            state = _walk(Ray(x, y, z, dx, dy, dz), media, illumination, path, sampling.max_collisions, state)
        for k in range(lights):
            for c in range(channels):
                radiance[p, first, k, c] = light[k, c]
        for k in range(unscattered):
            once[p, first, k] = early[k]

    return trace


@cuda.jit
def _mean(parts, count, means):
    """Fill means (P, V) with the sums of parts (P, T, V) over T, divided by count; always in the same order."""
    number = cuda.grid(1)
    values = means.shape[1]
    if number < means.shape[0] * values:
        p, v = number // values, number % values
        total = 0.0
        for t in range(parts.shape[1]):
            total += parts[p, t, v]
        means[p, v] = total / count


def trace_on_gpu(jobs: Sequence[tuple[Paths, Sampling]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Radiance and what is scattered once, as of `light_paths.trace_paths`, of all jobs side by side.

    Many jobs fill a GPU better than few, since some paths are long. Arrays that jobs share are copied once. The same
    jobs give the same results.

    Raises ValueError where there is no environment or no emission, of which the kernel needs one each.
    """
    copies: dict[int, object] = {}

    def on_device(value):
        if isinstance(value, np.ndarray):
            if id(value) not in copies:
                copies[id(value)] = cuda.to_device(value)
            return copies[id(value)]
        if isinstance(value, tuple):
            return type(value)(*map(on_device, value))
        return value

    started = []
    for paths, sampling in jobs:
        count, channels, emissions = len(paths.positions), len(paths.media.albedo.low), paths.lights.emission.shape[3]
        if not emissions or not len(paths.lights.environments):
            raise ValueError("paths on a GPU need an environment and an emission, which may be dark")
        if not count:
            started.append((paths, None, None))
            continue
        threads = max(min(int(sampling.paths), MOST_THREADS // count), 1)
        stream, kernel = cuda.stream(), _kernel(paths.count, channels, paths.unscattered, emissions)
        radiance = cuda.device_array((count, threads, paths.count, channels), np.float32)
        once = cuda.device_array((count, threads, paths.unscattered), np.float32)
        blocks = -(-count * threads // BLOCK_THREADS)
        arguments = *map(on_device, paths), Sampling(*map(int, sampling)), radiance, once
        kernel[blocks, BLOCK_THREADS, stream](*arguments)
        means = []
        for parts, values in ((radiance, paths.count * channels), (once, paths.unscattered)):
            mean = cuda.device_array((count, values), np.float32)
            grid = -(-count * values // BLOCK_THREADS)
            _mean[grid, BLOCK_THREADS, stream](parts.reshape(count, threads, values), np.float32(sampling.paths), mean)
            means.append(mean)
        started.append((paths, stream, means))
    found = []
    for paths, stream, means in started:
        shape = len(paths.positions), paths.count, len(paths.media.albedo.low)
        if means is None:
            found.append((np.empty(shape, np.float32), np.empty((0, paths.unscattered), np.float32)))
            continue
        stream.synchronize()
        radiance, once = (mean.copy_to_host() for mean in means)
        found.append((radiance.reshape(shape), once))
    return found
