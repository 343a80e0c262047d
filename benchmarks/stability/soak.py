"""Many renders in one Blender process: does memory grow?

    python -m benchmarks.stability.soak [--renders 200] [--figures docs/soak.csv]

Renders a small cloud by the operator, its sun, density, size and number of depth samples changing, and an animation
frame by the engine now and then. Prints the process's resident memory after each tenth and writes the figures.
Exit status 1 where all of the last tenth need more than 5 % more than the first half ever did, since what is not given
back stays, or threads or images are left.
"""

import argparse
import csv
import pathlib
import resource
import sys
import tempfile
import threading

import bpy

from tests import blender_scenes

from ..support.extension import load_extension

DOCS = pathlib.Path(__file__).resolve().parents[2] / "docs"
GROWTH = 1.05


def resident() -> float:
    """MiB that this process holds in memory now."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


def vary(scene, number: int) -> None:
    """Another picture than the one before."""
    scene.render.resolution_x = 16 + 8 * (number % 3)
    scene.mrpnn.depth_samples = 1 + number % 4
    bpy.data.objects["Sun"].rotation_euler.x = 0.1 * number
    shader = bpy.data.materials[0].node_tree.nodes["Principled Volume"]
    shader.inputs["Density"].default_value = 1.0 + number % 5
    bpy.context.view_layer.update()


def main(options=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--renders", type=int, default=200)
    parser.add_argument("--figures", type=pathlib.Path, default=DOCS / "soak.csv")
    arguments = parser.parse_args(options)
    package = load_extension()
    scene = blender_scenes.empty_scene()
    held = []
    with tempfile.TemporaryDirectory() as folder:
        blender_scenes.cloud_scene(scene, pathlib.Path(folder))
        scene.render.resolution_y, scene.render.filepath = 16, folder + "/frame"
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
    with open(arguments.figures, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["render", "resident MiB"])
        writer.writerows([n + 1, f"{size:.1f}"] for n, size in enumerate(held))
    half = len(held) // 2
    growth = min(held[-max(len(held) // 10, 1):]) / max(held[:half])
    print(f"least of the last tenth over the first half's most: {growth:.3f}; {threads} threads, {images} images, files {left}")
    return int(growth > GROWTH or threads > 1 or images > 2 or len(left) > 3)


if __name__ == "__main__":
    sys.exit(main())
