# SPDX-License-Identifier: GPL-3.0-or-later
"""Error and processor seconds of a sky of many clouds, of the layer and of Cycles.

    python -m benchmarks.cycles.skies [--counts 1 64] [--size 192 108] [--samples 128]

So many linked duplicates of one procedural cloud stand beside each other in a sun and a grey World, each with an angle
of its own. Errors are relative RMSE inside the picture of the clouds, against two independent halves of a reference,
whose noise does not count. Seconds are those of all threads: of the layer with reading the scene, of a first frame and
of the next one, of a camera that has moved. *Cycles, denoised* is by OpenImageDenoise.
"""

import argparse
import importlib
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from training.procedural.volumes import make_volume

from ..demo import scene as demo_scene
from ..support.extension import extension
from ..support.ladder import Timed, cycles_pictures, print_rows, rows
from ..support.provenance import made_by

PROGRAM = "benchmarks.cycles.skies"
VOXELS, OPTICAL_DEPTH, ANISOTROPY, SAMPLES = 96, 20.0, 0.5, (4, 16, 64)
#: Edge of a cloud over the distance to its neighbours.
SHARE = 0.7


def stage(path: Path, count: int, size: tuple[int, int]) -> bpy.types.Scene:
    """So many clouds on a square around the origin, which a camera looks down at; path: of a file of the cloud."""
    read_scene = importlib.import_module("mrpnn.mrpnn_addon.scene.reader").read_scene
    scene, cloud, shader = demo_scene.make_scene(path, size, "density", y_up=False)
    demo_scene.fit(scene, cloud, shader, read_scene, OPTICAL_DEPTH)
    bpy.context.view_layer.update()
    across, random = int(np.ceil(np.sqrt(count))), np.random.default_rng(0)
    shader.inputs["Density"].default_value *= across / SHARE
    shader.inputs["Anisotropy"].default_value = ANISOTROPY
    scene.world = bpy.data.worlds.new("Grey")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.3, 0.3, 0.3, 1.0)
    smaller, middle = SHARE / across, cloud.location.copy()
    clouds = [cloud] + [cloud.copy() for _ in range(count - 1)]
    for number, one in enumerate(clouds):
        if number:
            scene.collection.objects.link(one)
        row, column = divmod(number, across)
        one.rotation_euler.z = random.uniform(0.0, 2.0 * np.pi)
        one.scale = smaller * Vector(one.scale)
        turned = middle.copy()
        turned.rotate(one.rotation_euler)
        place = (np.array([column, row]) + 0.5) / across - 0.5
        one.location = Vector((*(demo_scene.EDGE * place), 0.0)) + smaller * turned
    bpy.context.view_layer.update()
    return scene


def layers(scene: bpy.types.Scene) -> Iterator[Timed]:
    """Of a first frame and of the next one."""
    addon = extension()
    cache = addon.inference.RenderCache()
    # The first of all loads the network.
    for name, kept in (("", addon.inference.RenderCache()), ("layer", cache), ("layer, next frame", cache)):
        start = time.process_time()
        found = addon.mrpnn_addon.scene.reader.read_scene(bpy.context.evaluated_depsgraph_get())
        settings = addon.inference.Settings()
        if name.endswith("next frame"):
            found.camera.world_matrix[:3, 3] += 1e-3 * found.camera.world_matrix[:3, 0]
        layer = addon.inference.render(found.volumes, found.lights, found.camera, settings, cache=kept)
        if name:
            yield name, layer.rgb, time.process_time() - start


def main(options: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 64], help="clouds")
    parser.add_argument("--size", type=int, nargs=2, default=(192, 108))
    parser.add_argument("--samples", type=int, default=128, help="of each half of the references")
    arguments = parser.parse_args(options)
    extension()
    load_openvdb = importlib.import_module("mrpnn.mrpnn_addon.vdb.openvdb_module").load_openvdb

    def measured(folder: str) -> Iterator[list[str]]:
        path = Path(folder) / "cloud.vdb"
        demo_scene.write_grid(path, make_volume(demo_scene.CLOUD_SEED, VOXELS).density, load_openvdb())
        for count in arguments.counts:
            scene = stage(path, count, tuple(arguments.size))
            pictures = (*layers(scene), *cycles_pictures(scene, SAMPLES))
            yield from rows(f"{count} clouds" if count > 1 else "a cloud", scene, arguments.samples, pictures)

    with tempfile.TemporaryDirectory() as folder:
        print_rows(measured(folder))
    print("\n" + made_by(PROGRAM, options))


if __name__ == "__main__":
    main()
