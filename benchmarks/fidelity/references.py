# SPDX-License-Identifier: GPL-3.0-or-later
"""Path-traced references in two independent halves, stored on disk, and what such a reference costs."""

import hashlib
import os
import pathlib
import time

import numpy as np

from inference import Medium
from training.tracer.density_grid import prepare
from training.tracer.path_tracer import PinholeCamera, Sampling, Scene, trace_pixels

#: Paths per pixel by which the tracer's time is measured.
TIMED_SAMPLES = 4


def _trace(view, grid, samples: int, seed: int) -> np.ndarray:
    spec = view.spec
    camera = PinholeCamera(view.position, (0.0, 0.0, 0.0), view.up, view.fov, spec.size)
    medium = Medium(spec.sigma_hat, spec.albedo, spec.anisotropy)
    return trace_pixels(Scene(grid, view.sun), camera, medium, Sampling(samples, seed))


def traced_halves(view, folder: pathlib.Path) -> np.ndarray:
    """float64 (2, H, W, 4): radiance and alpha of two independent halves of `view.spec.samples` paths per pixel.

    Read from `folder` where they were traced before.
    """
    return traced_parts(view, folder, 2)


def traced_parts(view, folder: pathlib.Path, parts: int) -> np.ndarray:
    """As `traced_halves`, of any number of independent parts."""
    density, spec = view.density(), view.spec
    facts = (spec.sigma_hat, spec.anisotropy, spec.albedo, view.sun.tolist(), view.position.tolist(), view.fov)
    digest = hashlib.sha256(density.tobytes() + repr(facts).encode()).hexdigest()[:12]
    path = folder / f"{view.name}-{spec.size}px-{spec.samples}spp-{digest}.npy"
    if parts != 2:
        path = path.with_stem(f"{path.stem}-{parts}")
    if not path.exists():
        grid = prepare(density)
        traced = np.stack([_trace(view, grid, spec.samples, seed) for seed in range(1, parts + 1)])
        folder.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        with open(partial, "wb") as file:
            np.save(file, traced)
        os.replace(partial, path)
    return np.load(path).astype(np.float64)


def seconds_per_sample(view) -> float:
    """What one path per pixel of the project's path tracer costs on this machine, on all cores."""
    grid = prepare(view.density())
    _trace(view, grid, 1, seed=3)  # compiles the tracer
    start = time.perf_counter()
    _trace(view, grid, TIMED_SAMPLES, seed=4)
    return (time.perf_counter() - start) / TIMED_SAMPLES


def relative_variance(a, b, mask, samples: int) -> float:
    """Variance of a pixel at one path, over the squared mean of the image inside the mask (H, W).

    a, b: (H, W, C), two independent images of `samples` paths per pixel.
    """
    return 0.5 * np.mean((a - b)[mask] ** 2) * samples / (0.5 * np.mean((a + b)[mask])) ** 2
