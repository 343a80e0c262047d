# SPDX-License-Identifier: GPL-3.0-or-later
"""How the cost of a render grows, and what error its depth samples leave: makes tables speed-*.csv in docs/tables.

    python -m benchmarks.cost.scaling [--size 256] [--tables threads suns]

Renders the cloud of benchmarks.cost.speed with one thing changed at a time. Cost is processor seconds of all threads,
which other work on the machine changes little, by stage and as a ratio to the first row of its table; for threads,
wall-clock seconds. The error of depth samples is that of the whole image beside 64 of them, over pixels of alpha above
0.02; that of adaptive interpolation, beside 32.
"""

import argparse
import dataclasses
import functools
import os

import numpy as np

from inference import Camera, Medium, Settings, Sun, Surface, render
from inference.scene.optimizations import ALL, OPTIMIZATIONS

from ..fidelity.views import MASK_ALPHA, independent_views
from ..support.pages import write_tables
from ..support.provenance import made_by
from .speed import camera_covering, cloud

PROGRAM = "benchmarks.cost.scaling"
STAGES = ("shadows", "fields", "march", "network")
SUN = Sun((0.8, 0.45, -0.36))
COVERAGE = 0.4
EVERY_PIXEL = ALL - {"shared_pixels"}
SHARING_VIEWS = ("cumulus-100-side-g0.857", "cumulus-100-back-g0.857", "smoke-100-side-g0.857")
SHARING_SIZES, SHARING_TRUTH = (128, 256), 32


def ring(count: int):
    """Suns around the vertical, together as bright as one."""
    angles = 2 * np.pi * np.arange(count) / count
    return [Sun((np.cos(a), np.sin(a), 0.6), 1.0 / count) for a in angles]


def cases(size: int):
    """Tables: a heading, and rows of a name and what to render."""
    volume, medium = cloud(), Medium(100.0, 1.0, 0.857)
    view = camera_covering(volume, medium, size, COVERAGE)

    def at(edge):
        return Camera(view.world_matrix, "orthographic", (edge, edge), ortho_scale=view.ortho_scale)

    def once(volume=volume, medium=medium, suns=(SUN,), camera=view, settings=Settings()):
        return lambda: render([(volume, medium)], list(suns), camera, settings)

    return {
        "pixels": [(f"{edge}²", once(camera=at(edge))) for edge in (size // 4, size // 2, size, 2 * size)],
        "depth samples": [(str(n), once(settings=Settings(n))) for n in (1, 2, 4, 8, 16)],
        "voxels": [(f"{edge}³", once(volume=cloud(edge))) for edge in (64, 128, 192, 256)],
        "suns": [(str(n), once(suns=ring(n))) for n in (1, 2, 4, 8)],
        "optical density": [(f"{s:g}", once(medium=Medium(s, 1.0, 0.857))) for s in (1.0, 10.0, 100.0, 1000.0)],
        "albedos": [
            (name, once(medium=Medium(100.0, albedo, 0.857)))
            for name, albedo in (("black", 0.0), ("grey", 0.9), ("three", (0.8, 0.9, 1.0)))
        ],
        "extinction": [
            (name, once(medium=Medium(sigma, 1.0, 0.857)))
            for name, sigma in (("grey", 100.0), ("three", (80.0, 90.0, 100.0)))
        ],
        "threads": [(str(n), once(settings=Settings(threads=n))) for n in (1, 2, 4, 8, 16, 32) if n <= os.cpu_count()],
    }


def cost_table(name: str, rows) -> str:
    lines = [f"| {name} | {' | '.join(STAGES)} | total | ratio |", "|---" * (len(STAGES) + 3) + "|"]
    first = None
    for label, draw in rows:
        report = draw().report
        # Threads share the same work: what falls is the time by the clock.
        seconds = report.seconds if name == "threads" else report.cpu_seconds
        total = seconds["total"]
        first = first or total
        stages = " | ".join(f"{seconds.get(stage, 0.0):.2f}" for stage in STAGES)
        lines.append(f"| {label} | {stages} | {total:.2f} | {total / first:.2f} |")
        print(name, lines[-1], flush=True)
    return "\n".join(lines)


def optimizations_table(size: int) -> str:
    """What each optimization saves: with all of them, then with one at a time switched off."""
    volume, medium = cloud(), Medium(100.0, 0.9, 0.857)
    view = camera_covering(volume, medium, size, COVERAGE)
    # Pixels beside the cloud, and suns that are not needed.
    view = dataclasses.replace(view, resolution=(3 * size // 2, size))
    # Nothing but the last sun lies behind it.
    plate = Surface([[(-9.0, -9.0, 9.0), (9.0, -9.0, 9.0), (0.0, 9.0, 9.0)]], covers=False)
    suns = [SUN, Sun(SUN.direction, 0.5), Sun((0.0, 0.0, 1.0))]

    def draw(optimizations):
        return render([(volume, medium)], suns, view, Settings(optimizations=optimizations), surfaces=[plate])

    lines = ["| switched off | " + " | ".join(STAGES) + " | total | ratio | change |", "|---" * (len(STAGES) + 4) + "|"]
    usual = draw(ALL)
    shown = usual.alpha > MASK_ALPHA
    others = [name for name in OPTIMIZATIONS if name != "unchanged"]
    for name, layer in [
        ("nothing", usual),
        *((name, draw(ALL - {name})) for name in others),
        ("everything", draw(frozenset())),
    ]:
        seconds = layer.report.cpu_seconds
        change = np.sqrt(((layer.rgb - usual.rgb)[shown] ** 2).mean()) / usual.rgb[shown].mean()
        stages = " | ".join(f"{seconds.get(stage, 0.0):.2f}" for stage in STAGES)
        lines.append(
            f"| {name} | {stages} | {seconds['total']:.2f} "
            f"| {seconds['total'] / usual.report.cpu_seconds['total']:.2f} | {change:.1e} |"
        )
        print(lines[-1], flush=True)
    return "\n".join(lines)


def depth_table() -> str:
    lines = ["| view | " + " | ".join(str(n) for n in (1, 2, 3, 4, 8, 16)) + " |", "|---" * 7 + "|"]
    for view in independent_views():
        truth = view.render(Settings(64, optimizations=EVERY_PIXEL))
        cells = [
            error_and_points(view.render(Settings(samples, optimizations=EVERY_PIXEL)), truth)
            for samples in (1, 2, 3, 4, 8, 16)
        ]
        lines.append(f"| {view.name} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def error_and_points(layer, truth) -> str:
    mask = truth.alpha > MASK_ALPHA
    error = np.sqrt(((layer.rgb - truth.rgb)[mask] ** 2).mean()) / truth.rgb[mask].mean()
    return f"{error:.3f} ({layer.report.counts['network points'] / mask.sum():.1f})"


def sharing_table() -> str:
    """Pixels that share beside pixels that do not, in images of different sizes."""
    choices = [(samples, share) for samples in (4, 8) for share in (EVERY_PIXEL, ALL)]
    heads = [f"{n}, {'shared' if share == ALL else 'each'}" for n, share in choices]
    lines = ["| view | pixels | " + " | ".join(heads) + " |", "|---" * (2 + len(choices)) + "|"]
    views = {view.name: view for view in independent_views()}
    for name in SHARING_VIEWS:
        for size in SHARING_SIZES:
            truth = views[name].render(Settings(SHARING_TRUTH, optimizations=EVERY_PIXEL), size)
            layers = [views[name].render(Settings(n, optimizations=share), size) for n, share in choices]
            cells = [error_and_points(layer, truth) for layer in layers]
            lines.append(f"| {name} | {size}² | {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    return "\n".join(lines)


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--tables", nargs="+", metavar="NAME", help="only these, by their names in the program")
    arguments = parser.parse_args(options)
    # Loading the network is not what grows.
    render([(cloud(32), Medium(10.0))], [SUN], Camera(np.eye(4), resolution=(8, 8)))
    makers = {name: functools.partial(cost_table, name, rows) for name, rows in cases(arguments.size).items()}
    makers.update(
        omissions=functools.partial(optimizations_table, arguments.size), error=depth_table, sharing=sharing_table
    )
    if not set(arguments.tables or ()) <= set(makers):
        parser.error(f"there are these tables: {', '.join(makers)}")
    for name in arguments.tables or makers:
        write_tables(f"speed-{name.replace(' ', '-')}", makers[name](), [made_by(PROGRAM, options)])


if __name__ == "__main__":
    main()
