# SPDX-License-Identifier: GPL-3.0-or-later
"""Seconds and points of one render, beside this machine's own arithmetic.

    python -m benchmarks.cost.speed [--size 512] [--depth-samples 8] [--coverage 0.4] [--model mrpnn]

Renders a procedural cloud that covers a given share of a square image. Prints the seconds of each stage, network
points per second, and the network's arithmetic rate, alone and with its descriptors, as a share of that of a
single-precision matrix product measured in the same run.
"""

import argparse
import os
import time

import numpy as np
import onnx

from inference import Camera, Medium, Settings, Sun, render
from inference.models.weights_file import WEIGHTS
from inference.network.network import load_network
from inference.network.predictor import POINTS_PER_TASK
from training.procedural.seeded_volume import cube_volume
from training.procedural.volumes import HELD_BACK, make_volume

from ..fidelity.views import look_at
from ..support.provenance import made_by

PROGRAM = "benchmarks.cost.speed"
# Runs of the network alone, and how many of its points lie on one ray.
RUNS, SAMPLES_PER_RAY = 50, 8


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


def flop_per_point(name: str) -> int:
    """Multiplications and additions per point of a network's matrix products."""
    graph = onnx.load(WEIGHTS / f"{name}.onnx").graph
    sizes = {weights.name: int(np.prod(weights.dims)) for weights in graph.initializer}
    products = [node for node in graph.node if node.op_type in ("Gemm", "MatMul")]
    return 2 * sum(sizes.get(name, 0) for node in products for name in node.input[:2])


def network_seconds(name: str) -> float:
    """Seconds per point of the network alone on one core: the best of RUNS."""
    session, random = load_network(name).session, np.random.default_rng(1)
    sizes = {"N": POINTS_PER_TASK, "V": POINTS_PER_TASK // SAMPLES_PER_RAY, "A": 1}
    inputs = {i.name: random.random([sizes.get(n, n) for n in i.shape], np.float32) for i in session.get_inputs()}
    if "view" in inputs:
        inputs["view"] = np.arange(POINTS_PER_TASK, dtype=np.int32) // SAMPLES_PER_RAY
    best = np.inf
    for _ in range(RUNS):
        start = time.perf_counter()
        session.run(None, inputs)
        best = min(best, time.perf_counter() - start)
    return best / POINTS_PER_TASK


def main():
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--depth-samples", type=int, default=8)
    parser.add_argument("--coverage", type=float, default=0.4)
    parser.add_argument("--model", default="mrpnn")
    arguments = parser.parse_args()
    medium = Medium(100.0, 1.0, 0.857)
    volume = cloud()
    camera = camera_covering(volume, medium, arguments.size, arguments.coverage)
    rate = sgemm_rate()
    settings = Settings(arguments.depth_samples, model=arguments.model)
    layer = render([(volume, medium)], [Sun((0.8, 0.45, -0.36))], camera, settings)
    report = layer.report
    points = report.counts["network points"]
    print("| | |\n|---|---|")
    print(f"| image | {arguments.size}², {arguments.depth_samples} depth samples, {os.cpu_count()} cores |")
    print(f"| covered | {(layer.alpha > 0.02).mean():.0%}, {points} points |")
    for stage, seconds in report.seconds.items():
        print(f"| {stage} | {seconds:.2f} s |")
    print(f"| points per second, end to end | {points / report.seconds['total']:.0f} |")
    work, alone = flop_per_point(arguments.model), network_seconds(arguments.model)
    share, one_core = points * work / report.seconds["network"] / rate, rate / os.cpu_count()
    print(f"| a matrix product | {rate / 1e9:.0f} Gflop/s |")
    print(f"| the network alone, on one core | {work / alone / one_core:.0%} of that, {1e6 * alone:.1f} µs per point |")
    print(f"| the stage *network*, with its inputs | {share:.0%} of that |")
    print(made_by(PROGRAM, models=[arguments.model]))


if __name__ == "__main__":
    main()
