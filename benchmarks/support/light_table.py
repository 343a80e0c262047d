# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of a cloud in several lights, as a table."""

import argparse
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from inference import Settings, Volume, render

from ..cost.frame import MEDIUM, camera_covering
from ..cost.speed import cloud
from .provenance import made_by


def print_table(
    program: str,
    description: str,
    lights: Callable[[Volume], dict[str, list]],
    sizes: Sequence[str],
    options: Sequence[str] | None = None,
    alone: Mapping[str, str] | None = None,
) -> None:
    """Render a procedural cloud in each light in turn; print the least seconds, and their ratios to the first light's.

    program, description: for the command line. lights: of the volume, by name. sizes: of images, unless the options
    name others. alone: of the names of several lamps the name of one of them, to which the ratio is printed, too.
    """
    alone = alone or {}
    parser = argparse.ArgumentParser(
        prog=f"python -m {program}", description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", default=list(sizes))
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME", help="lights beside the first one")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--depth-samples", type=int, default=4)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args(options)
    volume, settings = cloud(), Settings(arguments.depth_samples, threads=arguments.threads)
    shining = lights(volume)
    first = next(iter(shining))
    if arguments.only:
        asked = [first, *(alone[name] for name in arguments.only if name in alone), *arguments.only]
        shining = {name: shining[name] for name in asked}
    alone = {name: of for name, of in alone.items() if name in shining}
    print(made_by(program, options))
    heads = ["pixels", "light", "processor seconds", "beside one sun", *(["beside one of them"] if alone else [])]
    print(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|")
    for size in arguments.sizes:
        camera = camera_covering(volume, MEDIUM, tuple(int(edge) for edge in size.split("x")), 0.43)
        least = dict.fromkeys(shining, np.inf)
        for _ in range(arguments.rounds):
            for name, some in shining.items():
                start = time.process_time()
                render([(volume, MEDIUM)], some, camera, settings)
                least[name] = min(least[name], time.process_time() - start)
        for name, seconds in least.items():
            row = [size, name, f"{seconds:.2f}", f"{seconds / least[first]:.2f}"]
            if alone:
                row.append(f"{seconds / least[alone.get(name, name)]:.2f}")
            print(f"| {' | '.join(row)} |", flush=True)
