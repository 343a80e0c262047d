"""How far each system's image is from path-traced references: the paper's Tables 1 and 2 on our scenes.

    python -m benchmarks.fidelity --out build/fidelity [--models mrpnn rpnn reference] [--views shared procedural real]

Views: those of ../shared/fidelity, whose references share no code with the project, held-back procedural
volumes, and real ones of ../shared/volumes, which bpy reads; references of these our own tracer makes once
(build/references). Every reference is two independent halves, so that errors are measured without its own
noise. Writes fidelity.csv (a row for each view and system), fidelity.md (the tables) and a picture a view:
reference, systems, signed errors.
"""

import argparse
import csv
import functools
import json
import pathlib
from dataclasses import asdict, dataclass

import numpy as np

from inference import Settings, available_models
from inference.evaluation.error import paper_metric, relative_bias, relative_rmse
from inference.network.network import load_network, register_system
from inference.scene.optimizations import ALL
from training.reference import PATHS, PathTracer

from . import pictures, tables
from .real_volumes import real_views
from .references import relative_variance, seconds_a_sample
from .views import MASK_ALPHA, SHARED, View, procedural_views, shared_views

#: In the order of the tables.
SYSTEMS = ("mrpnn", "mrpnn-paper", "mrpnn-narrow", "mrpnn-wide", "rpnn")


@dataclass
class Measurement:
    """One system on one view.

    rmse, bias: relative, with bootstrap 95 % intervals; paper: the paper's metric, RMSE x 100.
    seconds: a frame; reference_seconds: what the path tracer would take for as small an error, all of it noise.
    """

    view: str
    volume: str
    light: str
    sigma_hat: float
    anisotropy: float
    albedo: tuple
    system: str
    rmse: float
    rmse_low: float
    rmse_high: float
    bias: float
    bias_low: float
    bias_high: float
    paper: float
    seconds: float
    reference_seconds: float


def applies(system: str, view: View) -> bool:
    """Whether a system was made for the view's anisotropy and albedo."""
    made_for = load_network(system)
    low, high = made_for.albedo_range
    within = made_for.anisotropy_range[0] <= view.anisotropy <= made_for.anisotropy_range[1]
    return within and all(low <= albedo <= high for albedo in view.albedo)


def measure(view: View, systems, depth_samples: int):
    """Measurements of the systems that apply to a view, the picture of them all."""
    halves = view.halves()
    mask = halves[..., 3].mean(axis=0) > MASK_ALPHA
    # A grey view keeps its radiance in every channel. Pixels outside the mask are nobody's.
    a, b = halves[..., :3] * mask[..., None]
    sample = seconds_a_sample(view)
    measured, images = [], {}
    for system in systems:
        layer = view.render(Settings(depth_samples=depth_samples, model=system, leave_out=ALL - {"shared_pixels"}))
        rgb = images[system] = layer.rgb * mask[..., None]
        rmse, bias = relative_rmse(rgb, a, b, mask), relative_bias(rgb, a, b, mask)
        # Where the error is too small to be told from 0, the interval's end stands for it.
        error = rmse.value or rmse.high
        needed = relative_variance(a, b, mask, view.samples) / error**2 if error else np.inf
        measured.append(Measurement(
            view.name, view.volume, view.light, view.sigma_hat, view.anisotropy, view.albedo, system,
            rmse.value, rmse.low, rmse.high, bias.value, bias.low, bias.high, paper_metric(rgb, a, b),
            layer.report.seconds["total"], needed * sample,
        ))
    return measured, pictures.picture(images, a, b)


def published_network() -> dict:
    """The published network's figures by view, in the names used here; empty where the folder is absent."""
    path = SHARED / "published_network.json"
    figures = json.loads(path.read_text()) if path.exists() else {}
    return {view: {"rmse": f["rel_rmse"], "bias": f["rel_bias"], "paper": f["paper"]} for view, f in figures.items()}


def write_csv(path: pathlib.Path, measured):
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, asdict(measured[0]))
        writer.writeheader()
        for one in measured:
            writer.writerow({**asdict(one), "albedo": " ".join(f"{value:g}" for value in one.albedo)})


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    present = [system for system in SYSTEMS if system in available_models()]
    parser.add_argument("--models", nargs="+", default=present, choices=available_models(), metavar="NAME")
    sources = ["shared", "procedural", "real"]
    parser.add_argument("--views", nargs="+", default=sources[:2], choices=sources)
    parser.add_argument("--match", default="", metavar="TEXT", help="only views whose name holds this")
    parser.add_argument("--depth-samples", type=int, default=128)
    parser.add_argument("--size", type=int, default=64, help="pixels an edge of procedural and real views")
    parser.add_argument("--samples", type=int, default=1024, help="paths a pixel in each half of their references")
    parser.add_argument("--cells", type=int, default=128, help="cells an edge of procedural volumes")
    parser.add_argument("--paths", type=int, default=PATHS, help="paths a depth sample of the system `reference`")
    parser.add_argument("--references", type=pathlib.Path, default=pathlib.Path("build/references"))
    arguments = parser.parse_args(options)
    register_system("reference", functools.partial(PathTracer, arguments.paths))
    views = shared_views() if "shared" in arguments.views else []
    if "procedural" in arguments.views:
        views += procedural_views(arguments.size, arguments.samples, arguments.cells, arguments.references)
    if "real" in arguments.views:
        views += real_views(arguments.size, arguments.samples, arguments.references)
    views = [view for view in views if arguments.match in view.name]
    if not views:
        parser.error(f"there is no view to measure: none is called {arguments.match!r} or ../shared is absent")
    arguments.out.mkdir(parents=True, exist_ok=True)
    measured = []
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
        write_csv(arguments.out / "fidelity.csv", measured)
        text = tables.document(measured, published_network(), arguments.depth_samples)
        (arguments.out / "fidelity.md").write_text(text)


if __name__ == "__main__":
    main()
