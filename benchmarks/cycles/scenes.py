# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes as artists build them, against Cycles: makes docs/tables/scenes*.csv and pictures.

    python -m benchmarks.cycles.scenes [--out build/scenes] [--only WORDS ...] [--size 64] [--samples 64] [--table]
        [--messages]

One small scene for each feature (`scene_features/`). Figures go to OUT/results.json as they come, so that a run that
was stopped continues where it was, until the code or the weights change. The docs are written once OUT has all scenes;
--table only writes them. --messages writes the tables of messages alone, without Cycles, in some minutes.
"""

import argparse
import json
import os
import re
import shutil
import sys
import time
from pathlib import Path

import bpy
import numpy as np

from evaluation.error import error_text

from ..demo import scene as demo_scene
from ..support import pictures
from ..support.extension import ROOT, extension
from ..support.pages import IMAGES, TABLES, csv_text, replace
from ..support.provenance import made_by
from . import scene_features

PROGRAM = "benchmarks.cycles.scenes"
PICTURES = IMAGES / "scenes"
COLUMNS = (
    "scene",
    "alpha bias",
    "single RMSE",
    "single bias",
    "whole RMSE",
    "whole bias",
    "processor seconds, Cycles / ours",
    "Cycles, ours",
)
DEPTH_SAMPLES = 16
# Samples of single scattering, at most.
MOST_SINGLE = 256
# Times as many samples where the phase function is narrow, and where a lamp is near smoke or in it: some paths are very
# bright there.
FORWARD, FORWARD_SAMPLES = "G 0.857", 4
NEAR, NEAR_SAMPLES = re.compile("(light|plane) (outside|at the edge|inside)|ball"), 8
# Height of the pictures on the page.
PICTURE_HEIGHT = 128


def main(arguments=None) -> int:
    options = parse(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "results.json"
    results = json.loads(file.read_text()) if file.is_file() else {}
    source = made_by(PROGRAM, arguments)
    if options.messages:
        write_messages({name: {**messages(stage), "made_by": source} for name, stage in stages(options)})
        return 0
    if not options.table:
        before = [name for name, found in results.items() if not options.only and found.get("made_by") == source]
        for name, stage in stages(options, before):
            start = time.perf_counter()
            results[name] = measured(name, stage, options) if name in scene_features.MEASURED else messages(stage)
            results[name]["made_by"] = source
            replace(file, json.dumps(results, indent=1) + "\n")
            print(f"{name}: {time.perf_counter() - start:.0f} s {results[name]}", file=sys.stderr, flush=True)
    missing = [name for name in (*scene_features.NAMED, *scene_features.MEASURED) if name not in results]
    if missing:
        print(f"the docs stay as they are until {options.out} has all scenes; missing: {len(missing)}", file=sys.stderr)
        return 0
    write_figures(results)
    for name in scene_features.MEASURED:
        made = options.out / picture(name).name
        if made.is_file():
            PICTURES.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(made, picture(name))
    return 0


def stages(options, skipped=()):
    """Make the scenes that --only names, all by default, one after the other: pairs of name and stage."""
    extension()
    cloud = options.out / "cloud.vdb"
    if not cloud.is_file():
        write_cloud(cloud)
    for name, builder in {**scene_features.NAMED, **scene_features.MEASURED}.items():
        if name in skipped or options.only and not any(words in name for words in options.only):
            continue
        stage = scene_features.make_stage(options.out, cloud, options.size)
        builder(stage)
        bpy.context.view_layer.update()
        yield name, stage


def write_cloud(path: Path) -> None:
    from mrpnn.mrpnn_addon.vdb.openvdb_module import load_openvdb

    from training.procedural.volumes import make_volume

    demo_scene.write_grid(path, make_volume(scene_features.SEED, scene_features.CELLS).density, load_openvdb())


def measured(name, stage, options) -> dict:
    """Errors of the whole layer, of single scattering alone and of alpha, against Cycles."""
    from mrpnn import inference
    from mrpnn.evaluation.error import relative_bias, relative_rmse
    from mrpnn.mrpnn_addon.cycles.reference import PathTracing, render_reference, volumes_and_lights
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    depsgraph = bpy.context.evaluated_depsgraph_get()
    try:
        described = read_scene(depsgraph)
    except inference.SceneError as refusal:
        return {"refused": str(refusal)}
    start = time.process_time()
    layer = inference.render(
        described.volumes,
        described.lights,
        described.camera,
        inference.Settings(depth_samples=DEPTH_SAMPLES),
        surfaces=described.surfaces,
    )
    mask = (layer.alpha > 0.02) | (layer.emission.max(axis=2) > 0.0)
    found = {
        "seconds": time.process_time() - start,
        "pixels": int(mask.sum()),
        "warnings": list(dict.fromkeys(described.warnings + layer.report.warnings)),
    }
    world = stage.scene.world if described.environment else None
    objects = volumes_and_lights(bpy.context.evaluated_depsgraph_get()) + stage.surfaces
    parts = [("single", layer.single + layer.emission, 0), ("whole", layer.rgb, 1024)]
    if any(volume.emission is not None and medium.scatters for volume, medium in described.volumes):
        # Without bounces, Cycles' image still holds emitted light that was scattered once.
        parts = parts[1:]
    for kind, image, bounces in parts:
        samples = options.samples * (FORWARD_SAMPLES if FORWARD in name else 1)
        samples *= NEAR_SAMPLES if NEAR.search(name) else 1
        # Single scattering is cheap: less noise, and a smaller error to tell.
        samples = max(min(4 * samples, MOST_SINGLE), samples) if bounces == 0 else samples
        start = time.process_time()
        reference = render_reference(
            stage.scene, objects, PathTracing(samples, bounces, stage.step_rate, bool(stage.surfaces)), world
        )
        found[f"{kind} seconds"] = time.process_time() - start
        a, b = reference.a, reference.b
        for figure, estimate in (("rmse", relative_rmse), ("bias", relative_bias)):
            value = estimate(image, a[..., :3], b[..., :3], mask)
            found[f"{kind} {figure}"] = [value.value, value.low, value.high]
        found[f"{kind} bias by channel"] = [
            relative_bias(image[..., c], a[..., c], b[..., c], mask).value for c in range(3)
        ]
    found["alpha bias"] = relative_bias(layer.alpha, a[..., 3], b[..., 3], mask).value
    cycles = (a + b) / 2.0
    ours = np.concatenate([layer.rgb, layer.alpha[..., None]], axis=2)
    pictures.row(
        [
            (caption, pictures.view_transformed(pictures.over_sky(image), stage.scene))
            for caption, image in (("Cycles", cycles), ("ours", ours))
        ],
        PICTURE_HEIGHT,
    ).save(options.out / picture(name).name)
    return found


def messages(stage) -> dict:
    """What the extension says of a scene."""
    from mrpnn import inference
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    try:
        described = read_scene(bpy.context.evaluated_depsgraph_get())
        layer = inference.render(
            described.volumes,
            described.lights,
            described.camera,
            inference.Settings(depth_samples=1),
            surfaces=described.surfaces,
        )
        return {"warnings": list(dict.fromkeys(described.warnings + layer.report.warnings))}
    except inference.SceneError as refusal:
        return {"refused": str(refusal)}


def picture(name: str) -> Path:
    return PICTURES / (re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") + ".png")


def sources(results) -> list:
    """The sentences on what made the figures, each once."""
    return list(dict.fromkeys(found["made_by"] for found in results.values() if "made_by" in found))


def write_figures(results: dict) -> None:
    """The table of what is measured, whose rows have the sentence on what made them, and those of messages."""
    measured = [
        [*row(name, results[name]), results[name]["made_by"]] for name in scene_features.MEASURED if name in results
    ]
    replace(TABLES / "scenes.csv", csv_text([], [*COLUMNS, "made by"], measured))
    write_messages(results)


def write_messages(results: dict) -> None:
    """Tables of what the extension says of scenes that it renders, and of those that it leaves out in part."""
    said = [(name, text) for name in scene_features.MEASURED for text in results.get(name, {}).get("warnings", [])]
    notes = {text: "; ".join(name for name, other in said if other == text) for _, text in said}
    replace(TABLES / "scenes-notes.csv", csv_text(sources(results), ["message", "scenes"], notes.items()))
    named = []
    for name, found in ((name, results[name]) for name in scene_features.NAMED if name in results):
        message = found.get("refused") or "; ".join(found["warnings"]) or "nothing"
        named.append([name, "refused" if "refused" in found else "warning", message.replace(str(ROOT) + os.sep, "")])
    replace(TABLES / "scenes-named.csv", csv_text(sources(results), ["scene", "row", "message"], named))


def row(name: str, found: dict) -> list[str]:
    """A measured scene's cells of COLUMNS."""
    if "refused" in found:
        return [name, f"refused: {found['refused']}", *[""] * (len(COLUMNS) - 2)]
    return [
        name,
        f"{found['alpha bias']:+.1%}",
        *_single(found),
        error_text(*found["whole rmse"]),
        f"{found['whole bias'][0]:+.1%}",
        f"{found['whole seconds']:.1f} / {found['seconds']:.1f}",
        f"scenes/{picture(name).name}",
    ]


def _single(found) -> list[str]:
    if "single rmse" not in found:
        return ["–", "–"]
    return [error_text(found["single rmse"][0]), f"{found['single bias'][0]:+.1%}"]


def parse(arguments):
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.split("\n\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "scenes")
    parser.add_argument("--only", nargs="+", default=(), help="parts of scenes' names; measures these again")
    parser.add_argument("--size", type=int, default=64, help="pixels per edge (64)")
    parser.add_argument("--samples", type=int, default=64, help="per pixel in each of two Cycles renders (64)")
    parser.add_argument("--table", action="store_true", help="write the page from the figures there are")
    parser.add_argument("--messages", action="store_true", help="write the tables of messages alone, without Cycles")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
