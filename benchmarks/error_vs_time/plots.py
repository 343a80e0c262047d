# SPDX-License-Identifier: GPL-3.0-or-later
"""Plots of `benchmarks.error_vs_time`."""

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

from .cases import ENLARGED
from .page import (
    CYCLES,
    DENOISED,
    NULL,
    NULL_DENOISED,
    at_size,
    counted,
    cycles,
    label,
    of_the_set,
    seconds_to_error,
    ways,
)

COLOURS = {
    CYCLES: "#1f77b4",
    DENOISED: "#17a2a2",
    NULL: "#4b5fd6",
    NULL_DENOISED: "#3f9b5f",
    "single-scattering": "#7f7f7f",
    "multi-octave": "#b8860b",
}
# Of Cycles' versions.
LINES = ("-", "--", ":")
LAYER_COLOUR = "#c0392b"
ERRORS = 0.01, 30.0
COLUMNS = 4
GROWING = (
    ("size", "pixels per edge"),
    ("cells", "voxels per edge"),
    ("suns", "suns"),
    ("albedo", "albedo"),
    ("optical_density", "optical density"),
    ("anisotropy", "G"),
)


def save_ladders(results, path: Path) -> None:
    """A panel per scene: error against processor seconds, with intervals."""
    main = of_the_set(results)
    if not main:
        return
    versions = list(dict.fromkeys(cycles(result) for result in main))
    panels = {label(result): [other for other in main if label(other) == label(result)] for result in main}
    rows = math.ceil(len(panels) / COLUMNS)
    figure, axes = pyplot.subplots(
        rows,
        COLUMNS,
        figsize=(3.2 * COLUMNS, 2.5 * rows),
        squeeze=False,
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    for axis in axes.flat[len(panels) :]:
        axis.axis("off")
    for (title, same), axis in zip(panels.items(), axes.flat):
        axis.set_title(title, fontsize=8)
        for result in same:
            _ladder(axis, result, LINES[versions.index(cycles(result)) % len(LINES)], result is same[0])
    figure.legend(*axes[0, 0].get_legend_handles_labels(), fontsize=7, loc="outside upper center", ncols=5)
    figure.supxlabel("processor seconds", fontsize=9)
    figure.supylabel("relative error", fontsize=9)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _ladder(axis, result, line: str, layers: bool) -> None:
    """layers: whether to draw the layer's, too, which is the same beside any version of Cycles."""
    own = [*ways(result, False), *ways(result, True)]
    for method in dict.fromkeys(rung["method"] for rung in result["rungs"] if layers or rung["method"] in own):
        found = sorted((r for r in result["rungs"] if r["method"] == method), key=lambda r: r["samples"])
        seconds = [r["cpu_seconds"] for r in found]
        errors = [r["rmse"]["value"] or r["rmse"]["high"] for r in found]
        bars = [
            [max(e - r["rmse"]["low"], 0.0) for e, r in zip(errors, found)],
            [max(r["rmse"]["high"] - e, 0.0) for e, r in zip(errors, found)],
        ]
        axis.errorbar(
            seconds,
            errors,
            yerr=bars,
            label=cycles(result, method) if method in own else method,
            color=COLOURS.get(method, LAYER_COLOUR),
            fmt=f"o{line}",
            markersize=3,
            linewidth=1,
            elinewidth=1,
        )
    axis.set_xscale("log")
    axis.set_yscale("log")
    # Intervals that reach 0 would take all of the room.
    axis.set_ylim(ERRORS)
    axis.tick_params(labelsize=7)
    axis.grid(True, color="#e4e4e4", linewidth=0.5)


def save_headline(results, path: Path) -> None:
    """A row per scene: processor seconds for an image of the larger size, and Cycles' to the same error."""
    main = counted(of_the_set(results))
    size = ENLARGED * results[0]["case"]["size"]
    known = {}
    for r, timed in ((r, at_size(r, size, results)) for r in main if r["judged"]["rmse"]["value"]):
        needed = min(seconds_to_error(r, method, None, timed) for method in ways(r, False)) if timed else math.inf
        if needed < known.get(label(r), (math.inf,))[0]:
            known[label(r)] = needed, r, timed
    known = sorted(known.values(), key=lambda one: one[0])
    if not known:
        return
    figure, axis = pyplot.subplots(figsize=(8.0, 0.24 * len(known) + 1.0), layout="constrained")
    layer = [timed["judged"] for _, _, timed in known]
    points = {
        "the layer, a further frame": (LAYER_COLOUR, "|", [j["cpu_seconds"] - j["once_cpu"] for j in layer]),
        "the layer": (LAYER_COLOUR, "o", [j["cpu_seconds"] for j in layer]),
        "Cycles at its quickest, to the same error": (
            COLOURS[CYCLES],
            "o",
            [needed for needed, _, _ in known],
        ),
    }
    rows = range(len(known))
    axis.hlines(
        rows,
        points["the layer"][2],
        points["Cycles at its quickest, to the same error"][2],
        color="#d8d8d8",
        linewidth=1,
    )
    for name, (colour, marker, seconds) in points.items():
        axis.plot(seconds, rows, marker, color=colour, label=name, markersize=5)
    axis.set_yticks(rows, [f"{label(r)}: error {r['judged']['rmse']['value']:.2f}" for _, r, _ in known], fontsize=7)
    axis.set_xscale("log")
    axis.set_xlabel(f"processor seconds, {size} × {size} pixels", fontsize=8)
    axis.tick_params(axis="x", labelsize=7)
    axis.grid(True, axis="x", color="#e4e4e4", linewidth=0.5)
    axis.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.3, -0.12), ncols=3, frameon=False)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def save_growth(results, path: Path) -> None:
    """A panel for each thing that grows: the layer's seconds, and Cycles' to an error of 0.1."""
    base, version = results[0]["case"], cycles(results[0])
    same_version = [result for result in results if cycles(result) == version]
    figure, axes = pyplot.subplots(2, 3, figsize=(9.6, 5.2), layout="constrained")
    for (key, title), axis in zip(GROWING, axes.flat):
        same = sorted(
            (r for r in same_version if all(r["case"][k] == base[k] for k in base if k not in (key, "growth"))),
            key=lambda r: r["case"][key],
        )
        values = [r["case"][key] for r in same]
        laws = [r["path_tracing"][CYCLES]["cpu_seconds"] for r in same]
        axis.plot(values, [r["judged"]["cpu_seconds"] for r in same], "o-", color=LAYER_COLOUR, label="layer, first")
        axis.plot(
            values,
            [r["judged"]["cpu_seconds"] - r["judged"]["once_cpu"] for r in same],
            "o--",
            color=LAYER_COLOUR,
            label="layer, frame",
        )
        axis.plot(
            values,
            [law["start"] + law["each"] * law["variance"] / 0.01 for law in laws],
            "o-",
            color=COLOURS["cycles"],
            label=f"{version}, to an error of 0.1",
        )
        if key not in ("albedo", "anisotropy"):
            axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel(title, fontsize=8)
        axis.tick_params(labelsize=7, which="both")
        axis.grid(True, color="#e4e4e4", linewidth=0.5)
    axes[0, 0].legend(fontsize=6)
    figure.supylabel("processor seconds", fontsize=9)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
