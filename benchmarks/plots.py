# SPDX-License-Identifier: GPL-3.0-or-later
"""Plots of the tables in docs/tables, into docs/images: made again without measuring.

    python -m benchmarks.plots [NAME ...]

Each plot is drawn from CSV files alone. Those of `benchmarks.error_vs_time`, of `benchmarks.fidelity.calibration` and
of `benchmarks.fidelity.convergence` need more than their tables; these programs draw them.
"""

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

from .support.pages import IMAGES, TABLES, read_csv

COLOURS = ("#c0392b", "#1f77b4", "#3f9b5f", "#b8860b", "#7f5fb6", "#7f7f7f")
NUMBER = r"[+-]?\d[\d ]*(?:\.\d+)?(?:e[+-]?\d+)?"


class Value(NamedTuple):
    """A figure with its interval; low and high are the figure itself where a cell has none."""

    value: float
    low: float
    high: float


def value(cell: str) -> Value | None:
    """The first figure of a cell such as "0.066 (0.048–0.083)", "below 0.02" or "+1.3 %"; None where there is none."""
    first = re.search(NUMBER, cell)
    if not first:
        return None
    known = _float(first.group())
    if cell.startswith("below"):
        return Value(known, 0.0, known)
    span = re.search(rf"\(({NUMBER})(?:–| to )({NUMBER})\)", cell)
    return Value(known, _float(span[1]), _float(span[2])) if span else Value(known, known, known)


def _float(text: str) -> float:
    return float(text.replace(" ", ""))


class Series(NamedTuple):
    """Points of one colour: their name in the legend, and a figure or None for each row."""

    name: str
    values: list[Value | None]


def columns(rows: Sequence[dict], *names: str) -> list[Series]:
    """A series for each of some columns of a table."""
    return [Series(name, [value(row[name]) for row in rows]) for name in names]


def dots(axis, labels: Sequence[str], series: Sequence[Series], title: str, log: bool = False) -> None:
    """A line for each label, with a dot and an interval for each series."""
    places = range(len(labels))
    for one, colour in zip(series, COLOURS):
        known = [(place, found) for place, found in zip(places, one.values) if found]
        axis.errorbar(
            [found.value for _, found in known],
            [place for place, _ in known],
            xerr=[
                [max(found.value - found.low, 0.0) for _, found in known],
                [max(found.high - found.value, 0.0) for _, found in known],
            ],
            fmt="o",
            color=colour,
            label=one.name,
            markersize=3,
            elinewidth=0.8,
        )
    axis.set_yticks(places, labels, fontsize=6)
    axis.set_ylim(len(labels) - 0.5, -0.5)
    axis.set_xlabel(title, fontsize=7)
    axis.set_xscale("log" if log else "linear")
    axis.tick_params(axis="x", labelsize=6)
    axis.grid(True, color="#e4e4e4", linewidth=0.5)


def figure(name: str, heights: Sequence[int], width: float = 7.5):
    """A figure with panels below each other for some numbers of lines, and what saves it as NAME.png."""
    made, axes = pyplot.subplots(
        len(heights),
        1,
        figsize=(width, 0.13 * sum(heights) + 0.75 * len(heights)),
        squeeze=False,
        height_ratios=heights,
        layout="constrained",
    )

    def save() -> None:
        for axis in axes.flat:
            if len(axis.get_legend_handles_labels()[1]) > 1:
                axis.legend(fontsize=6)
        made.savefig(IMAGES / f"{name}.png", dpi=110)
        pyplot.close(made)

    return axes[:, 0], save


def simple(name: str, title: str, *wanted: str, log: bool = False, table: str = "") -> None:
    """A table whose first columns of words name its rows, and some columns of figures, as one panel."""
    rows = read_csv(TABLES / f"{table or name}.csv")
    first = [key for key in list(rows[0])[: list(rows[0]).index(wanted[0])] if not _is_figure(rows[0][key])]
    axes, save = figure(name, [len(rows)])
    labels = [" · ".join(filter(None, (row[key].strip("*") for key in first))) for row in rows]
    dots(axes[0], labels, columns(rows, *wanted), title, log)
    save()


def _is_figure(cell: str) -> bool:
    return re.fullmatch(NUMBER, cell) is not None


def accuracy() -> None:
    """Errors on the independent views, by system."""
    rows = read_csv(TABLES / "fidelity.csv")
    views = list(dict.fromkeys(row["view"] for row in rows))
    systems = list(dict.fromkeys(row["system"] for row in rows))
    found = {
        (row["view"], row["system"]): Value(*(float(row[key]) for key in ("rmse", "rmse_low", "rmse_high")))
        for row in rows
    }
    axes, save = figure("accuracy", [2 * len(views)])
    series = [Series(system, [found.get((view, system)) for view in views]) for system in systems]
    dots(axes[0], views, series, "relative RMSE, 95 % intervals")
    save()


def accuracy_real() -> None:
    """Biases on real volumes, by light and G."""
    rows = read_csv(TABLES / "accuracy-real.csv")
    kinds = list(rows[0])[2:]
    axes, save = figure("accuracy-real", [2 * len(rows)])
    series = [Series(kind, [value(row[kind].split(" ", 1)[1]) for row in rows]) for kind in kinds]
    labels = [f"{row['volume'].strip('*')} {row['optical density']}" for row in rows]
    dots(axes[0], labels, series, "bias in %, by volume and optical density")
    save()


def accuracy_lamps() -> None:
    """Errors of multiple scattering of lamps, by their place."""
    rows = read_csv(TABLES / "accuracy-lamps.csv")
    keys = list(dict.fromkeys((row["volume"], row["G"], row["extinction"]) for row in rows))
    places = list(dict.fromkeys(row["light"] for row in rows))
    found = {(row["volume"], row["G"], row["extinction"], row["light"]): value(row["RMSE"]) for row in rows}
    axes, save = figure("accuracy-lamps", [2 * len(keys)])
    series = [Series(place, [found.get((*key, place)) for key in keys]) for place in places]
    labels = [f"volume {volume}, G {g}, extinction {extinction}" for volume, g, extinction in keys]
    dots(axes[0], labels, series, "relative RMSE of multiple scattering, by the lamp's place")
    save()


def scenes() -> None:
    """Error and bias of every scene against Cycles."""
    rows = read_csv(TABLES / "scenes.csv")
    axes, save = figure("scenes", [len(rows)], width=9.0)
    labels = [row["scene"] for row in rows]
    dots(axes[0], labels, columns(rows, "whole RMSE"), "relative RMSE against Cycles, 95 % intervals", log=True)
    axes[0].set_xlim(0.003, 3.0)
    save()


def speed_growth() -> None:
    """Processor seconds of a render where one thing changes."""
    names = ("pixels", "depth samples", "voxels", "suns", "optical density", "albedos", "extinction", "threads")
    made, axes = pyplot.subplots(2, 4, figsize=(9.0, 4.0), sharey=True, layout="constrained")
    for name, axis in zip(names, axes.flat):
        rows = read_csv(TABLES / f"speed-{name.replace(' ', '-')}.csv")
        bottom = [0.0] * len(rows)
        for part, colour in zip(("shadows", "fields", "march", "network"), COLOURS):
            heights = [float(row[part]) for row in rows]
            axis.bar([row[name] for row in rows], heights, bottom=bottom, color=colour, label=part)
            bottom = [low + height for low, height in zip(bottom, heights)]
        axis.set_title(name, fontsize=8)
        axis.tick_params(labelsize=6)
    axes[0, 0].legend(fontsize=6)
    made.supylabel("seconds", fontsize=8)
    made.savefig(IMAGES / "speed-growth.png", dpi=110)
    pyplot.close(made)


def speed_lights() -> None:
    """Processor seconds of lights beside those of one sun."""
    tables = ("speed-environments", "speed-lamps", "speed-many-lamps")
    rows = [row for table in tables for row in read_csv(TABLES / f"{table}.csv")]
    rows = [row for row in rows if row["light"] != "one white sun"]
    axes, save = figure("speed-lights", [len(rows)])
    labels = [f"{row['light']}, {row['pixels'].replace('x', ' × ')}" for row in rows]
    dots(axes[0], labels, columns(rows, "beside one sun"), "processor seconds over those of one sun")
    save()


def speed_depth_samples() -> None:
    """Errors by the number of depth samples."""
    rows = read_csv(TABLES / "speed-error.csv")
    samples = list(rows[0])[1:]
    axes, save = figure("speed-depth-samples", [26])
    for row in rows:
        axes[0].plot(
            [int(one) for one in samples],
            [value(row[one]).value for one in samples],
            "o-",
            color=COLOURS[1],
            markersize=3,
            linewidth=0.8,
        )
    axes[0].set(xscale="log", yscale="log")
    axes[0].set_xticks([int(one) for one in samples], samples, fontsize=6)
    axes[0].set_xticks([], minor=True)
    axes[0].set_xlabel("depth samples; a line for each shared view", fontsize=7)
    axes[0].set_ylabel("relative RMSE against 64", fontsize=7)
    axes[0].tick_params(axis="y", labelsize=6)
    axes[0].grid(True, color="#e4e4e4", linewidth=0.5)
    save()


def cycles_settings() -> None:
    """Error and processor seconds of ways to set Cycles, a panel for each view and version."""
    rows = read_csv(TABLES / "cycles-settings.csv")
    panels = list(dict.fromkeys((row["view"], row["version"]) for row in rows))
    parts = [[row for row in rows if (row["view"], row["version"]) == panel] for panel in panels]
    axes, save = figure("cycles-settings", [len(part) for part in parts], width=8.0)
    for axis, part, (view, version) in zip(axes, parts, panels):
        errors = [Value(*(float(row[key]) for key in ("error", "low", "high"))) for row in part]
        seconds = [Value(*[float(row["seconds"])] * 3) for row in part]
        labels = [f"{row['settings']}, {row['samples']}" for row in part]
        title = f"{view}, Blender {version}"
        dots(axis, labels, [Series("error", errors), Series("processor seconds", seconds)], title, log=True)
    save()


def stability_margins() -> None:
    """The share of its bound that each error takes, by group of cases."""
    rows = [row for row in read_csv(TABLES / "stability.csv") if float(row["bound"]) > 0.0]
    groups = list(dict.fromkeys(row["group"] for row in rows))
    axes, save = figure("stability-margins", [len(groups)])
    for place, group in enumerate(groups):
        shares = [float(row["error"]) / float(row["bound"]) for row in rows if row["group"] == group]
        axes[0].plot([max(share, 1e-6) for share in shares], [place] * len(shares), "|", color=COLOURS[1])
    dots(axes[0], groups, [], "error over its bound; 1 is the most that a test allows", log=True)
    axes[0].axvline(1.0, color=COLOURS[0], linewidth=0.8)
    save()


def baked_speed() -> None:
    """Error against processor seconds of baked light and of 1024 bounces, at two sizes."""
    made, axes = pyplot.subplots(1, 2, figsize=(9.0, 3.4), sharey=True, layout="constrained")
    for axis, name, title in zip(axes, ("baked-speed", "baked-speed-512"), ("96 × 96", "512 × 512")):
        rows = [row for row in read_csv(TABLES / f"{name}.csv") if row["error"]]
        for kind, colour in zip(dict.fromkeys(row["row"] for row in rows), COLOURS):
            mine = [row for row in rows if row["row"] == kind]
            axis.plot(
                [value(row["processor seconds"]).value for row in mine],
                [value(row["error"]).value for row in mine],
                "o",
                color=colour,
                label=kind,
                markersize=4,
            )
            for row in mine:
                place = value(row["processor seconds"]).value, value(row["error"]).value
                axis.annotate(row["samples"], place, fontsize=5, xytext=(3, 3), textcoords="offset points")
        axis.set(xscale="log", yscale="log")
        axis.set_title(f"{title} pixels; numbers are samples", fontsize=8)
        axis.set_xlabel("processor seconds, without the bake", fontsize=7)
        axis.tick_params(labelsize=6, which="both")
        axis.grid(True, color="#e4e4e4", linewidth=0.5)
    axes[0].set_ylabel("error", fontsize=7)
    axes[1].legend(fontsize=6)
    made.savefig(IMAGES / "baked-speed.png", dpi=110)
    pyplot.close(made)


#: What draws each plot, by the plot's name in docs/images.
PLOTS: dict[str, Callable[[], None]] = {
    "accuracy": accuracy,
    "accuracy-real": accuracy_real,
    "accuracy-worlds": lambda: simple(
        "accuracy-worlds", "relative RMSE; the second is of the network alone", "RMSE", "predicted alone: RMSE"
    ),
    "accuracy-lamps": accuracy_lamps,
    "stated-error": lambda: simple(
        "stated-error",
        "relative RMSE, 95 % intervals",
        "expected (95 %)",
        "found (95 %)",
        table="stated-error-independent",
    ),
    "scenes": scenes,
    "speed-growth": speed_growth,
    "speed-lights": speed_lights,
    "speed-depth-samples": speed_depth_samples,
    "speed-omissions": lambda: simple(
        "speed-omissions", "processor seconds, over those with all optimizations", "ratio"
    ),
    "cycles-settings": cycles_settings,
    "stability-margins": stability_margins,
    "baked-directions": lambda: simple("baked-directions", "relative RMSE", "layer", "baked light", "turned by 40°"),
    "baked-speed": baked_speed,
    "real-sizes": lambda: simple(
        "real-sizes",
        "times as long as the layer to its error",
        "geometric mean of times as long",
        log=True,
        table="real-sizes-1",
    ),
}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.plots", description=__doc__.split("\n\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"all by default: {', '.join(PLOTS)}")
    names = parser.parse_args(arguments).names or list(PLOTS)
    if not set(names) <= set(PLOTS):
        parser.error(f"there are these plots: {', '.join(PLOTS)}")
    for name in names:
        PLOTS[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main())
