"""Seconds, points and memory of one render, beside this machine's own arithmetic.

    python -m benchmarks.speed [--size 512] [--depth-samples 8] [--coverage 0.4]

Renders a procedural cloud that covers a given share of a square image and prints the stages, points a
second, the largest memory on top of what the process held before, and the network's share of the
single-precision matrix product's rate measured in the same run.
"""

import argparse
import os
import time

import numpy as np

from inference import Camera, Medium, Settings, Sun, render
from inference.report import process_peak_memory
from training.seeded_volume import cube_volume
from training.volumes import HELD_BACK, make_volume

from .views import look_at

# Multiplications and additions of MRPNN a point with one albedo: 2 per weight of its layers.
FLOP_A_POINT = 2 * 46_700


def cloud(resolution: int = 192):
    """The first held-back cumulus."""
    for seed in HELD_BACK:
        sample = make_volume(seed, resolution)
        if sample.kind == "cumulus":
            return cube_volume(sample.density, "cloud")


def camera_covering(volume, medium, size: int, coverage: float) -> Camera:
    """An orthographic camera in which the cloud covers a share of the image."""
    scale, sun = 1.2, Sun((0.0, 0.0, 1.0))
    for _ in range(4):
        camera = Camera(look_at((1.0, 0.4, 0.8)), "orthographic", (64, 64), ortho_scale=scale)
        share = (render([(volume, Medium(medium.sigma_t, 0.0))], [sun], camera).alpha > 0.02).mean()
        scale *= np.sqrt(share / coverage)
    return Camera(look_at((1.0, 0.4, 0.8)), "orthographic", (size, size), ortho_scale=scale)


def sgemm_rate() -> float:
    """Best of five products of 2048 x 2048 matrices, flop/s on all cores."""
    a = np.random.default_rng(0).random((2048, 2048), np.float32)
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        a @ a
        best = min(best, time.perf_counter() - start)
    return 2 * 2048**3 / best


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--depth-samples", type=int, default=8)
    parser.add_argument("--coverage", type=float, default=0.4)
    arguments = parser.parse_args()
    medium = Medium(100.0, 1.0, 0.857)
    volume = cloud()
    camera = camera_covering(volume, medium, arguments.size, arguments.coverage)
    rate = sgemm_rate()
    before = process_peak_memory()
    layer = render([(volume, medium)], [Sun((0.8, 0.45, -0.36))], camera, Settings(arguments.depth_samples))
    report = layer.report
    points = report.counts["network points"]
    print(f"{arguments.size} x {arguments.size}, {arguments.depth_samples} depth samples, {os.cpu_count()} cores")
    print(f"covered: {(layer.alpha > 0.02).mean():.0%} of the image, {points} points")
    for stage, seconds in report.seconds.items():
        print(f"{stage:16} {seconds:7.2f} s")
    print(f"points a second  {points / report.seconds['total']:9.0f} end to end")
    if before is not None:
        print(f"memory           {(report.peak_memory - before) / 2**20:9.0f} MiB more than before")
    share = points * FLOP_A_POINT / report.seconds["network"] / rate
    print(f"descriptors and network run at {share:.0%} of {rate / 1e9:.0f} Gflop/s, the matrix product's rate")


if __name__ == "__main__":
    main()
