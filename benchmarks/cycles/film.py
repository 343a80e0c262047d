# SPDX-License-Identifier: GPL-3.0-or-later
"""A film of a volume sequence with sky and ground, and how far its frames are from Cycles: makes docs/use/film.md.

    python -m benchmarks.cycles.film [--files FOLDER] [--out build/film] [--frames 11] [--compare 3]

Renders one frame for each numbered .vdb file of a folder: the volumes by the extension to OUT/NNNN.exr, and composited
over ground and sky by Cycles to OUT/NNNN.png. Puts these together as OUT/film.webp, and compares some of the layers
with Cycles. Measures how much the film flickers, and by how much a frame changes where nothing in the scene does.
Figures go to OUT/film.json. Without --files it takes the plume that benchmarks/data/README.md names, which the
repository may not contain.
"""

import argparse
import json
import re
import sys
import time
from pathlib import Path

import bpy
import numpy as np
from PIL import Image

from evaluation.error import error_text

from ..demo import scene as demo_scene
from ..support import pictures
from ..support.data import EXTRA_VOLUMES
from ..support.extension import ROOT, extension
from ..support.pages import replace
from ..support.provenance import made_by
from ..support.shaders import add_shader, add_sky

PROGRAM = "benchmarks.cycles.film"
PLUME = EXTRA_VOLUMES / "plume"
PAGE = ROOT / "docs" / "use" / "film.md"
STRIP, STRIP_HEIGHT = ROOT / "docs" / "images" / "film.png", 160
FRAMES_PER_SECOND = 12
# Half an edge of the ground, its corners and its colour; Cycles' samples for what is no volume.
GROUND, CORNERS, GROUND_COLOUR = 50.0, ((-1, -1), (1, -1), (1, 1), (-1, 1)), (0.25, 0.22, 0.17)
GROUND_SAMPLES = 16
# Colour, heights and radiance of the sky, brighter at the horizon.
SKY = (0.45, 0.65, 1.0), (0.0, 0.5), (0.7, 0.25)
#: Depth samples of a converged layer.
CONVERGED = 64


def stage(files, options, read_scene):
    """The scene: the sequence over ground, in one sun and under a sky."""
    scene, volume, shader = demo_scene.make_scene(files[0], options.size, options.grid, y_up=True)
    shader.inputs["Anisotropy"].default_value = 0.5
    # Every frame is framed, and as dense, as the last and largest file asks for.
    volume.data.filepath = str(files[-1])
    demo_scene.fit(scene, volume, shader, read_scene, options.optical_depth)
    (grid, _), *_ = read_scene(bpy.context.evaluated_depsgraph_get()).volumes
    ground = bpy.data.meshes.new("Ground")
    z = float(demo_scene.corners_of(grid)[:, 2].min())
    ground.from_pydata([(x * GROUND, y * GROUND, z) for x, y in CORNERS], [], [range(4)])
    add_shader(ground, "Ground", "BsdfDiffuse", "Surface").inputs["Color"].default_value = (*GROUND_COLOUR, 1.0)
    demo_scene.link(scene, "Ground", ground)
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    add_sky(scene.world, *SKY)
    volume.data.filepath = str(files[0])
    first = int(re.search(r"(\d+)$", files[0].stem).group())
    volume.data.is_sequence, volume.data.frame_duration = True, len(files)
    volume.data.frame_start, volume.data.frame_offset = 1, first - 1
    scene.frame_start, scene.frame_end = 1, min(len(files), options.frames)
    scene.mrpnn.depth_samples = options.depth_samples
    cycles = scene.cycles
    cycles.samples, cycles.use_denoising, cycles.max_bounces = GROUND_SAMPLES, True, 2
    return scene


def make_film(files, options) -> dict:
    """Render and compare; gives the figures by frame, and of steadiness."""
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    scene = stage(files, options, read_scene)
    frames = range(scene.frame_start, scene.frame_end + 1)
    compared = set(np.linspace(1, len(frames), options.compare).round().astype(int)) if options.compare else ()
    still = steadiness(read_scene(bpy.context.evaluated_depsgraph_get()), options)
    flickers = flicker(scene, read_scene, options)
    results, shown = {}, []
    for frame in frames:
        scene.frame_set(frame)
        start = time.process_time()
        bpy.ops.mrpnn.render(filepath=str(options.out / f"{frame:04}.exr"))
        layer = time.process_time() - start
        found = {"file": files[frame - 1].name, "seconds": layer}
        if frame in compared:
            found.update(_compare(options, frame))
        bpy.ops.mrpnn.composite()
        scene.render.filepath, scene.render.image_settings.file_format = str(options.out / f"{frame:04}.png"), "PNG"
        start = time.process_time()
        bpy.ops.render.render(write_still=True)
        found["seconds with ground and sky"] = time.process_time() - start
        bpy.ops.mrpnn.composite_remove()
        results[frame] = found
        shown.append(Image.open(scene.render.filepath).convert("RGB"))
        print(f"frame {frame}: {found}", file=sys.stderr, flush=True)
    duration = round(1000 / FRAMES_PER_SECOND)
    shown[0].save(
        options.out / "film.webp", save_all=True, append_images=shown[1:], loop=0, duration=duration, quality=90
    )
    chosen = np.unique(np.linspace(1, len(frames), 3).round().astype(int))
    pictures.row([(f"{frame}", shown[frame - 1]) for frame in chosen], STRIP_HEIGHT).save(STRIP)
    return {"frames": results, "flicker": flickers, "steadiness": still}


def flicker(scene, read_scene, options) -> dict:
    """How much more a pixel changes from frame to frame than in a converged layer: root mean square over the mean.

    The difference between the film's layer and one of CONVERGED depth samples without approximations, from each frame
    to the next, where either shows the volume. "the film itself": how much the converged layer changes.
    """
    from mrpnn import inference
    from mrpnn.inference.scene.optimizations import ALL

    usual = inference.Settings(depth_samples=options.depth_samples)
    exact = inference.Settings(depth_samples=CONVERGED, optimizations=ALL - {"shared_pixels"})
    scene.render.resolution_percentage = options.flicker_scale
    beyond, itself, mean, pixels, last = 0.0, 0.0, 0.0, 0, None
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        described = read_scene(bpy.context.evaluated_depsgraph_get())
        layer, converged = (
            inference.render(
                described.volumes, described.lights, described.camera, settings, surfaces=described.surfaces
            )
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
            pairs,
            described.lights,
            described.camera,
            inference.Settings(depth_samples=options.depth_samples),
            surfaces=described.surfaces,
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


def _compare(options, frame: int) -> dict:
    folder = options.out / f"{frame:04}-comparison"
    bpy.ops.mrpnn.compare(samples=options.samples, scale=options.scale, ladder=0, budget=0.0, folder=str(folder))
    found = json.loads((folder / "figures.json").read_text())
    return {name: found[name]["value"] for name in ("rmse", "bias", "alpha_bias")}


def page(found, options) -> str:
    """The page's text."""
    frames, compared = found["frames"], [frame for frame in found["frames"].values() if "rmse" in frame]
    width, height = options.size
    seconds, whole = (
        np.median([frame[name] for frame in frames.values()]) for name in ("seconds", "seconds with ground and sky")
    )
    lines = [
        "# A film",
        "",
        "Any scene renders as a film: `blender -b scene.blend -E MRPNN -a`. In a scene with [*Composite over",
        "Cycles*](composite.md), leave out `-E MRPNN`.",
        "",
        "This film is a sequence of `.vdb` files over ground and under a sky. The extension renders the volumes.",
        f"*Composite over Cycles* renders the rest in Blender {bpy.app.version_string}, with {GROUND_SAMPLES} samples,",
        "denoised.",
        "",
        "![Three frames of the film: a plume rises over ground and casts a shadow](../images/film.png)",
        "",
        f"{len(frames)} frames, {width} × {height} pixels, {options.depth_samples} depth samples. The median",
        f"frame's layer takes {seconds:.1f} processor seconds, including reading the scene and writing the file. The",
        f"whole frame takes {whole:.1f}, including the layer.",
    ]
    if compared:
        lines += [
            "",
            f"Some layers are compared with Cycles, at {options.scale} % of the size and without the ground. Cycles",
            f"renders each twice, with {options.samples} samples per pixel, so that its own noise does not count:",
            "",
            "| file | relative RMSE | bias | alpha bias |",
            "|---|---|---|---|",
        ]
    lines += [
        f"| {frame['file']} | {error_text(frame['rmse'])} | {frame['bias']:+.1%} | {frame['alpha_bias']:+.2%} |"
        for frame in compared
    ]
    lines += [
        "",
        f"**Flicker.** From frame to frame, motion changes a pixel by {found['flicker']['the film itself']:.1%}, and",
        f"flicker by {found['flicker']['beyond a converged layer']:.2%}. Flicker is the change of the difference from",
        f"a layer of {CONVERGED} depth samples without any approximation. Both are root mean squares over the mean, at",
        f"{options.flicker_scale} % of the size.",
        "",
        "The next table has the change of a frame in which nothing visible changes. *Again* is the same render twice.",
        "In the other rows, the grid is longer by one almost empty voxel, as a cloud that grows makes it.",
        "",
        "| | change |",
        "|---|---|",
    ]
    lines += [f"| {name} | {value:.2%} |" for name, value in found["steadiness"].items()]
    lines += ["", found["made_by"]]
    return "\n".join(lines) + "\n"


def parse(arguments):
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.split("\n\n")[0])
    parser.add_argument("--files", type=Path, default=PLUME, help="folder of numbered .vdb files")
    parser.add_argument("--grid", default="density", help="name of the density grid (density)")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "film")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 720), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--depth-samples", type=int, default=8)
    parser.add_argument("--optical-depth", type=float, default=40.0, help="of the longest edge at its densest (40)")
    parser.add_argument("--compare", type=int, default=3, help="frames to compare with Cycles (3)")
    parser.add_argument("--frames", type=int, default=1000, help="at most (all)")
    parser.add_argument("--scale", type=int, default=10, help="size of the comparison in per cent (10)")
    parser.add_argument("--flicker-scale", type=int, default=50, help="size at which flicker is measured (50)")
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
