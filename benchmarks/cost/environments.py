# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of environments beside those of one white sun.

    python -m benchmarks.cost.environments [--sizes 64x64 1920x1080] [--rounds 3]

Renders a procedural cloud lit by one white sun, by a grey environment, by a coloured one, and by the sun and the
coloured environment together, in turn, and prints the least seconds of each and their ratios to the sun's.
"""

import argparse
import time

import numpy as np

from inference import Settings, Sun, render

from ..support.provenance import made_by
from .frame import MEDIUM, SUN, camera_covering, skies
from .speed import cloud

PROGRAM = "benchmarks.cost.environments"


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", default=["64x64", "1920x1080"])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--depth-samples", type=int, default=4)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args(options)
    volume, settings = cloud(), Settings(arguments.depth_samples, threads=arguments.threads)
    sun, (grey, coloured) = Sun(SUN.direction, 3.0), skies()
    lights = {
        "one white sun": [sun],
        "a grey environment": [grey],
        "a coloured environment": [coloured],
        "sun and coloured environment": [sun, coloured],
    }
    print(made_by(PROGRAM, options))
    print("| pixels | light | processor seconds | beside one sun |\n|---|---|---|---|")
    for size in arguments.sizes:
        camera = camera_covering(volume, MEDIUM, tuple(int(edge) for edge in size.split("x")), 0.43)
        least = dict.fromkeys(lights, np.inf)
        for _ in range(arguments.rounds):
            for name, shining in lights.items():
                start = time.process_time()
                render([(volume, MEDIUM)], shining, camera, settings)
                least[name] = min(least[name], time.process_time() - start)
        for name, seconds in least.items():
            print(f"| {size} | {name} | {seconds:.2f} | {seconds / least['one white sun']:.2f} |", flush=True)


if __name__ == "__main__":
    main()
