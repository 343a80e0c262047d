# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo: a cloud in real Blender, rendered by the extension and compared with Cycles.

    python3.11 run.py demo [volume.vdb ...] [options]

Without a volume it makes a cumulus with the project's own generator. For each volume it writes, to
build/demo: NAME.exr (multi-layer), NAME.png, NAME-comparison.png (the layer, Cycles, the signed
error) and the comparison's report in NAME-comparison, and prints the table.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path

import bpy

from ..support import pictures
from ..support.extension import ROOT, extension
from ..support.pages import record
from ..support.provenance import made_by
from . import scene as demo_scene

# Where the signed error map is fully coloured, as a share of the reference's mean radiance.
ERROR_LIMIT = 0.5
# Samples of Cycles' highest rung in the comparison.
LADDER = 16


def demo(path: Path, out: Path, options) -> tuple[str, dict[str, float]]:
    """Render and compare one volume; gives the table, and processor seconds.

    Raises RuntimeError with the operator's message.
    """
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    scene, volume, shader = demo_scene.make_scene(path, options.size, options.grid, options.y_up)
    demo_scene.fit(scene, volume, shader, read_scene, options.optical_depth)
    scene.mrpnn.depth_samples = options.depth_samples

    say(f"{path.name}: rendering {options.size[0]} x {options.size[1]} pixels")
    start, processor = time.perf_counter(), time.process_time()
    bpy.ops.mrpnn.render(filepath=str(out / f"{path.stem}.exr"))
    seconds, processor = time.perf_counter() - start, time.process_time() - processor
    layer = pictures.pixels("MRPNN")
    pictures.view_transformed(pictures.over_sky(layer), scene).save(out / f"{path.stem}.png")
    covered = (layer[..., 3] > 0.02).mean()
    say(f"{path.name}: rendered in {seconds:.1f} s, reading and writing included; {covered:.0%} of the image covered")

    say(f"{path.name}: comparing with Cycles at {options.scale} % of that size")
    bpy.ops.mrpnn.compare(
        samples=options.samples,
        scale=options.scale,
        ladder=LADDER,
        budget=0.0,
        folder=str(out / f"{path.stem}-comparison"),
    )
    comparison_picture(scene, options).save(out / f"{path.stem}-comparison.png")
    figures = json.loads((out / f"{path.stem}-comparison" / "figures.json").read_text())
    [cycles] = [one for one in figures["equal"] if (one["method"], one["clock"]) == ("cycles", "cpu_seconds")]
    compared = {"error": figures["judged"]["rmse"]["value"], "layer": figures["judged"]["cpu_seconds"]}
    return bpy.data.texts["MRPNN comparison"].as_string(), {
        f"{path.stem}, processor seconds": processor,
        **{f"{path.stem} compared: {name}": value for name, value in compared.items()},
        f"{path.stem} compared: Cycles to this error": cycles["needed"]["value"],
    }


def comparison_picture(scene, options):
    """The compared layer, Cycles' image and their signed difference, side by side."""
    layer, cycles, error = pictures.pixels("MRPNN"), pictures.pixels("MRPNN Cycles"), pictures.pixels("MRPNN error")
    mean = cycles[cycles[..., 3] > 0.02][:, :3].mean()
    return pictures.row(
        [
            (
                f"MRPNN, {options.depth_samples} depth samples",
                pictures.view_transformed(pictures.over_sky(layer), scene),
            ),
            (f"Cycles, {2 * options.samples} samples", pictures.view_transformed(pictures.over_sky(cycles), scene)),
            (
                f"difference: red +{ERROR_LIMIT:.0%}, blue -{ERROR_LIMIT:.0%} of the mean",
                pictures.signed_map(error[..., :3].mean(axis=-1) / mean, ERROR_LIMIT),
            ),
        ],
        height=384,
    )


def say(text: str) -> None:
    """Print a line for the user, past what Blender prints itself (see `hush`)."""
    _terminal.write(text + "\n")
    _terminal.flush()


_terminal = sys.stdout


def hush(log: Path) -> None:
    """Send what Blender prints to the file `log` from now on; only `say` still reaches the terminal."""
    global _terminal
    sys.stdout.flush()
    _terminal = os.fdopen(os.dup(1), "w")
    with open(log, "w") as file:
        os.dup2(file.fileno(), 1)


def parse(arguments):
    parser = argparse.ArgumentParser(prog="python3.11 run.py demo", description=__doc__.split("\n\n")[0])
    parser.add_argument("volumes", nargs="*", type=Path, metavar="volume.vdb")
    parser.add_argument("--grid", default="density", help="name of the density grid in the files (density)")
    parser.add_argument("--y-up", action="store_true", help="the files have Y up: turn them upright")
    parser.add_argument(
        "--optical-depth", type=float, default=100.0, help="of the volume's longest edge at its densest (100)"
    )
    parser.add_argument("--size", type=int, nargs=2, default=(768, 448), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--depth-samples", type=int, default=4, help="network evaluations per pixel (4)")
    parser.add_argument("--scale", type=int, default=25, help="size of the comparison in percent (25)")
    parser.add_argument("--samples", type=int, default=48, help="samples per pixel in each of two Cycles renders (48)")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "demo", help="folder to write to (build/demo)")
    parser.add_argument("--figures", type=Path, help="file to enter the figures into, such as docs/tables/readme.csv")
    options = parser.parse_args(arguments)
    options.out = options.out.resolve()
    return options


def main(arguments=None) -> int:
    options = parse(arguments)
    missing = [str(path) for path in options.volumes if not path.is_file()]
    if missing:
        print(f"no such file: {', '.join(missing)}", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    hush(options.out / "blender.log")
    extension()
    paths = options.volumes or [options.out / "cloud.vdb"]
    if not options.volumes:
        from mrpnn.mrpnn_addon.vdb.openvdb_module import load_openvdb

        say("making a cloud")
        demo_scene.write_cloud(paths[0], load_openvdb())
    failed = 0
    for path in paths:
        try:
            table, figures = demo(path.resolve(), options.out, options)
        # What Blender raises where an operator reports an error, and the extension's own refusals.
        except (RuntimeError, ValueError) as error:
            say(f"{path.name}: {str(error).strip()}")
            failed += 1
            continue
        say("\n" + table)
        if options.figures:
            record(options.figures, made_by("benchmarks.demo", arguments), figures)
    say(f"pictures are in {os.path.relpath(options.out)}")
    say(made_by("benchmarks.demo", arguments))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
