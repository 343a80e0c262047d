# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of lamps beside those of one white sun.

    python -m benchmarks.cost.lamps [--sizes 64x64 256x256] [--rounds 3]

Renders a procedural cloud lit by one sun, and by a lamp of each kind outside of it, by a point light inside, and by
four suns and four point lights, in turn, and prints the least seconds of each and their ratios to the sun's.
"""

import argparse
import time

import numpy as np

from inference import AreaLight, PointLight, Settings, SpotLight, Sun, render

from ..support.provenance import made_by
from .frame import MEDIUM, SUN, camera_covering
from .speed import cloud

PROGRAM = "benchmarks.cost.lamps"


def lights(volume) -> dict[str, list]:
    """Lights of the volume by name."""
    edges = volume.world_from_index[:3, :3] @ np.diag(volume.density.shape)
    middle, size = volume.world_from_index[:3, 3] + 0.5 * edges.sum(axis=1), float(np.linalg.norm(edges, axis=0).max())
    towards = SUN.direction
    place, power = middle + 1.2 * size * towards, 40.0 * size**2
    matrix = np.eye(4)
    across = np.cross(towards, [0.3, 1.0, 0.2])
    across /= np.linalg.norm(across)
    matrix[:3, :3], matrix[:3, 3] = np.stack([across, np.cross(towards, across), towards], axis=1), place
    turned = [np.roll(towards, 1) * [1, 1, -1], np.roll(towards, 2), towards * [-1, 1, 1]]
    around = [towards, *turned]
    return {
        "one white sun": [Sun(towards, 3.0)],
        "a point light": [PointLight(place, power, 0.02 * size)],
        "a spot light": [SpotLight(place, -towards, power, 0.8, 0.2, 0.02 * size)],
        "an area light": [AreaLight(matrix, "square", 0.4 * size, power)],
        "a point light inside": [PointLight(middle, power, 0.02 * size)],
        "four suns": [Sun(way, 3.0) for way in around],
        "four point lights": [PointLight(middle + 1.2 * size * way, power) for way in around],
    }


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", default=["64x64", "256x256"])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--depth-samples", type=int, default=4)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args(options)
    volume, settings = cloud(), Settings(arguments.depth_samples, threads=arguments.threads)
    shining = lights(volume)
    print(made_by(PROGRAM, options))
    print("| pixels | light | processor seconds | beside one sun |\n|---|---|---|---|")
    for size in arguments.sizes:
        camera = camera_covering(volume, MEDIUM, tuple(int(edge) for edge in size.split("x")), 0.43)
        least = dict.fromkeys(shining, np.inf)
        for _ in range(arguments.rounds):
            for name, some in shining.items():
                start = time.process_time()
                render([(volume, MEDIUM)], some, camera, settings)
                least[name] = min(least[name], time.process_time() - start)
        for name, seconds in least.items():
            print(f"| {size} | {name} | {seconds:.2f} | {seconds / least['one white sun']:.2f} |", flush=True)


if __name__ == "__main__":
    main()
