# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds and memory of many instances of a few clouds beside those of a single volume.

    python -m benchmarks.cost.sky [--counts 1 40 200 1000] [--clouds 1] [--voxels 156] [--size 480x270] [--turned]
                                  [--whole]

Renders so many instances of procedural clouds, spread over a plane and lit by a sun and a grey World, each in a new
process, and prints their processor seconds by stage, and both beside those of one instance that fills the picture.
With --turned each is turned about the vertical by an angle of its own, and smaller by up to a third. With --whole the
same is rendered without levels of detail: seconds beside those, and the root mean square difference over that of the
picture. Linux only.
"""

import argparse
import json
import resource
import subprocess
import sys

import numpy as np

from inference import Camera, Environment, Medium, Settings, Sun, Volume, render
from inference.render_cache import RenderCache
from training.procedural.volumes import make_volume

from ..support.extension import ROOT
from ..support.provenance import made_by

PROGRAM = "benchmarks.cost.sky"
SEED = 1_000_000
STAGES = "shadows", "fields", "march", "network", "total"
#: Optical thickness of a cloud along an edge, at its largest density.
THICKNESS = 60.0
#: Edge of a cloud over the distance to its neighbours.
SHARE = 0.7


def instances(count: int, voxels: int, turned: bool, clouds: int = 1) -> list[tuple[Volume, Medium]]:
    """So many instances of a few arrays, in turn, on a square of edge 1 around the origin."""
    made = [np.asarray(make_volume(SEED + n, voxels).density, np.float32) for n in range(min(clouds, count))]
    across, rng = int(np.ceil(np.sqrt(count))), np.random.default_rng(0)
    edge = SHARE / across
    media = [Medium(THICKNESS / (edge * float(density.max())), 0.99, 0.5) for density in made]
    pairs = []
    for number in range(count):
        row, column = divmod(number, across)
        angle = rng.uniform(0.0, 2.0 * np.pi) if turned else 0.0
        cosine, sine = np.cos(angle), np.sin(angle)
        matrix = np.eye(4)
        matrix[:3, :3] = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) * (edge / voxels)
        place = (np.array([column, row, 0.5 * across]) + 0.5) / across - 0.5
        # A turned cube reaches further.
        matrix[:3, :3] *= 0.7 * rng.uniform(0.67, 1.0) if turned else 1.0
        matrix[:3, 3] = place * [1.0, 1.0, 0.0] - matrix[:3, :3] @ np.full(3, 0.5 * (voxels - 1))
        which = number % len(made)
        pairs.append((Volume(made[which], matrix, f"cloud {number}"), media[which]))
    return pairs


def camera(size: tuple[int, int]) -> Camera:
    """Looks down at the square, at an angle."""
    matrix, tilt = np.eye(4), np.radians(50.0)
    matrix[1:3, 1:3] = [[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]]
    matrix[:3, 3] = 1.8 * matrix[:3, 2]
    return Camera(matrix, resolution=size)


def measure(arguments: argparse.Namespace) -> dict:
    """Figures of the first frame and of one after it, from a camera that has moved."""
    size = tuple(map(int, arguments.size.split("x")))
    volumes = instances(arguments.counts[0], arguments.voxels, arguments.turned, arguments.clouds)
    lights = [Sun((0.4, -0.5, 0.75), 3.0), Environment(np.full((1, 2, 3), 0.3))]
    view, cache = camera(size), RenderCache()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    first = render(volumes, lights, view, Settings(), cache=cache)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    view.world_matrix[0, 3] += 0.01
    second = render(volumes, lights, view, Settings(), cache=cache)
    whole = {}
    if arguments.whole:
        settings = Settings(optimizations=Settings().optimizations - {"level_of_detail"}, memory_limit=1 << 40)
        expected = render(volumes, lights, view, settings)
        error = np.sqrt(np.mean((second.rgb - expected.rgb) ** 2) / np.mean(expected.rgb**2))
        whole = {"whole": expected.report.cpu_seconds["total"], "error": float(error)}
    return whole | {
        "covered": float((first.alpha > 0.02).mean()),
        "first": first.report.cpu_seconds,
        "next": second.report.cpu_seconds,
        "memory": memory / 2**10,
    }


def main():
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 40, 200, 1000])
    parser.add_argument("--clouds", type=int, default=1, help="different arrays")
    parser.add_argument("--voxels", type=int, default=156)
    parser.add_argument("--size", default="480x270")
    parser.add_argument("--turned", action="store_true", help="each instance has an angle and a size of its own")
    parser.add_argument("--whole", action="store_true", help="also without levels of detail")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        print(json.dumps(measure(arguments)), flush=True)
        return
    more = ("without levels of detail", "error") if arguments.whole else ()
    print(f"| instances | covered | {' | '.join((*STAGES, 'next frame', 'MiB', 'seconds, memory over one', *more))} |")
    print("|" + "---|" * (len(STAGES) + 5 + len(more)))
    one = None
    for count in arguments.counts:
        command = [sys.executable, "-m", PROGRAM, "--measure", "--counts", str(count)]
        command += ["--clouds", str(arguments.clouds), "--voxels", str(arguments.voxels)]
        command += ["--size", arguments.size, *["--turned"] * arguments.turned]
        command += ["--whole"] * arguments.whole
        output = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
        found = json.loads(output.splitlines()[-1])
        one = one or found
        seconds = [f"{found['first'].get(stage, 0.0):.1f}" for stage in STAGES]
        ratios = found["first"]["total"] / one["first"]["total"], found["memory"] / one["memory"]
        print(
            f"| {count} | {found['covered']:.0%} | {' | '.join(seconds)} | {found['next']['total']:.1f} | "
            f"{found['memory']:.0f} | {ratios[0]:.1f}, {ratios[1]:.1f} |"
            + (f" {found['whole']:.1f} | {found['error']:.4f} |" if arguments.whole else ""),
            flush=True,
        )
    print(f"\n{made_by(PROGRAM)}")


if __name__ == "__main__":
    main()
