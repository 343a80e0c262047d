# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light in EEVEE, from the baked camera and from one turned by 40 degrees, against layers.

    python -m benchmarks.cycles.baked_eevee [--blender COMMAND] [--folder FOLDER] [--size 64] [--window]

COMMAND starts a Blender that has a graphics driver, and sees the folder under the same name. With --window it has a
display, too, and frames per second of the viewport are measured while the camera turns. Needs bpy, which makes the
scene and reads the pictures.
"""

import argparse
import math
import re
import shlex
import subprocess
import tempfile
import time
from pathlib import Path

PROGRAM = "benchmarks.cycles.baked_eevee"
DISTANCE, DEGREES = 6.0, {"compiling": 0.0, "baked view": 0.0, "beside": 40.0}
SAMPLES, STEPS, THICKNESS = 16, 128, 20.0
# Redraws of the viewport along the orbit, and before they are timed.
FRAMES, BEFORE = 6, 2


def turn(camera, name: str) -> None:
    """Put the camera where a picture is taken from."""
    angle = math.radians(DEGREES[name])
    camera.location = DISTANCE * math.sin(angle), 0.0, DISTANCE * math.cos(angle)
    camera.rotation_euler = 0.0, angle, 0.0


def pictures() -> None:
    """Render the opened file in EEVEE: what the other Blender runs."""
    import bpy

    scene = bpy.context.scene
    engines = type(scene.render).bl_rna.properties["engine"].enum_items.keys()
    scene.render.engine = next(name for name in engines if name.startswith("BLENDER_EEVEE"))
    scene.render.film_transparent = True
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    eevee = scene.eevee
    eevee.taa_render_samples, eevee.volumetric_tile_size, eevee.volumetric_samples = SAMPLES, "2", STEPS
    eevee.volumetric_start, eevee.volumetric_end = DISTANCE / 2.0, 1.5 * DISTANCE
    eevee.use_volumetric_shadows, eevee.volumetric_shadow_samples = True, STEPS // 2
    for name in DEGREES:
        turn(scene.camera, name)
        scene.render.filepath = bpy.path.abspath(f"//{name}.exr")
        start, processor = time.perf_counter(), time.process_time()
        bpy.ops.render.render(write_still=True)
        print(
            f"EEVEE of {bpy.app.version_string}, {name}: {time.perf_counter() - start:.1f} s, "
            f"{time.process_time() - processor:.1f} processor seconds",
            flush=True,
        )


def viewport() -> None:
    """Turn the camera in the viewport and end Blender: what the other Blender runs in its window."""
    import bpy

    window = bpy.context.window_manager.windows[0]
    area = max(window.screen.areas, key=lambda one: one.width * one.height)
    area.type = "VIEW_3D"
    space, scene = area.spaces.active, bpy.context.scene
    space.shading.type, space.overlay.show_overlays = "RENDERED", False
    space.shading.use_scene_lights_render = space.shading.use_scene_world_render = True
    space.region_3d.view_perspective = "CAMERA"
    region = next(one for one in area.regions if one.type == "WINDOW")
    # Blender's usual values.
    for name in ("volumetric_tile_size", "volumetric_samples", "volumetric_shadow_samples"):
        scene.eevee.property_unset(name)
    for lit in True, False:
        for shown in scene.objects:
            if "mrpnn_light" in shown:
                shown.hide_viewport = not lit
        with bpy.context.temp_override(window=window, screen=window.screen, area=area, region=region):
            for number in range(BEFORE + FRAMES):
                if number == BEFORE:
                    start, processor = time.perf_counter(), time.process_time()
                angle = math.radians(DEGREES["beside"]) * number / (BEFORE + FRAMES - 1)
                scene.camera.location = DISTANCE * math.sin(angle), 0.0, DISTANCE * math.cos(angle)
                scene.camera.rotation_euler = 0.0, angle, 0.0
                bpy.ops.wm.redraw_timer(type="DRAW_SWAP", iterations=1)
        seconds, processor = (
            now() - then for now, then in ((time.perf_counter, start), (time.process_time, processor))
        )
        print(
            f"EEVEE's viewport of {region.width} x {region.height} pixels, {'with' if lit else 'without'} baked light: "
            f"{FRAMES / seconds:.2f} frames per second, {processor / FRAMES:.2f} processor seconds per frame",
            flush=True,
        )
    bpy.ops.wm.quit_blender()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--blender", default="blender")
    parser.add_argument("--folder", type=Path, default=None)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--window", action="store_true")
    options = parser.parse_args()
    from ..support.extension import extension
    from ..support.provenance import made_by

    extension()
    import bpy
    import numpy as np
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    from inference import Settings, render
    from tests.support import blender_scenes as scenes

    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        scene = scenes.empty_scene()
        scene.render.resolution_x = scene.render.resolution_y = options.size
        scenes.cloud_scene(scene, folder, density=THICKNESS / 2.0)
        scene.camera.data.angle = 0.5
        bpy.ops.mrpnn.bake_light(folder=str(folder))
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "lit.blend"))
        script = folder / "pictures.py"
        calls = "\n\npictures()\n" + "viewport()\n" * options.window
        script.write_text(Path(__file__).read_text().replace('__name__ == "__main__"', "False") + calls)
        started = [*shlex.split(options.blender), *["-b"][options.window :]]
        started += ["--factory-startup", "--gpu-backend", "opengl"]
        started += [str(folder / "lit.blend"), "--python-exit-code", "1", "--python", str(script)]
        said = subprocess.run(started, capture_output=True, text=True, check=True).stdout
        [version], viewports = (
            set(re.findall(r"EEVEE of (\S+)", said)),
            re.findall(r"EEVEE's (viewport .*): .* (\S+) processor", said),
        )
        print(f"| EEVEE of {version} | error | bias | processor seconds |\n|---|---|---|---|")
        for name in list(DEGREES)[1:]:
            turn(scene.camera, name)
            described = read_scene(scenes.depsgraph())
            layer = render(described.volumes, described.suns, described.camera, Settings(16))
            image = bpy.data.images.load(str(folder / f"{name}.exr"))
            pixels = np.empty(options.size * options.size * 4, np.float32)
            image.pixels.foreach_get(pixels)
            shown = layer.alpha > 0.02
            change = (pixels.reshape(options.size, options.size, 4)[::-1, :, :3] - layer.rgb)[shown]
            mean = layer.rgb[shown].mean()
            figures = f"{np.sqrt(np.mean(change**2)) / mean:.3f} | {100 * change.mean() / mean:+.1f} %"
            [seconds] = re.findall(rf"{name}: .*, (\S+) processor seconds", said)
            print(f"| {name} | {figures} | {seconds} |", flush=True)
        for name, seconds in viewports:
            print(f"| a frame of the {name} | | | {seconds} |", flush=True)
        print(made_by(PROGRAM))


if __name__ == "__main__":
    main()
