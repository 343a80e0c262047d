# SPDX-License-Identifier: GPL-3.0-or-later
"""How well a render knows what time it still takes.

    python -m benchmarks.cost.remaining_time [--size 480]

Renders a procedural cloud thin and dense, in one, six and coloured lights, and in one whose extinction differs by
channel. Prints for each, after the first tenth of its time and while more than a second is left, by how much the time
left that follows from `progress` differs from the time that it then took: the median, and the share within 30 %.
"""

import argparse
import time

import numpy as np

from inference import Medium, Settings, Sun, render

from ..support.provenance import made_by
from .speed import camera_covering, cloud

PROGRAM = "benchmarks.cost.remaining_time"
SUN = Sun((0.4, 0.8, 0.3), 2.0)
SIX = [Sun(direction, 1.0) for direction in np.random.default_rng(0).normal(size=(6, 3))]
SCENES = {
    "one sun": (Medium(60.0, 0.99, 0.857), [SUN]),
    "dense": (Medium(1000.0, 0.99, 0.857), [SUN]),
    "six suns": (Medium(60.0, 0.99, 0.857), SIX),
    "three extinctions": (Medium((90.0, 60.0, 30.0), 0.99, 0.857), [SUN]),
}


def relative_errors(told: list[tuple[float, float]], total: float) -> np.ndarray:
    """Of the time left that (seconds since the start, fraction) tell, where it can be judged."""
    rows = [
        (now / fraction - now) / (total - now) - 1.0
        for now, fraction in told
        if fraction > 0.0 and now > 0.1 * total and total - now > 1.0
    ]
    return np.array(rows)


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=480, help="of the square image, in pixels")
    chosen = parser.parse_args(arguments)
    volume = cloud()
    camera = camera_covering(volume, SCENES["one sun"][0], chosen.size, 0.4)
    print("| scene | seconds | median error of the time left | within 30 % |")
    print("| --- | --- | --- | --- |")
    for name, (medium, suns) in SCENES.items():
        told, start = [], time.perf_counter()

        def tell(fraction, message, told=told, start=start):
            told.append((time.perf_counter() - start, fraction))

        render([(volume, medium)], suns, camera, Settings(depth_samples=4), progress=tell)
        total = time.perf_counter() - start
        errors = relative_errors(told, total)
        known = f"{np.median(np.abs(errors)):.0%} | {np.mean(np.abs(errors) < 0.3):.0%}" if len(errors) else "- | -"
        print(f"| {name} | {total:.1f} | {known} |", flush=True)
    print(f"\n{made_by(PROGRAM, arguments)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
