# SPDX-License-Identifier: GPL-3.0-or-later
"""What a newcomer meets: a .vdb file as Blender imports it, in one sun, with every default.

    python -m benchmarks.cost.imported_smoke [--percentage 100] [--figures docs/tables/readme.csv]

`openvdb_smoke.vdb` is 107 m high then, with a density of 1: its optical thickness is above 1000. Prints the seconds of
an F12 of 1920 × 1080 pixels in background, and how much of the picture the smoke covers.
"""

import argparse
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from PIL import Image

from ..support.data import VOLUMES
from ..support.extension import extension
from ..support.pages import record
from ..support.provenance import made_by

PROGRAM = "benchmarks.cost.imported_smoke"
NAME = "openvdb_smoke.vdb"
# Towards the camera, its distance in metres and its focal length in millimetres.
VIEW, DISTANCE, LENS = Vector((1.0, -1.0, 0.25)).normalized(), 200.0, 50.0


def make_scene(percentage: int):
    """Import the volume and light it; nothing else is changed from what Blender makes."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.object.volume_import(filepath=str(VOLUMES / NAME), files=[{"name": NAME}], directory=f"{VOLUMES}/")
    smoke, scene = bpy.context.object, bpy.context.scene
    material = bpy.data.materials.new("Smoke")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = (tree.nodes.new(kind) for kind in ("ShaderNodeVolumePrincipled", "ShaderNodeOutputMaterial"))
    tree.links.new(shader.outputs[0], output.inputs["Volume"])
    smoke.data.materials.append(material)
    scene.world = bpy.data.worlds.new("Black")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    for name, data in (("Sun", bpy.data.lights.new("Sun", "SUN")), ("Camera", bpy.data.cameras.new("Camera"))):
        scene.collection.objects.link(bpy.data.objects.new(name, data))
    sun, camera = bpy.data.objects["Sun"], bpy.data.objects["Camera"]
    sun.data.energy, sun.rotation_euler = 3.0, (0.8, 0.2, 0.4)
    bpy.context.view_layer.update()
    middle = sum((smoke.matrix_world @ Vector(corner) for corner in smoke.bound_box), Vector()) / 8
    camera.location, camera.rotation_euler = middle + DISTANCE * VIEW, (-VIEW).to_track_quat("-Z", "Y").to_euler()
    camera.data.lens, camera.data.clip_end = LENS, 1000.0
    scene.camera, scene.render.engine, scene.mrpnn.depth_samples = camera, "MRPNN", 4
    scene.render.resolution_x, scene.render.resolution_y = 1920, 1080
    scene.render.resolution_percentage, scene.render.film_transparent = percentage, True
    return scene


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.splitlines()[0])
    parser.add_argument("--percentage", type=int, default=100, help="of the resolution")
    parser.add_argument("--figures", type=Path, help="file to enter the figures into")
    chosen = parser.parse_args(arguments)
    extension()
    scene = make_scene(chosen.percentage)
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "smoke.png")
        start, processor = time.perf_counter(), time.process_time()
        bpy.ops.render.render(write_still=True)
        seconds, processor = time.perf_counter() - start, time.process_time() - processor
        with Image.open(scene.render.filepath) as picture:
            covered = np.mean(np.array(picture)[..., 3] > 5)
    print(f"{seconds:.0f} s, {processor:.0f} processor seconds, {covered:.0%} of the picture covered")
    print(made_by(PROGRAM, arguments))
    if chosen.figures:
        record(chosen.figures, made_by(PROGRAM, arguments), {"smoke, processor seconds": processor, "covered": covered})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
