# SPDX-License-Identifier: GPL-3.0-or-later
"""How far each system's image is from path-traced references: the paper's Tables 1 and 2 on our scenes.

    python -m benchmarks.fidelity --out build/fidelity [--models mrpnn rpnn reference]
        [--views independent retraced procedural real] [--docs]

Views: the independent references in benchmarks/data, whose path tracer shares no code with the project; the same views
retraced; held-back procedural volumes; and real volumes, which bpy reads. The references of the last three come from
the project's own path tracer and are traced once (build/references). Every reference is two independent halves, so that
its noise does not count as error. Writes fidelity.csv (a row for each view and system), fidelity.md (the tables) and a
picture for each view: reference, systems, signed errors. --docs writes the tables into docs/tables and, of
independent views, figures and two pictures beside it.
"""

import argparse
import functools
import pathlib
import shutil
import sys

import training.rpnn  # noqa: F401  Lets --models name it.
from inference import available_models
from inference.network.network import register_system
from training.reference import PATHS, PathTracer

from ..support.pages import IMAGES, TABLES, write_tables
from ..support.provenance import made_by
from . import tables
from .measurements import applies, measure, published_network, write_csv
from .real_volumes import real_views
from .views import independent_views, procedural_views, retraced_views

PROGRAM = "benchmarks.fidelity"
#: Pictures in docs, by the view that they show.
PICTURES = {"cumulus-100-side-g0.857": "fidelity-side.png", "cumulus-100-back-g0": "fidelity-back.png"}
#: In the order of the tables.
SYSTEMS = ("mrpnn", "mrpnn-paper", "mrpnn-narrow", "mrpnn-wide", "rpnn")


def write_docs(out: pathlib.Path, measured, source: str) -> None:
    """Write the tables into docs/tables, and of independent views figures and pictures too."""
    found = tables.sections(measured, published_network())
    for views, text in found.items():
        write_tables(f"accuracy-{views}", text, [source])
    if "independent" in found:
        shutil.copyfile(out / "fidelity.csv", TABLES / "fidelity.csv")
        for view, name in PICTURES.items():
            shutil.copyfile(out / f"{view}.png", IMAGES / name)


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=pathlib.Path, required=True)
    present = [system for system in SYSTEMS if system in available_models()]
    parser.add_argument("--models", nargs="+", default=present, choices=available_models(), metavar="NAME")
    sources = ["independent", "retraced", "procedural", "real"]
    parser.add_argument("--views", nargs="+", default=["independent", "procedural"], choices=sources)
    parser.add_argument("--match", default="", metavar="TEXT", help="only views whose name contains this")
    parser.add_argument("--depth-samples", type=int, default=128)
    parser.add_argument("--size", type=int, default=64, help="pixels per edge of procedural and real views")
    parser.add_argument("--samples", type=int, default=1024, help="paths per pixel in each half of traced references")
    parser.add_argument("--cells", type=int, default=128, help="cells per edge of procedural volumes")
    parser.add_argument("--paths", type=int, default=PATHS, help="paths per depth sample of the system `reference`")
    parser.add_argument("--docs", action="store_true", help="write the tables into docs/tables")
    parser.add_argument("--references", type=pathlib.Path, default=pathlib.Path("build/references"))
    arguments = parser.parse_args(options)
    register_system("reference", functools.partial(PathTracer, arguments.paths))
    views = independent_views() if "independent" in arguments.views else []
    if "retraced" in arguments.views:
        views += retraced_views(arguments.samples, arguments.references)
    if "procedural" in arguments.views:
        views += procedural_views(arguments.size, arguments.samples, arguments.cells, arguments.references)
    if "real" in arguments.views:
        found, absent = real_views(arguments.size, arguments.samples, arguments.references)
        views += found
        for path in absent:
            print(
                f"left out: views of {path.name}, which is not at {path} (see benchmarks/data/README.md)",
                file=sys.stderr,
            )
    views = [view for view in views if arguments.match in view.name]
    if not views:
        parser.error(f"no view's name contains {arguments.match!r}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    measured, source = [], made_by(PROGRAM, options, arguments.models)
    for view in views:
        systems = [system for system in arguments.models if applies(system, view)]
        if not systems:
            continue
        found, picture = measure(view, systems, arguments.depth_samples)
        picture.save(arguments.out / f"{view.name}.png")
        for one in found:
            interval = f"{one.rmse:.3f} ({one.rmse_low:.3f}-{one.rmse_high:.3f})"
            print(f"{one.view:44} {one.system:13} {interval} bias {one.bias:+.3f} {one.seconds:6.1f} s", flush=True)
        measured += found
        # After each view, so that a run that is stopped leaves what it has.
        write_csv(arguments.out / "fidelity.csv", measured, source)
        facts = f"{source} {arguments.depth_samples} depth samples."
        text = tables.document(measured, published_network(), facts)
        (arguments.out / "fidelity.md").write_text(text)
    if arguments.docs:
        write_docs(arguments.out, measured, source)


if __name__ == "__main__":
    main()
