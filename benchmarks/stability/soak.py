# SPDX-License-Identifier: GPL-3.0-or-later
"""Many renders in one Blender process: does memory grow?

    python -m benchmarks.stability.soak [--renders 200] [--figures docs/tables/soak.csv]

Renders a small cloud with the operator, with changing sun, density, size and number of depth samples, and every tenth
time a frame with the engine. Prints the process's resident memory after each tenth and writes the figures. The exit
status is 1 where memory leaks, that is, where all of the last tenth need over 5 % more than the first half ever did,
or where threads or images are left over.
"""

import argparse
import ctypes
import gc
import itertools
import pathlib
import resource
import sys
import tempfile
import threading

import bpy
import numpy as np

from ..demo.scene import EDGE, frame, make_scene, write_grid
from ..support.extension import ROOT, load_extension
from ..support.pages import csv_text, replace
from ..support.provenance import made_by

PROGRAM = "benchmarks.stability.soak"
DOCS = ROOT / "docs"
GROWTH = 1.05


def resident() -> float:
    """Resident memory of this process in MiB, without what the allocator keeps for later."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


def small_cloud(path: pathlib.Path, openvdb):
    """A scene that shows a ball of fog of 16^3 voxels, whose density falls off from its centre."""
    squares = np.linspace(-1.0, 1.0, 16) ** 2
    radius = np.sqrt(squares[:, None, None] + squares[None, :, None] + squares[None, None, :])
    write_grid(path, np.clip(1.0 - radius, 0.0, None), openvdb)
    scene, _, _ = make_scene(path, (16, 16), "density", y_up=False)
    frame(scene, 0.5 * EDGE * np.array(list(itertools.product((-1.0, 1.0), repeat=3))))
    return scene


def vary(scene, number: int) -> None:
    """Change the scene for the next render."""
    scene.render.resolution_x = 16 + 8 * (number % 3)
    scene.mrpnn.depth_samples = 1 + number % 4
    bpy.data.objects["Sun"].rotation_euler.x = 0.1 * number
    shader = bpy.data.materials[0].node_tree.nodes["Principled Volume"]
    shader.inputs["Density"].default_value = 1.0 + number % 5
    bpy.context.view_layer.update()


def main(options=None) -> int:
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--renders", type=int, default=200)
    parser.add_argument("--figures", type=pathlib.Path, default=DOCS / "tables" / "soak.csv")
    arguments = parser.parse_args(options)
    package = load_extension()
    held = []
    with tempfile.TemporaryDirectory() as folder:
        scene = small_cloud(pathlib.Path(folder, "cloud.vdb"), package.mrpnn_addon.vdb.openvdb_module.load_openvdb())
        scene.render.filepath = folder + "/frame"
        for number in range(arguments.renders):
            vary(scene, number)
            if number % 10 == 9:
                scene.render.engine = "MRPNN"
                bpy.ops.render.render(write_still=True)
            else:
                bpy.ops.mrpnn.render(filepath=folder + "/layer.exr")
            held.append(resident())
            if (number + 1) % max(arguments.renders // 10, 1) == 0:
                print(f"{number + 1:5} renders: {held[-1]:.0f} MiB", flush=True)
        left = sorted(path.name for path in pathlib.Path(folder).iterdir())
    threads, images = threading.active_count(), len(bpy.data.images)
    package.unregister()
    rows = [(n + 1, f"{size:.1f}") for n, size in enumerate(held)]
    replace(arguments.figures, csv_text([made_by(PROGRAM, options)], ["render", "resident MiB"], rows))
    half = len(held) // 2
    growth = min(held[-max(len(held) // 10, 1) :]) / max(held[:half])
    print(
        f"minimum of the last tenth over maximum of the first half: {growth:.3f}; "
        f"{threads} threads, {images} images, files {left}"
    )
    return int(growth > GROWTH or threads > 1 or images > 2 or len(left) > 3)


if __name__ == "__main__":
    sys.exit(main())
