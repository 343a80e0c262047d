# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the gallery: scenes, pictures, and the page docs/use/gallery.md.

    python -m gallery [noon dusk ...] [--size 960 540] [--detail 1] [--compare 320 180] [--reference 150] [--docs]
        [--untimed]

Writes OUT/NAME.blend, its .vdb files in OUT/volumes and its picture OUT/NAME.png. With --compare it renders a smaller
picture beside Cycles with 1024 bounces, denoised, in the same processor seconds. --reference measures both against
two renders by Cycles of about so many processor seconds each. --docs puts pictures and figures into the docs, and
writes the page. --untimed states ratios in place of seconds, for a machine that does other work as well. --templates
makes the scenes without pictures, and of them OUT/mrpnn-gallery.zip: application templates, which Blender lists in
File > New. Needs bpy.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import bpy

from benchmarks.support.extension import ROOT, extension

from .scenes import SCENES


def make(name: str, out: Path, detail: float):
    """Make a scene and save it as OUT/NAME.blend; gives Blender's scene."""
    scene = SCENES[name].make(out / "volumes", detail)
    bpy.ops.wm.save_as_mainfile(filepath=str(out / f"{name}.blend"), compress=True)
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_mainfile(compress=True)
    return scene


def compare(name: str, out: Path, options) -> dict:
    """A small picture beside Cycles' in the same processor seconds: OUT/NAME-cycles.png; gives the figures."""
    from benchmarks.support.pictures import row

    from . import pictures

    width, height = options.compare

    def opened():
        bpy.ops.wm.open_mainfile(filepath=str(out / f"{name}.blend"))
        scene = bpy.context.scene
        scene.render.resolution_x, scene.render.resolution_y = width, height
        scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = False
        # Both go through the pixels' centres, so that the blur of edges is no error of either.
        scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
        return scene

    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        paths = folder / "ours.png", folder / "cycles.png"
        own, seconds = pictures.ours(opened(), paths[0], folder)
        other, others, samples = pictures.cycles(opened(), paths[1], seconds)
        figures = {"Cycles' samples": str(samples)}
        if not options.untimed:
            figures |= {"seconds": f"{seconds:.1f}", "Cycles' seconds": f"{others:.1f}"}
        if options.reference:
            halves = max(8, round(samples * options.reference / others))
            errors = pictures.errors(opened(), paths, folder, halves)
            figures |= {"error": errors[0], "Cycles' error": errors[1], "reference's samples": f"2 x {halves}"}
    captions = f"this extension, {seconds:.0f} processor seconds", f"Cycles, {others:.0f} processor seconds"
    if options.untimed:
        captions = "this extension", f"Cycles, {others / seconds:.2g} times as long"
    row(list(zip(captions, (own, other))), height, 12).save(out / f"{name}-cycles.png")
    return figures


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gallery", description=__doc__.split("\n\n")[0])
    parser.add_argument("names", nargs="*", metavar="scene", help=f"of {', '.join(SCENES)}; all by default")
    parser.add_argument("--size", type=int, nargs=2, default=(960, 540), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--detail", type=float, default=1.0, help="of the volumes: 0.5 for voxels of twice the size")
    parser.add_argument("--compare", type=int, nargs=2, metavar=("WIDTH", "HEIGHT"), help="size of pictures by Cycles")
    parser.add_argument("--reference", type=float, default=0.0, metavar="SECONDS", help="of each half of a reference")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "gallery", help="folder to write to")
    parser.add_argument("--docs", action="store_true", help="put pictures and page into docs")
    parser.add_argument("--untimed", action="store_true", help="state ratios in place of seconds")
    parser.add_argument(
        "--templates", action="store_true", help="zip the scenes as application templates, without pictures"
    )
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if name not in SCENES]
    if unknown:
        print(f"no such scene: {', '.join(unknown)}; there are {', '.join(SCENES)}", file=sys.stderr)
        return 2
    extension()
    from . import page, pictures, templates

    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    for name in options.names or SCENES:
        scene = make(name, out, options.detail)
        if options.templates:
            continue
        scene.render.resolution_x, scene.render.resolution_y = options.size
        kind = pictures.way(scene)
        _, seconds = pictures.ours(scene, out / f"{name}.png", out / "light" / name)
        figures = {"way": kind, "pixels": "{} x {}".format(*options.size)}
        if not options.untimed:
            figures["picture's seconds"] = f"{seconds:.0f}"
        if options.compare:
            figures |= compare(name, out, options)
        print(name, figures, flush=True)
        if options.docs:
            page.enter(name, out, figures, arguments)
    if options.docs:
        page.write()
    if options.templates:
        print(templates.pack(out, options.names or SCENES))
    return 0


if __name__ == "__main__":
    sys.exit(main())
