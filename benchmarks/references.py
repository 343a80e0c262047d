"""Path-traced references in two independent halves, kept on disk, and what such a reference costs."""

import hashlib
import os
import pathlib
import time

import numpy as np

from inference import Medium
from training.tracer.density_grid import prepare
from training.tracer.path_tracer import PinholeCamera, Sampling, Scene, trace_pixels

#: Paths a pixel by which the tracer's time is measured.
TIMED_SAMPLES = 4


def _trace(view, grid, samples: int, seed: int) -> np.ndarray:
    camera = PinholeCamera(view.position, (0.0, 0.0, 0.0), view.up, view.fov, view.size)
    medium = Medium(view.sigma_hat, view.albedo, view.anisotropy)
    return trace_pixels(Scene(grid, view.sun), camera, medium, Sampling(samples, seed))


def traced_halves(view, folder: pathlib.Path) -> np.ndarray:
    """float64 (2, H, W, 4): `view.samples` paths a pixel each; read from `folder` where they were traced before."""
    density = view.density()
    facts = (view.sigma_hat, view.anisotropy, view.albedo, view.sun.tolist(), view.position.tolist(), view.fov)
    digest = hashlib.sha256(density.tobytes() + repr(facts).encode()).hexdigest()[:12]
    path = folder / f"{view.name}-{view.size}px-{view.samples}spp-{digest}.npy"
    if not path.exists():
        grid = prepare(density)
        halves = np.stack([_trace(view, grid, view.samples, seed) for seed in (1, 2)])
        folder.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        with open(partial, "wb") as file:
            np.save(file, halves)
        os.replace(partial, path)
    return np.load(path).astype(np.float64)


def seconds_a_sample(view) -> float:
    """What one path a pixel of our tracer costs on this machine, on all cores."""
    grid = prepare(view.density())
    _trace(view, grid, 1, seed=3)  # compiles
    start = time.perf_counter()
    _trace(view, grid, TIMED_SAMPLES, seed=4)
    return (time.perf_counter() - start) / TIMED_SAMPLES


def relative_variance(a, b, mask, samples: int) -> float:
    """Variance of a pixel at one path, over the squared mean of the image inside the mask (H, W).

    a, b: (H, W, C), two independent images of `samples` paths a pixel.
    """
    return 0.5 * np.mean((a - b)[mask] ** 2) * samples / (0.5 * np.mean((a + b)[mask])) ** 2
