# SPDX-License-Identifier: GPL-3.0-or-later
"""Error and processor seconds of blurred pictures, of the layer and of Cycles.

    python -m benchmarks.cycles.blur [--size 192] [--samples 384]

OpenVDB's smoke, thin enough for Cycles' references to converge: out of focus, in focus before a second one out of
focus, moving past a camera that stands, and before a camera that moves. *Without blur* is the same scene without lens
and motion, against a reference of its own. Errors are relative RMSE inside the picture of the smoke, against two
independent halves of a reference, whose noise does not count. Seconds are those of all threads, of a first frame: of
the layer with reading the scene. *Cycles, denoised* is by OpenImageDenoise.
"""

import argparse
import importlib
import time
from collections.abc import Iterator

import bpy

from ..demo import scene as demo_scene
from ..support.data import volume_file
from ..support.extension import extension
from ..support.ladder import Timed, cycles_pictures, print_rows, rows
from ..support.provenance import made_by

PROGRAM = "benchmarks.cycles.blur"
SMOKE, OPTICAL_DEPTH, FRAME = "openvdb_smoke.vdb", 4.0, 10
SCENES = "out of focus", "one in focus before one out of focus", "moving smoke", "moving camera"
BLUR_RAYS, CYCLES_SAMPLES = (4, 16), (4, 16, 64)


def stage(blur: str, size: int) -> bpy.types.Scene:
    """One of SCENES."""
    read_scene = importlib.import_module("mrpnn.mrpnn_addon.scene.reader").read_scene
    scene, smoke, shader = demo_scene.make_scene(volume_file(SMOKE), (size, size), "density", y_up=True)
    shader.inputs["Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    demo_scene.fit(scene, smoke, shader, read_scene, OPTICAL_DEPTH)
    bpy.context.view_layer.update()
    camera, height = scene.camera, demo_scene.EDGE
    if blur.endswith("out of focus"):
        lens, distance = camera.data.dof, camera.matrix_world.translation.length
        lens.use_dof, lens.focus_distance = True, 0.6 * distance
        if blur != "out of focus":
            lens.focus_distance = distance
            behind = smoke.copy()
            scene.collection.objects.link(behind)
            axes = camera.matrix_world.to_3x3()
            behind.location += 0.2 * height * axes.col[0] - 0.7 * distance * axes.col[2]
        # The circle of confusion is about a fourteenth of the smoke.
        lens.aperture_fstop = camera.data.lens * 1e-3 / (2.0 * 0.05 * height)
    else:
        scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
        moving = smoke if blur == "moving smoke" else camera
        across = camera.matrix_world.to_3x3().col[0] * 0.15 * height
        middle = moving.location.copy()
        # As fast at every time of the shutter.
        bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"
        for frame, side in ((FRAME - 1, -1.0), (FRAME + 1, 1.0)):
            moving.location = middle + side * across
            moving.keyframe_insert("location", frame=frame)
    scene.frame_set(FRAME)
    return scene


def layers(scene: bpy.types.Scene) -> Iterator[Timed]:
    """For each of BLUR_RAYS."""
    addon = extension()
    kept_frame = importlib.import_module("mrpnn.mrpnn_addon.scene.kept_frame")
    for rays in (BLUR_RAYS[0], *BLUR_RAYS):
        start = time.process_time()
        found = addon.mrpnn_addon.scene.reader.read_frame(
            bpy.context.evaluated_depsgraph_get(), go_to=kept_frame.goes_to(scene)
        )
        settings = addon.inference.Settings(blur_rays=rays)
        layer = addon.inference.render(found.volumes, found.lights, found.camera, settings, surfaces=found.surfaces)
        yield f"layer, {rays} rays", layer.rgb, time.process_time() - start


def measured(blur: str, size: int, samples: int) -> Iterator[list[str]]:
    """The rows of the table for one scene."""
    scene = stage(blur, size)
    # The first loads the network.
    _, *found = layers(scene)
    yield from rows(blur, scene, samples, (*found, *cycles_pictures(scene, CYCLES_SAMPLES)))
    scene.render.use_motion_blur = scene.camera.data.dof.use_dof = False
    _, (_, picture, seconds), *_ = layers(scene)
    yield from rows(blur, scene, samples, [("layer, without blur", picture, seconds)])


def main(options: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=192, help="pixels per edge")
    parser.add_argument("--samples", type=int, default=384, help="of each half of the references")
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=SCENES)
    arguments = parser.parse_args(options)
    extension()
    print_rows(row for blur in arguments.scenes for row in measured(blur, arguments.size, arguments.samples))
    print("\n" + made_by(PROGRAM, options))


if __name__ == "__main__":
    main()
