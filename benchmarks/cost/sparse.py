# SPDX-License-Identifier: GPL-3.0-or-later
"""What a large, mostly empty volume file costs to read and render: makes docs/tables/speed-sparse.csv.

    python -m benchmarks.cost.sparse [--cells 2048] [--size 1920 1080] [--share 0.01] [--no-page]

Writes a .vdb file of a cloud of cells^3 voxels, a given share of which is above 0, and reads and renders it in Blender
in a new process. Memory is that of this process and of those that it starts: the peak of samples taken every few
milliseconds, above what was held with the scene set up. Linux only.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..support.extension import ROOT, load_extension
from ..support.pages import write_tables
from ..support.provenance import made_by

PROGRAM = "benchmarks.cost.sparse"
# Of the generator's volumes; each of its cells is split into SPLIT per edge.
SEED, SPLIT = 1_000_000, 4
# Voxels per edge of the parts in which the cloud is made.
PART = 128
# Random positions by which the threshold is found.
PLACES = 1 << 20
OPTICAL_DEPTH = 100.0
POLL_INTERVAL = 0.005
STAGES = "shadows", "fields", "march", "network", "total"


def write_cloud(path: Path, cells: int, share: float) -> None:
    """Write a trilinearly refined cloud with a puff in two corners, less the threshold that leaves `share` above 0."""
    from mrpnn.mrpnn_addon.vdb.openvdb_module import load_openvdb

    from inference.grids.dense_grid import DenseGrid
    from training.procedural.volumes import make_volume

    density = make_volume(SEED, cells // SPLIT).density
    density[:2, :2, :2] = density[-2:, -2:, -2:] = density.max()
    coarse, openvdb = DenseGrid(density), load_openvdb()
    anywhere = np.random.default_rng(0).uniform(0.0, len(density), (3, PLACES)).astype(np.float32)
    threshold = np.quantile(coarse.sample(anywhere), 1.0 - share)
    grid = openvdb.FloatGrid()
    grid.name, grid.gridClass = "density", "fog volume"
    axis = ((np.arange(cells) + 0.5) / SPLIT - 0.5).astype(np.float32)
    for corner in np.ndindex(*[-(-cells // PART)] * 3):
        axes = [axis[PART * n : PART * (n + 1)] for n in corner]
        around = tuple(slice(max(int(a[0]), 0), int(a[-1]) + 2) for a in axes)
        if density[around].max() <= threshold:
            continue
        places = np.stack(np.meshgrid(*axes, indexing="ij")).reshape(3, -1)
        values = np.maximum(coarse.sample(places) - threshold, np.float32(0.0)).reshape([len(a) for a in axes])
        if values.any():
            grid.copyFromArray(np.ascontiguousarray(values), ijk=tuple(PART * n for n in corner))
    openvdb.write(str(path), grids=[grid])


def held_memory() -> int:
    """Resident bytes of this process and of those that it started."""
    import os
    import resource

    def pages(process):
        try:
            return int(Path(f"/proc/{process}/statm").read_text().split()[1])
        except OSError:
            return 0

    started = []
    for task in Path("/proc/self/task").iterdir():
        try:
            started += (task / "children").read_text().split()
        except OSError:
            pass
    return sum(map(pages, [os.getpid(), *started])) * resource.getpagesize()


class Peak:
    """Peak of the memory held inside a `with` block: `bytes`."""

    def __enter__(self):
        self.bytes, self._over = held_memory(), threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)
        self._thread.start()
        return self

    def _sample(self):
        while not self._over.wait(POLL_INTERVAL):
            self.bytes = max(self.bytes, held_memory())

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()


def measure(path: Path, cells: int, size) -> dict:
    """Read and render a file of cells^3 voxels in Blender's scene; figures."""
    import bpy
    from mrpnn.inference import Settings, render
    from mrpnn.inference.plan.plan import make_plan
    from mrpnn.inference.render_cache import RenderCache
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    from ..demo import scene as demo_scene

    scene, volume, shader = demo_scene.make_scene(path, size, "density", y_up=False)
    volume.scale, volume.location = (demo_scene.EDGE / cells,) * 3, (-0.5 * demo_scene.EDGE,) * 3
    volume.data.render.space = "WORLD"
    shader.inputs["Density"].default_value = OPTICAL_DEPTH / demo_scene.EDGE
    demo_scene.frame(scene, demo_scene.EDGE * (np.array(list(np.ndindex(2, 2, 2))) - 0.5))
    # Blender loads the file's grid here, which does not count.
    bpy.context.evaluated_depsgraph_get()
    before, start = held_memory(), time.perf_counter()
    with Peak() as reading:
        found = read_scene(bpy.context.evaluated_depsgraph_get())
    read = time.perf_counter() - start
    density, settings = found.volumes[0][0].density, Settings()
    held = held_memory() - before
    plan = make_plan(found.volumes, found.lights, found.camera, settings)
    cache, view = RenderCache(), found.camera
    with Peak() as rendering:
        layer = render(found.volumes, found.lights, view, settings, cache=cache)
    whole = replace(settings, optimizations=settings.optimizations - {"level_of_detail"})
    expected = render(found.volumes, found.lights, view, whole)
    error = np.sqrt(np.mean((layer.rgb - expected.rgb) ** 2) / np.mean(expected.rgb**2))
    view.world_matrix[:3, 3] += 0.01 * view.world_matrix[:3, 0]
    following = render(found.volumes, found.lights, view, settings, cache=cache)
    voxels = float(np.prod(np.array(density.shape, float)))
    values = getattr(density, "values", density)
    return {
        "voxels": " x ".join(map(str, density.shape)),
        "active": np.count_nonzero(values) / voxels,
        "kept": values.size / voxels,
        "covered": float((layer.alpha > 0.02).mean()),
        "read": read,
        "reading": reading.bytes - before,
        "held": held,
        "planned": plan.memory,
        "seconds": layer.report.cpu_seconds,
        "next": following.report.cpu_seconds["total"],
        "whole": expected.report.cpu_seconds["total"],
        "error": float(error),
        "rendering": rendering.bytes - before,
    }


def table(figures: dict, size) -> str:
    seconds = figures["seconds"]
    rows = [
        ("voxels", figures["voxels"]),
        ("above 0", f"{figures['active']:.1%}"),
        ("stored", f"{figures['kept']:.1%}"),
        ("image", f"{size[0]} × {size[1]}, {figures['covered']:.0%} covered"),
        ("reading", f"{figures['read']:.1f} s"),
        *((f"{stage}, processor", f"{seconds[stage]:.1f} s") for stage in STAGES),
        ("next frame, processor", f"{figures['next']:.1f} s"),
        ("without levels of detail, processor", f"{figures['whole']:.1f} s"),
        ("error of levels of detail", f"{figures['error']:.4f}"),
        ("peak memory while reading", f"{figures['reading'] / 1e9:.2f} GB"),
        ("memory of the grid", f"{figures['held'] / 1e9:.2f} GB"),
        ("peak memory", f"{figures['rendering'] / 1e9:.2f} GB"),
        ("estimated, on top of the grid", f"{figures['planned'] / 1e9:.2f} GB"),
    ]
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows)])


def main():
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=2048)
    parser.add_argument("--size", type=int, nargs=2, default=(1920, 1080))
    parser.add_argument("--share", type=float, default=0.01)
    parser.add_argument("--no-page", action="store_true", help="print only")
    parser.add_argument("--write", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.write or arguments.measure:
        package = load_extension()
        try:
            if arguments.write:
                write_cloud(arguments.write, arguments.cells, arguments.share)
            else:
                print(json.dumps(measure(arguments.measure, arguments.cells, arguments.size)), flush=True)
        finally:
            package.unregister()
        return
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/cloud.vdb"
        command = [
            sys.executable,
            "-m",
            PROGRAM,
            "--cells",
            str(arguments.cells),
            "--share",
            str(arguments.share),
            "--size",
            *map(str, arguments.size),
        ]
        subprocess.run([*command, "--write", path], cwd=ROOT, check=True)
        output = subprocess.run([*command, "--measure", path], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    figures = json.loads(next(line for line in output.stdout.splitlines() if line.startswith("{")))
    found = table(figures, arguments.size)
    print(found)
    if not arguments.no_page:
        write_tables("speed-sparse", found, [made_by(PROGRAM)])


if __name__ == "__main__":
    main()
