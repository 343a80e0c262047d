# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds, memory and error of a cloud made of many overlapping puffs beside a single volume.

    python -m benchmarks.cost.puffs [--count 300] [--voxels 64] [--size 480x270] [--apart]

Renders a cloud of turned instances of procedural volumes, lit by a sun and a grey World, each time in a new process:
merged into one volume beforehand, and as the puffs that they are. With --apart also without the optimization
joined_volumes, which takes long, and with the change that it makes to the picture. Linux only.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from inference import Environment, Medium, Settings, Sun, Volume, render
from inference.grids.grid import Grid
from inference.grids.merge import join
from inference.render_cache import RenderCache
from inference.scene.optimizations import ALL
from training.procedural.volumes import make_volume

from ..support.extension import ROOT
from ..support.provenance import made_by
from .sky import SEED, camera

PROGRAM = "benchmarks.cost.puffs"
#: Different arrays; extinction per unit density; edges of puffs, least and most, in a cloud of edge 1.
KINDS, SIGMA_T, EDGES = 5, 60.0, (0.2, 0.3)


def puffs(count: int, voxels: int) -> list[tuple[Volume, Medium]]:
    """So many puffs in a flat ball around the origin, each turned about the vertical."""
    rng = np.random.default_rng(1)
    densities = [np.asarray(make_volume(SEED + kind, voxels).density, np.float32) for kind in range(KINDS)]
    medium, pairs = Medium(SIGMA_T, 0.99, 0.5), []
    for number in range(count):
        direction, angle = rng.normal(size=3), rng.uniform(0.0, 2.0 * np.pi)
        place = direction / np.linalg.norm(direction) * np.cbrt(rng.uniform()) * [0.36, 0.36, 0.25]
        cosine, sine, matrix = np.cos(angle), np.sin(angle), np.eye(4)
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        matrix[:3, :3] = turn * rng.uniform(*EDGES) / voxels
        matrix[:3, 3] = place - matrix[:3, :3] @ np.full(3, 0.5 * (voxels - 1))
        pairs.append((Volume(densities[number % KINDS], matrix, f"puff {number}"), medium))
    return pairs


def measure(arguments: argparse.Namespace) -> dict:
    """Figures of the first frame and of one after it, from a camera that has moved; writes the first picture."""
    volumes, optimizations = puffs(arguments.count, arguments.voxels), ALL
    if arguments.measure == "one":
        grids, media = [Grid(volume) for volume, _ in volumes], [medium for _, medium in volumes]
        volumes = [join(grids, media, "cloud", EDGES[0] / arguments.voxels)]
    elif arguments.measure == "apart":
        optimizations = ALL - {"joined_volumes"}
    lights = [Sun((0.4, -0.5, 0.75), 3.0), Environment(np.full((1, 2, 3), 0.3))]
    view, cache = camera(tuple(map(int, arguments.size.split("x")))), RenderCache()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    settings = Settings(optimizations=optimizations)
    first = render(volumes, lights, view, settings, cache=cache)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    np.save(arguments.picture, first.rgb)
    view.world_matrix[0, 3] += 0.01
    second = render(volumes, lights, view, settings, cache=cache)
    seconds = [layer.report.cpu_seconds["total"] for layer in (first, second)]
    return {"covered": float((first.alpha > 0.02).mean()), "seconds": seconds, "memory": max(memory, 0) / 2**10}


def main():
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--voxels", type=int, default=64)
    parser.add_argument("--size", default="480x270")
    parser.add_argument("--apart", action="store_true", help="also without joined_volumes")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    parser.add_argument("--picture", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        print(json.dumps(measure(arguments)), flush=True)
        return
    print(
        "| | covered | first frame | next frame | over one volume | MiB | changed by |\n|---|---|---|---|---|---|---|"
    )
    ways, found, pictures = ["one", *["apart"] * arguments.apart, "joined"], {}, {}
    with tempfile.TemporaryDirectory() as folder:
        for way in ways:
            picture = Path(folder) / f"{way}.npy"
            command = [sys.executable, "-m", PROGRAM, "--measure", way, "--picture", str(picture)]
            command += ["--count", str(arguments.count), "--voxels", str(arguments.voxels), "--size", arguments.size]
            output = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
            found[way], pictures[way] = json.loads(output.splitlines()[-1]), np.load(picture)
    for way in ways:
        first, following = found[way]["seconds"]
        ratios = first / found["one"]["seconds"][0], following / found["one"]["seconds"][1]
        error = ""
        if way == "joined" and arguments.apart:
            error = f"{np.sqrt(((pictures[way] - pictures['apart']) ** 2).mean()) / pictures['apart'].mean():.4f}"
        print(
            f"| {way} | {found[way]['covered']:.0%} | {first:.1f} | {following:.1f} | {ratios[0]:.1f}, {ratios[1]:.1f} "
            f"| {found[way]['memory']:.0f} | {error} |"
        )
    print(f"\n{made_by(PROGRAM)}")


if __name__ == "__main__":
    main()
