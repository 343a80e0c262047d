# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of a production frame and of the next one, stage by stage, beside this machine's own arithmetic.

    python -m benchmarks.cost.frame [--table] [--size 1920 1080] [--light sun | sky | area] [--ground]
        [--coverage 0.43] [--numpy]

Renders a procedural cloud that covers a given share of the picture, in one sun, in sun and coloured sky or by an area
light, above black ground or alone, and then the frame after it, of a camera that has turned by a degree, with what the
first one left in its cache. Prints seconds by the clock and of the processor, memory, and both as shares of a
single-precision matrix product measured in the same run. --table prints rows of several such runs instead.
"""

import argparse
import os
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

from inference import AreaLight, Camera, Environment, Medium, RenderCache, Settings, Sun, Surface, render
from inference.runtime.report import Report, process_peak_memory
from inference.scene.environment import pixel_directions

from ..fidelity.views import look_at
from ..support.provenance import made_by
from .speed import cloud, sgemm_rate

PROGRAM = "benchmarks.cost.frame"
SUN = Sun((0.8, 0.45, -0.36))
MEDIUM = Medium(100.0, 1.0, 0.857)
TOWARDS = np.array([1.0, 0.4, 0.8])
# Of the images of skies.
ROWS = 128
#: Rows of the table: what is said of a frame, and the options that make it.
TABLE = {
    "1920 × 1080": (),
    "1920 × 1080, one thread": ("--threads", "1"),
    "3840 × 2160": ("--size", "3840", "2160"),
    "1920 × 1080, by an area light": ("--light", "area"),
    "1920 × 1080, above ground": ("--ground",),
    "1920 × 1080, by an area light above ground": ("--light", "area", "--ground"),
}
HEAD = "| | clock | processor | fields and shadows | march | network | MiB more |\n|---|---|---|---|---|---|---|"


def camera_covering(volume, medium: Medium, size: tuple[int, int], coverage: float) -> Camera:
    """A perspective camera in whose picture the cloud covers a share."""
    width, height = size
    small = (96, max(96 * height // width, 1))
    focal = 1.0
    for _ in range(5):
        camera = Camera(look_at(tuple(TOWARDS)), "orthographic", small, ortho_scale=focal)
        share = (render([(volume, Medium(medium.sigma_t, 0.0))], [SUN], camera).alpha > 0.02).mean()
        focal *= np.sqrt(share / coverage)
    return Camera(look_at(tuple(TOWARDS)), "orthographic", size, ortho_scale=focal)


def turned(camera: Camera) -> Camera:
    """The camera of the next frame, a degree further."""
    x, y, z = TOWARDS
    angle = np.radians(1.0)
    further = (x * np.cos(angle) - z * np.sin(angle), y, x * np.sin(angle) + z * np.cos(angle))
    return replace(camera, world_matrix=look_at(further))


def skies() -> tuple[Environment, Environment]:
    """A grey sky over dark ground, and a blue one with a warm glow whose colours are distributed differently."""
    directions = pixel_directions(ROWS)
    height = directions[..., 2]
    grey = np.where(height > 0.0, 0.6 + 0.8 * (1.0 - np.clip(height, 0.0, 1.0)), 0.08)
    glow = np.exp(8.0 * (directions @ np.array([0.8, 0.0, 0.6]) - 1.0))
    coloured = grey[..., None] * [0.4, 0.7, 1.0] + glow[..., None] * [2.0, 1.0, 0.2]
    return Environment(np.repeat(grey[..., None], 3, axis=2), name="grey"), Environment(coloured, name="coloured")


def frame_of(volume) -> tuple[np.ndarray, float]:
    """The middle (3,) of a volume, and its longest edge."""
    edges = volume.world_from_index[:3, :3] @ np.diag(volume.density.shape)
    return volume.world_from_index[:3, 3] + 0.5 * edges.sum(axis=1), float(np.linalg.norm(edges, axis=0).max())


def panel(volume, sun: Sun) -> AreaLight:
    """An area light that shines at a volume from where a sun is, 1.2 of its edges from its middle."""
    middle, size = frame_of(volume)
    across = np.cross(sun.direction, [0.3, 1.0, 0.2])
    across /= np.linalg.norm(across)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([across, np.cross(sun.direction, across), sun.direction], axis=1)
    matrix[:3, 3] = middle + 1.2 * size * sun.direction
    return AreaLight(matrix, "square", 0.4 * size, 40.0 * size**2)


def ground_below(volume) -> Surface:
    """A black plane just below a volume."""
    middle, size = frame_of(volume)
    corners = middle + size * np.array([[-20, -20, -0.55], [20, -20, -0.55], [20, 20, -0.55], [-20, 20, -0.55]])
    return Surface(corners[[[0, 1, 2], [0, 2, 3]]], "ground")


def print_table() -> None:
    """Print a row for each frame of TABLE, each in a process of its own, whose memory is measured."""
    print(HEAD)
    for name, options in TABLE.items():
        command = [sys.executable, "-m", PROGRAM, *options]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
        for line in said:
            if line.startswith("|"):
                print(f"| {name}, {line[2:]}", flush=True)


def row(name: str, seconds: float, processor: float, report: Report, before: int | None) -> str:
    """A frame as a row of the table, before whose name the scene's belongs; before: bytes that the process held."""
    used = report.cpu_seconds
    stages = used["fields"] + used["shadows"], used["march"], used["network"]
    memory = "" if before is None else f"{(report.peak_memory - before) / 2**20:.0f}"
    return " | ".join([f"| {name}", f"{seconds:.1f}", f"{processor:.1f}", *map("{:.1f}".format, stages), memory]) + " |"


def describe(name: str, seconds: float, processor: float, report: Report, rate: float) -> None:
    """Print one frame."""
    print(f"{name}: {seconds:.2f} s, {processor:.2f} processor seconds, {processor * rate / 1e9:.0f} Gflop of sgemm")
    for stage in report.seconds:
        print(f"    {stage:16} {report.seconds[stage]:7.2f} s {report.cpu_seconds[stage]:7.2f} processor s")
    points = report.counts.get("network points", 0)
    print(f"    {points} network points, {points / seconds:.0f} per second end to end")


def main():
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, nargs=2, default=(1920, 1080))
    parser.add_argument("--light", choices=("sun", "sky", "area"), default="sun")
    parser.add_argument("--ground", action="store_true", help="a plane below the cloud")
    parser.add_argument("--depth-samples", type=int, default=4)
    parser.add_argument("--coverage", type=float, default=0.43)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--table", action="store_true", help="a table of several frames; other options do not count")
    arguments = parser.parse_args()
    if arguments.table:
        print_table()
        print(made_by(PROGRAM))
        return
    volume = cloud()
    above = Sun(np.abs(SUN.direction), SUN.irradiance)
    lights = {"sun": [above if arguments.ground else SUN], "sky": [SUN, *skies()[1:]], "area": [panel(volume, above)]}
    surfaces = [ground_below(volume)] if arguments.ground else []
    camera = camera_covering(volume, MEDIUM, tuple(arguments.size), arguments.coverage)
    rate, before = sgemm_rate(), process_peak_memory()
    settings = Settings(arguments.depth_samples, threads=arguments.threads)
    cache = RenderCache()
    print(
        f"{arguments.size[0]} x {arguments.size[1]}, {arguments.depth_samples} depth samples, {arguments.light}, ",
        end="",
    )
    print(f"{os.cpu_count()} cores, matrix product {rate / 1e9:.0f} Gflop/s")
    for name, view in (("first frame", camera), ("next frame", turned(camera))):
        start, processor = time.perf_counter(), time.process_time()
        layer = render([(volume, MEDIUM)], lights[arguments.light], view, settings, cache=cache, surfaces=surfaces)
        seconds = time.perf_counter() - start, time.process_time() - processor
        describe(name, *seconds, layer.report, rate / os.cpu_count())
        print(row(name, *seconds, layer.report, before))
    print(f"covered: {(layer.alpha > 0.02).mean():.0%} of the picture, kernels: {layer.report.kernels}")
    if before is not None:
        print(f"memory: {(layer.report.peak_memory - before) / 2**20:.0f} MiB more than before")
    print(made_by(PROGRAM, models=[settings.model]))


if __name__ == "__main__":
    main()
