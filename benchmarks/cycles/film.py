# SPDX-License-Identifier: GPL-3.0-or-later
"""A film of a volume sequence, and how far its frames are from Cycles: makes docs/film.md.

    python -m benchmarks.cycles.film [--files FOLDER] [--out build/film] [--compare 3]

Renders one frame for each numbered .vdb file of a folder, by the extension in Blender, to OUT/NNNN.exr and
OUT/NNNN.png, puts them together as OUT/film.webp, and compares some of them with Cycles. Measures how much the film
flickers, and by how much a frame changes where nothing in the scene does. Figures go to OUT/film.json. Without --files
it takes the plume that benchmarks/data/README.md names, which the repository may not contain.
"""

import argparse
import json
import re
import sys
import time
from pathlib import Path

import bpy
import numpy as np

from ..demo import scene as demo_scene
from ..support import pictures
from ..support.data import EXTRA_VOLUMES
from ..support.extension import ROOT, extension
from ..support.pages import replace
from ..support.provenance import made_by

PROGRAM = "benchmarks.cycles.film"
PLUME = EXTRA_VOLUMES / "plume"
PAGE = ROOT / "docs" / "film.md"
STRIP, STRIP_HEIGHT = ROOT / "docs" / "images" / "film.png", 160
FRAMES_PER_SECOND = 12
#: Depth samples of a converged layer.
CONVERGED = 64


def make_film(files, options) -> dict:
    """Render and compare; gives the figures by frame, and of steadiness."""
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    scene, volume, shader = demo_scene.make_scene(files[0], options.size, options.grid, y_up=True)
    # The sun alone: each direction of a World's light would take as long as the sun.
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    shader.inputs["Anisotropy"].default_value = 0.5
    # Every frame is framed, and as dense, as the last and largest file asks for.
    volume.data.filepath = str(files[-1])
    demo_scene.fit(scene, volume, shader, read_scene, options.optical_depth)
    volume.data.filepath = str(files[0])
    first = int(re.search(r"(\d+)$", files[0].stem).group())
    volume.data.is_sequence, volume.data.frame_duration = True, len(files)
    volume.data.frame_start, volume.data.frame_offset = 1, first - 1
    scene.frame_start, scene.frame_end = 1, len(files)
    scene.mrpnn.depth_samples = options.depth_samples
    compared = set(np.linspace(1, len(files), options.compare).round().astype(int)) if options.compare else ()
    results, shown, strip = {}, [], []
    for frame in range(1, len(files) + 1):
        scene.frame_set(frame)
        start = time.perf_counter()
        bpy.ops.mrpnn.render(filepath=str(options.out / f"{frame:04}.exr"))
        found = {"file": files[frame - 1].name, "seconds": time.perf_counter() - start}
        picture = pictures.view_transformed(pictures.over_sky(pictures.pixels("MRPNN")), scene)
        picture.save(options.out / f"{frame:04}.png")
        shown.append(picture)
        if frame in compared:
            found.update(_compare(options, frame))
            strip += [(f"{frame}, ours", picture), (f"{frame}, Cycles", _cycles_picture(scene))]
        results[frame] = found
        print(f"frame {frame}: {found}", file=sys.stderr, flush=True)
    shown[0].save(
        options.out / "film.webp",
        save_all=True,
        append_images=shown[1:],
        loop=0,
        duration=round(1000 / FRAMES_PER_SECOND),
        lossless=True,
    )
    if strip:
        pictures.row(strip, STRIP_HEIGHT).save(STRIP)
    still = steadiness(read_scene(bpy.context.evaluated_depsgraph_get()), options)
    return {"frames": results, "flicker": flicker(scene, read_scene, options), "steadiness": still}


def flicker(scene, read_scene, options) -> dict:
    """How much more a pixel changes from frame to frame than in a converged layer: root mean square over the mean.

    The difference between the film's layer and one of CONVERGED depth samples without approximations, from each frame
    to the next, where either shows the volume. "the film itself": how much the converged layer changes.
    """
    from mrpnn import inference
    from mrpnn.inference.scene.optimizations import ALL

    usual = inference.Settings(depth_samples=options.depth_samples)
    exact = inference.Settings(depth_samples=CONVERGED, leave_out=ALL - {"shared_pixels"})
    scene.render.resolution_percentage = options.scale
    beyond, itself, mean, pixels, last = 0.0, 0.0, 0.0, 0, None
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        described = read_scene(bpy.context.evaluated_depsgraph_get())
        layer, converged = (
            inference.render(described.volumes, described.lights, described.camera, settings)
            for settings in (usual, exact)
        )
        if last:
            shown = (last[2] > 0.02) | (converged.alpha > 0.02)
            error, change = layer.rgb - converged.rgb - last[0], converged.rgb - last[1]
            beyond, itself = beyond + (error[shown] ** 2).sum(), itself + (change[shown] ** 2).sum()
            mean, pixels = mean + converged.rgb[shown].sum(), pixels + 3 * shown.sum()
        last = layer.rgb - converged.rgb, converged.rgb, converged.alpha
        print(f"flicker: frame {frame}", file=sys.stderr, flush=True)
    scene.render.resolution_percentage = 100
    return {
        name: float(np.sqrt(squares / pixels) / (mean / pixels))
        for name, squares in (("beyond a converged layer", beyond), ("the film itself", itself))
    }


def steadiness(described, options) -> dict:
    """How much a frame changes where nothing in the scene does: root mean square over its mean.

    "again": rendered a second time. Others: with a voxel of almost no density beyond one face of the grid, which gives
    another working cube.
    """
    from mrpnn import inference

    (volume, medium), *_ = described.volumes
    density = np.array(volume.density)

    def image(values):
        pairs = [(inference.Volume(values, volume.world_from_index, volume.name), medium)]
        return inference.render(
            pairs, described.lights, described.camera, inference.Settings(depth_samples=options.depth_samples)
        )

    first = image(density)
    mask = first.alpha > 0.02

    def change(layer):
        return float(np.sqrt(((layer.rgb - first.rgb)[mask] ** 2).mean()) / first.rgb[mask].mean())

    found = {"again": change(image(density))}
    for axis, name in enumerate("xyz"):
        grown = np.pad(density, [(0, 1) if a == axis else (0, 0) for a in range(3)])
        middle = [n // 2 for n in density.shape]
        middle[axis] = density.shape[axis]
        grown[tuple(middle)] = 1e-6 * density.max()
        found[f"a voxel more along {name}"] = change(image(grown))
    return found


def _cycles_picture(scene):
    return pictures.view_transformed(pictures.over_sky(pictures.pixels("MRPNN Cycles")), scene)


def _compare(options, frame: int) -> dict:
    folder = options.out / f"{frame:04}-comparison"
    bpy.ops.mrpnn.compare(samples=options.samples, scale=options.scale, ladder=0, budget=0.0, folder=str(folder))
    found = json.loads((folder / "figures.json").read_text())
    return {name: found[name]["value"] for name in ("rmse", "bias", "alpha_bias")}


def page(found, options) -> str:
    """The page's text."""
    frames, compared = found["frames"], [frame for frame in found["frames"].values() if "rmse" in frame]
    width, height = options.size
    lines = [
        "# A film",
        "",
        found["made_by"],
        "",
        "A sequence of `.vdb` files, rendered by the extension in Blender. Some of its frames are compared with Cycles",
        f"{bpy.app.version_string} at {options.scale} % of the size, in two renders with {options.samples} samples",
        "per pixel each, so that Cycles' own noise does not count.",
        "Any scene renders as a film with `blender -b scene.blend -E MRPNN -a`.",
        "",
        "![Frames of the plume, ours and Cycles'](images/film.png)",
        "",
        f"{len(frames)} frames, {width} × {height} pixels, {options.depth_samples} depth samples, "
        f"{np.median([frame['seconds'] for frame in frames.values()]):.1f} s per frame (median).",
        "",
        "| file | relative RMSE | bias | alpha bias |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {frame['file']} | {frame['rmse']:.3f} | {frame['bias']:+.1%} | {frame['alpha_bias']:+.2%} |"
        for frame in compared
    ]
    lines += [
        "",
        f"How much more a pixel changes from frame to frame than in a layer of {CONVERGED} depth samples without any",
        f"approximation, root mean square over the mean, at {options.scale} % of the size: "
        f"**{found['flicker']['beyond a converged layer']:.2%}**, where",
        f"the film itself changes by {found['flicker']['the film itself']:.1%}.",
    ]
    lines += [
        "",
        "By how much a frame changes where nothing in the scene does: root mean square over its mean.",
        "A voxel of almost no density beyond one face of the grid gives another working cube, as a growing",
        "cloud does.",
        "",
        "| | change |",
        "|---|---|",
    ]
    lines += [f"| {name} | {value:.2%} |" for name, value in found["steadiness"].items()]
    return "\n".join(lines) + "\n"


def parse(arguments):
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.split("\n\n")[0])
    parser.add_argument("--files", type=Path, default=PLUME, help="folder of numbered .vdb files")
    parser.add_argument("--grid", default="density", help="name of the density grid (density)")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "film")
    parser.add_argument("--size", type=int, nargs=2, default=(144, 192), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--depth-samples", type=int, default=8)
    parser.add_argument("--optical-depth", type=float, default=40.0, help="of the longest edge at its densest (40)")
    parser.add_argument("--compare", type=int, default=3, help="frames to compare with Cycles (3)")
    parser.add_argument("--scale", type=int, default=50, help="size of the comparison in per cent (50)")
    parser.add_argument("--samples", type=int, default=24, help="per pixel in each of two Cycles renders (24)")
    return parser.parse_args(arguments)


def main(arguments=None) -> int:
    options = parse(arguments)
    options.out = options.out.resolve()
    files = sorted(path.resolve() for path in options.files.glob("*.vdb"))
    if not files:
        print(f"no .vdb files in {options.files}: name a folder of numbered files with --files", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    extension()
    results = {"made_by": made_by(PROGRAM, arguments), **make_film(files, options)}
    replace(options.out / "film.json", json.dumps(results, indent=1) + "\n")
    replace(PAGE, page(results, options))
    return 0


if __name__ == "__main__":
    sys.exit(main())
