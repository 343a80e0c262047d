# SPDX-License-Identifier: GPL-3.0-or-later
"""Plots of `benchmarks.error_vs_time`."""

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

from .cases import ENLARGED
from .page import CYCLES, at_size, counted, label, of_the_set, seconds_to_error

COLOURS = {"cycles": "#1f77b4", "cycles denoised": "#17a2a2", "single-scattering": "#7f7f7f", "multi-octave": "#b8860b"}
LAYER_COLOUR = "#c0392b"
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
    rows = math.ceil(len(main) / COLUMNS)
    figure, axes = pyplot.subplots(
        rows,
        COLUMNS,
        figsize=(3.2 * COLUMNS, 2.5 * rows),
        squeeze=False,
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    for axis in axes.flat[len(main) :]:
        axis.axis("off")
    for result, axis in zip(main, axes.flat):
        case = result["case"]
        axis.set_title(
            f"{case['volume']}, {case['light']}, G {case['anisotropy']:g}, density {case['optical_density']:g}",
            fontsize=8,
        )
        _ladder(axis, result)
    axes[0, 0].legend(fontsize=6)
    figure.supxlabel("processor seconds", fontsize=9)
    figure.supylabel("relative error", fontsize=9)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _ladder(axis, result) -> None:
    for method in dict.fromkeys(rung["method"] for rung in result["rungs"]):
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
            label=method,
            color=COLOURS.get(method, LAYER_COLOUR),
            fmt="o-",
            markersize=3,
            linewidth=1,
            elinewidth=1,
        )
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.tick_params(labelsize=7)
    axis.grid(True, color="#e4e4e4", linewidth=0.5)


def save_headline(results, path: Path) -> None:
    """A row per scene: processor seconds for an image of the larger size, and Cycles' to the same error."""
    main = counted(of_the_set(results))
    size = ENLARGED * results[0]["case"]["size"]
    known = [(r, at_size(r, size, results)) for r in main if r["judged"]["rmse"]["value"]]
    known = sorted(
        ((r, timed) for r, timed in known if timed), key=lambda one: seconds_to_error(one[0], CYCLES, None, one[1])
    )
    if not known:
        return
    figure, axis = pyplot.subplots(figsize=(8.0, 0.24 * len(known) + 1.0), layout="constrained")
    layer = [timed["judged"] for _, timed in known]
    points = {
        "the layer, a further frame": (LAYER_COLOUR, "|", [j["cpu_seconds"] - j["once_cpu"] for j in layer]),
        "the layer": (LAYER_COLOUR, "o", [j["cpu_seconds"] for j in layer]),
        "Cycles, to the same error": (
            COLOURS[CYCLES],
            "o",
            [seconds_to_error(r, CYCLES, None, timed) for r, timed in known],
        ),
    }
    rows = range(len(known))
    axis.hlines(rows, points["the layer"][2], points["Cycles, to the same error"][2], color="#d8d8d8", linewidth=1)
    for name, (colour, marker, seconds) in points.items():
        axis.plot(seconds, rows, marker, color=colour, label=name, markersize=5)
    axis.set_yticks(rows, [f"{label(r)}: error {r['judged']['rmse']['value']:.2f}" for r, _ in known], fontsize=7)
    axis.set_xscale("log")
    axis.set_xlabel(f"processor seconds, {size} × {size} pixels", fontsize=8)
    axis.tick_params(axis="x", labelsize=7)
    axis.grid(True, axis="x", color="#e4e4e4", linewidth=0.5)
    axis.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.3, -0.12), ncols=3, frameon=False)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def save_growth(results, path: Path) -> None:
    """A panel for each thing that grows: the layer's seconds, and Cycles' to an error of 0.1."""
    base = results[0]["case"]
    figure, axes = pyplot.subplots(2, 3, figsize=(9.6, 5.2), layout="constrained")
    for (key, title), axis in zip(GROWING, axes.flat):
        same = sorted(
            (r for r in results if all(r["case"][k] == base[k] for k in base if k not in (key, "growth"))),
            key=lambda r: r["case"][key],
        )
        values = [r["case"][key] for r in same]
        laws = [r["path_tracing"]["cpu_seconds"] for r in same]
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
            label="Cycles, to an error of 0.1",
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
