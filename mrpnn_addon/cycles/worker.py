# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders scenes of one .blend file, pass by pass; runs in a separate Blender process without the extension.

Arguments, the last two: the .blend file and a folder. Each line of standard input requests an image: {"scene", "name",
"settings"}, where settings are Cycles' by name, without those that this version lacks. The process writes
FOLDER/NAME.exr and then FOLDER/NAME.json, with wall-clock and processor seconds or an error. It ends with its input.
"""

import json
import os
import sys
import time
from typing import Any

import bpy

# Names of what builds of Blender may lack.
LIBRARIES = {"OPENIMAGEDENOISE": "OpenImageDenoise"}


def main(blend: str, folder: str) -> None:
    libraries: Any = bpy.data.libraries
    with libraries.load(blend) as (found, wanted):
        wanted.scenes = found.scenes
    for line in sys.stdin:
        ask = json.loads(line)
        try:
            answer = render(ask, os.path.join(folder, ask["name"] + ".exr"))
        except (RuntimeError, TypeError) as error:
            answer = {"error": str(error).strip()}
        partial = os.path.join(folder, ask["name"] + ".part")
        with open(partial, "w") as file:
            json.dump(answer, file)
        os.replace(partial, os.path.join(folder, ask["name"] + ".json"))


def render(ask: dict, path: str) -> dict:
    scene = bpy.data.scenes[ask["scene"]]
    # Cycles renders the first file of a volume sequence in a scene that no window has shown at its frame.
    bpy.context.window.scene = scene
    scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    for name, value in ask["settings"].items():
        if hasattr(scene.cycles, name):
            try:
                setattr(scene.cycles, name, value)
            except TypeError:
                raise RuntimeError(f"this Blender was built without {LIBRARIES.get(value, value)}") from None
    scene.render.filepath = path
    wall, processor = time.perf_counter(), time.process_time()
    bpy.ops.render.render(scene=scene.name, write_still=True)
    seconds = {"seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - processor}
    return seconds if os.path.exists(path) else {"error": "Cycles wrote no image"}


if __name__ == "__main__":
    main(*sys.argv[-2:])
