"""A film of a volume sequence, and how far its frames are from Cycles.

    python -m benchmarks.film [--files ../shared/volumes/plume] [--out build/film] [--compare 3]

Renders one frame for each numbered .vdb file of a folder, by the extension in Blender, to OUT/NNNN.exr and OUT/NNNN.png, puts
them together as OUT/film.webp, and compares some of them with Cycles. Figures go to OUT/film.json.
"""

import argparse
import atexit
import json
import os
import re
import sys
import time
from pathlib import Path

import bpy
import numpy as np

from . import demo_scene, pictures
from .demo import pixels
from .extension import ROOT, load_extension

PLUME = ROOT.parent / "shared" / "volumes" / "plume"
FRAMES_A_SECOND = 12


def make_film(files, options) -> dict:
    """Render and compare; gives the figures by frame."""
    from mrpnn.mrpnn_addon.scene import read_scene

    scene, volume, shader = demo_scene.make_scene(files[0], options.size, options.grid, y_up=True)
    scene.world = scene.world or bpy.data.worlds.new("World")
    shader.inputs["Anisotropy"].default_value = 0.5
    # Framed and made as dense as the last and largest file, for all frames alike.
    volume.data.filepath = str(files[-1])
    demo_scene.fit(scene, volume, shader, read_scene, options.optical_depth)
    volume.data.filepath = str(files[0])
    first = int(re.search(r"(\d+)$", files[0].stem).group())
    volume.data.is_sequence, volume.data.frame_duration = True, len(files)
    volume.data.frame_start, volume.data.frame_offset = 1, first - 1
    scene.frame_start, scene.frame_end = 1, len(files)
    scene.mrpnn.depth_samples = options.depth_samples
    compared = set(np.linspace(1, len(files), options.compare).round().astype(int)) if options.compare else ()
    results, shown = {}, []
    for frame in range(1, len(files) + 1):
        scene.frame_set(frame)
        start = time.perf_counter()
        bpy.ops.mrpnn.render(filepath=str(options.out / f"{frame:04}.exr"))
        found = {"file": files[frame - 1].name, "seconds": time.perf_counter() - start}
        picture = pictures.view_transformed(pictures.over_sky(pixels("MRPNN")), scene)
        picture.save(options.out / f"{frame:04}.png")
        shown.append(picture)
        if frame in compared:
            found.update(_compare(options, frame))
        results[frame] = found
        print(f"frame {frame}: {found}", file=sys.stderr, flush=True)
    shown[0].save(options.out / "film.webp", save_all=True, append_images=shown[1:], loop=0,
                  duration=round(1000 / FRAMES_A_SECOND), lossless=True)
    return results


def _compare(options, frame: int) -> dict:
    folder = options.out / f"{frame:04}-comparison"
    bpy.ops.mrpnn.compare(samples=options.samples, scale=options.scale, ladder=0, budget=0.0, folder=str(folder))
    found = json.loads((folder / "figures.json").read_text())
    return {name: found[name]["value"] for name in ("rmse", "bias", "alpha_bias")}


def parse(arguments):
    parser = argparse.ArgumentParser(prog="python -m benchmarks.film", description=__doc__.split("\n\n")[0])
    parser.add_argument("--files", type=Path, default=PLUME, help="folder of numbered .vdb files")
    parser.add_argument("--grid", default="density", help="name of the density grid (density)")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "film")
    parser.add_argument("--size", type=int, nargs=2, default=(192, 256), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--depth-samples", type=int, default=16)
    parser.add_argument("--optical-depth", type=float, default=40.0, help="of the longest edge at its densest (40)")
    parser.add_argument("--compare", type=int, default=3, help="frames to compare with Cycles (3)")
    parser.add_argument("--scale", type=int, default=50, help="size of the comparison in per cent (50)")
    parser.add_argument("--samples", type=int, default=24, help="a pixel in each of two Cycles renders (24)")
    return parser.parse_args(arguments)


def main(arguments=None) -> int:
    options = parse(arguments)
    options.out = options.out.resolve()
    files = sorted(path.resolve() for path in options.files.glob("*.vdb"))
    if not files:
        print(f"no .vdb files in {options.files}", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    atexit.register(load_extension().unregister)
    results = make_film(files, options)
    partial = options.out / f".film.{os.getpid()}.part"
    partial.write_text(json.dumps(results, indent=1) + "\n")
    os.replace(partial, options.out / "film.json")
    return 0


if __name__ == "__main__":
    sys.exit(main())
