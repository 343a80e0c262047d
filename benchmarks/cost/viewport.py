# SPDX-License-Identifier: GPL-3.0-or-later
"""How soon the viewport's preview shows a picture: seconds to its first and to its last one.

    python -m benchmarks.cost.viewport [--size 480 270] [--voxels 128] [--depth-samples 8]

A procedural cloud in Blender lit by one sun. Each row is a change and the pictures that follow, with the render cache
of the rows before. "Clock" is wall-clock seconds; "processor" is processor seconds of all threads, which a busy machine
affects less; "share" is the processor seconds to the first picture over those of a whole render of the same view
without a cache, in the same run; "read" is what Blender waits for, the reading of the scene, by the clock.
"""

import argparse
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import bpy

from training.procedural.volumes import make_volume

from ..demo.scene import CLOUD_SEED, fit, make_scene, write_grid
from ..support.extension import load_extension
from ..support.provenance import made_by

PROGRAM = "benchmarks.cost.viewport"
OPTICAL_DEPTH = 40.0


def clock():
    return time.perf_counter(), time.process_time()


def since(start):
    """(wall, processor) seconds since a reading of `clock`."""
    return tuple(now - then for now, then in zip(clock(), start))


def pictures(addon, description, camera, settings, prepared):
    """(wall, processor) seconds to the first and to the last picture of a preview."""
    start, first = clock(), None
    preview = addon.mrpnn_addon.engine.preview.Preview(description, camera, settings, prepared)
    while not preview.done:
        if first is None and preview.number:
            first = since(start)
        time.sleep(0.001)
    assert not preview.message, preview.message
    return first or since(start), since(start)


def measure(addon, size, voxels: int, depth_samples: int, folder: str) -> None:
    """Print the table."""
    package = addon.mrpnn_addon
    path = Path(folder) / "cloud.vdb"
    write_grid(path, make_volume(CLOUD_SEED, voxels).density, package.vdb.openvdb_module.load_openvdb())
    scene, volume, shader = make_scene(path, size, "density", y_up=False)
    fit(scene, volume, shader, package.scene.reader.read_scene, OPTICAL_DEPTH)
    sun = next(item for item in scene.objects if item.type == "LIGHT")
    reader = package.volumes.reader.VolumeReader()
    prepared = package.engine.preview.Prepared(addon.inference.RenderCache())

    def read():
        bpy.context.view_layer.update()
        start = clock()
        description = package.scene.reader.read_scene(bpy.context.evaluated_depsgraph_get(), reader)
        return description, since(start)

    description, opened = read()
    camera, settings = description.camera, addon.inference.Settings(depth_samples)
    rows = [("opened", *pictures(addon, description, camera, settings, prepared))]
    turned = replace(camera, fov=0.9 * camera.fov)
    rows.append(("view turned", *pictures(addon, description, turned, settings, prepared)))
    more = replace(settings, depth_samples=2 * depth_samples)
    rows.append(("depth samples doubled", *pictures(addon, description, turned, more, prepared)))
    sun.rotation_euler.x += 0.3
    description, again = read()
    rows.append(("sun turned", *pictures(addon, description, turned, settings, prepared)))
    shader.inputs["Density"].default_value *= 0.8
    reader = package.volumes.reader.VolumeReader()
    description, shaded = read()
    rows.append(("density changed", *pictures(addon, description, turned, settings, prepared)))
    start = clock()
    addon.inference.render(description.volumes, description.lights, turned, settings)
    whole = since(start)

    print(f"{size[0]} x {size[1]} pixels, {voxels}^3 voxels, {depth_samples} depth samples, {os.cpu_count()} cores")
    print(
        "| change | read | first picture, clock | first picture, processor | share "
        "| last picture, clock | last picture, processor |"
    )
    print("|---|---|---|---|---|---|---|")
    waited = {"opened": opened, "sun turned": again, "density changed": shaded}
    for name, first, last in rows:
        read = f"{waited[name][0]:.2f} s" if name in waited else ""
        print(
            f"| {name} | {read} | {first[0]:.2f} s | {first[1]:.2f} s | {first[1] / whole[1]:.0%} "
            f"| {last[0]:.2f} s | {last[1]:.2f} s |"
        )
    print(f"| whole render, no cache | | | | | {whole[0]:.2f} s | {whole[1]:.2f} s |")


def main():
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, nargs=2, default=(480, 270), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--voxels", type=int, default=128)
    parser.add_argument("--depth-samples", type=int, default=8)
    arguments = parser.parse_args()
    addon = load_extension()
    try:
        with tempfile.TemporaryDirectory() as folder:
            measure(addon, tuple(arguments.size), arguments.voxels, arguments.depth_samples, folder)
        print(made_by(PROGRAM))
    finally:
        addon.unregister()


if __name__ == "__main__":
    main()
