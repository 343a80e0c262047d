# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against run time of MRPNN and Cycles over a set of scenes: makes CSV files and plots in docs.

    python -m benchmarks.error_vs_time [--out build/error_vs_time] [--size 64] [--samples 256] [--only WORDS] [--table]

Runs the extension's comparison in Blender for each case of `cases`. Every image of Cycles is stored in OUT, and so are
the figures of finished cases: a run that was stopped continues where it was, and with more --samples the references
that are there are continued. With other weights or code every case is measured again, against the stored images. With
--again every image that is timed is rendered again, but for the references. --table only rewrites the page, from the
figures of the present weights. The page has every version of Cycles that was measured: run it with bpy 4.5 and 5.2.
"""

import argparse
import json
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import bpy

from ..support.extension import ROOT, extension
from ..support.pages import IMAGES, TABLES, csv_text, write_tables
from ..support.pages import replace as replace_file
from ..support.provenance import commit, made_by
from . import page, plots
from .cases import absent_files, cases, make

PROGRAM = "benchmarks.error_vs_time"
# Samples per pixel of Cycles' highest rung, and of each half of references that only tell how costs grow: fewer in
# images beyond a size, which have more pixels to average over.
LADDER, GROWTH_SAMPLES, GROWTH_SIZE, LEAST_SAMPLES = 64, 16, 64, 2
# The same for larger images whose errors are measured.
FILTER_LADDER, FILTER_SAMPLES = 16, 32


def main(arguments=None) -> int:
    options = parse(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "results.json"
    if options.again:
        for timed in (file, *(options.out / "images").rglob("cycles-*.npz")):
            timed.unlink(missing_ok=True)
    results = json.loads(file.read_text()) if file.is_file() else {}
    scenes = cases(options.size)
    if not options.table:
        for path in absent_files():
            print(
                f"left out: scenes of {path.name}, which is not at {path} (see benchmarks/data/README.md)",
                file=sys.stderr,
            )
        extension()
        for case in scenes:
            if not (options.only in case.name or options.only in case.growth):
                continue
            start, state = time.perf_counter(), [weights(), options.samples, commit()]
            key = f"{case.name}, Cycles {bpy.app.version_string}"
            if results.get(key, {}).get("state") != state:
                results[key] = {
                    "case": asdict(case),
                    "state": state,
                    "made_by": made_by(PROGRAM, arguments),
                    **measured(case, options),
                }
                replace_file(file, json.dumps(results, indent=1) + "\n")
                print(f"{case.name}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    # Figures of other weights do not count.
    known = [
        results[key]
        for case in scenes
        for key in sorted(results)
        if key.startswith(f"{case.name}, Cycles ") and results[key]["state"][0] == weights()
    ]
    if not known:
        print("nothing is measured yet", file=sys.stderr)
        return 1
    replace_file(TABLES / "error-vs-time.csv", csv_text(page.sources(known), *page.csv_table(known)))
    plots.save_ladders(known, IMAGES / "error-vs-time.png")
    plots.save_headline(known, IMAGES / "error-vs-time-headline.png")
    plots.save_growth(known, IMAGES / "error-vs-time-growth.png")
    for name, text in page.tables(known).items():
        write_tables(name, text, page.sources(known))
    return 0


def weights() -> str:
    """Checksum of the default network, by which results of other weights are told apart."""
    from inference import Settings
    from inference.network.network import load_network

    return load_network(Settings.model).checksum


def measured(case, options) -> dict:
    """Run the comparison of a case; gives its figures."""
    from mrpnn.mrpnn_addon.comparison.run import ComparisonRun, Options
    from mrpnn.mrpnn_addon.scene.reader import read_scene
    from mrpnn.mrpnn_addon.vdb.openvdb_module import load_openvdb

    scene = make(case, options.out, load_openvdb(), read_scene)
    bpy.context.view_layer.update()
    wanted = Options(samples=options.samples, ladder=LADDER, scale=100, folder=str(options.out / "images"))
    if case.growth:
        samples = max(LEAST_SAMPLES, GROWTH_SAMPLES * GROWTH_SIZE**2 // max(case.size, GROWTH_SIZE) ** 2)
        wanted = Options(samples=samples, ladder=1, depths=(), scale=100, folder=wanted.folder)
    if case.growth == "filter":
        wanted = replace(wanted, samples=FILTER_SAMPLES, ladder=FILTER_LADDER)
    run = ComparisonRun(bpy.context, scene.mrpnn.settings(), wanted)
    run.wait()
    if run.job.cancelled:
        raise SystemExit("stopped; finished cases are stored")
    return run.result().figures()


def parse(arguments):
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.split("\n\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "error_vs_time")
    parser.add_argument("--size", type=int, default=64, help="pixels per edge (64)")
    parser.add_argument("--samples", type=int, default=256, help="per pixel in each half of the reference (256)")
    parser.add_argument(
        "--only", default="", help="part of a case's name, or what grows: pixels, voxels, suns, albedo, image, filter"
    )
    parser.add_argument("--again", action="store_true", help="render again what is timed, but not the references")
    parser.add_argument("--table", action="store_true", help="write the page from the figures there are")
    options = parser.parse_args(arguments)
    options.out = options.out.resolve()
    return options


if __name__ == "__main__":
    sys.exit(main())
