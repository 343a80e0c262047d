# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against run time on logarithmic axes: layout, and the chart as SVG."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from ...evaluation.error_vs_time import Rung
from ...inference.network.baselines import OCTAVES, SINGLE
from ..cycles.choices import CHOICES, CYCLES, DENOISED, LADDERS, NULL, NULL_DENOISED

WIDTH, HEIGHT = 760, 440
# Left, top, right and bottom edge of the plot in the image.
FRAME = (64, 18, 742, 392)
# Left edge of the legend, from the right of the plot.
LEGEND = 215
# The points of Cycles as artists set it, which are no ladder.
USUAL_SERIES = "cycles as artists set it"
COLOURS = {
    CYCLES: "#1f77b4",
    DENOISED: "#17a2a2",
    NULL: "#4b5fd6",
    NULL_DENOISED: "#3f9b5f",
    USUAL_SERIES: "#101820",
    SINGLE: "#7f7f7f",
    OCTAVES: "#b8860b",
}
NETWORK_COLOURS = ("#c0392b", "#8e44ad", "#e67e22", "#d6568f", "#5d4037", "#2e7d32")


@dataclass
class Chart:
    """series: rungs by method, in drawing order, those of Cycles as artists set it in one; errors indistinguishable
    from 0 are at their interval's upper end. x, y: (lowest, highest) of the axes, seconds and relative error. clock: of
    the rungs.
    """

    series: dict[str, list[Rung]]
    x: tuple[float, float]
    y: tuple[float, float]
    clock: str = "seconds"

    def place(self, seconds: float, error: float) -> tuple[float, float]:
        """Pixels from the upper left."""
        left, top, right, bottom = FRAME
        across = np.log(seconds / self.x[0]) / np.log(self.x[1] / self.x[0])
        up = np.log(np.clip(error, *self.y) / self.y[0]) / np.log(self.y[1] / self.y[0])
        return float(left + across * (right - left)), float(bottom - up * (bottom - top))

    def point(self, rung: Rung) -> tuple[float, float]:
        return self.place(getattr(rung, self.clock), rung.error)

    def bar(self, rung: Rung) -> tuple[float, float]:
        """Upper and lower end of the interval, in pixels from the top."""
        x = getattr(rung, self.clock)
        return self.place(x, max(rung.rmse.high, rung.error))[1], self.place(x, rung.rmse.low or self.y[0])[1]

    def colour(self, method: str) -> str:
        networks = [name for name in self.series if name not in COLOURS]
        return COLOURS.get(method) or NETWORK_COLOURS[networks.index(method) % len(NETWORK_COLOURS)]


def make_chart(rungs: list[Rung], clock: str = "seconds") -> Chart:
    """The chart of rungs, by method and time, with axes that end at 1, 2 or 5 of a decade. Raises ValueError without
    rungs.
    """
    series: dict[str, list[Rung]] = {}
    for rung in rungs:
        if rung.error > 0.0 and getattr(rung, clock) > 0.0:
            usual = rung.method in CHOICES and rung.method not in LADDERS
            series.setdefault(USUAL_SERIES if usual else rung.method, []).append(rung)
    if not series:
        raise ValueError("no image has an error that can be told from 0")
    for found in series.values():
        found.sort(key=lambda rung: rung.samples)
    shown = [rung for found in series.values() for rung in found]
    return Chart(series, _axis([getattr(rung, clock) for rung in shown]), _axis([rung.error for rung in shown]), clock)


def ticks(low: float, high: float) -> list:
    """1, 2 and 5 of each decade from low to high."""
    found = [step * 10.0**decade for decade in range(-9, 10) for step in (1, 2, 5)]
    return [value for value in found if low * 0.999 <= value <= high * 1.001]


def _axis(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    steps = ticks(low / 6, high * 6)
    return max(v for v in steps if v < low), min(v for v in steps if v > high)


def svg(chart: Chart) -> str:
    """The chart as an SVG element; each point has its figures as a tooltip."""
    left, top, right, bottom = FRAME
    parts = [
        f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        'aria-label="Relative error against seconds, logarithmic axes">'
    ]
    for value in ticks(*chart.x):
        x = chart.place(value, chart.y[0])[0]
        parts.append(
            f'<line class="grid" x1="{x:.1f}" y1="{top}" x2="{x:.1f}" y2="{bottom}"/>'
            f'<text x="{x:.1f}" y="{bottom + 16}" text-anchor="middle">{value:g}</text>'
        )
    for value in ticks(*chart.y):
        y = chart.place(chart.x[0], value)[1]
        parts.append(
            f'<line class="grid" x1="{left}" y1="{y:.1f}" x2="{right}" y2="{y:.1f}"/>'
            f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>'
        )
    clock = "seconds" if chart.clock == "seconds" else "processor seconds"
    parts.append(
        f'<text x="{(left + right) / 2}" y="{HEIGHT - 8}" text-anchor="middle">{clock} per frame</text>'
        f'<text transform="translate(14 {(top + bottom) / 2}) rotate(-90)" text-anchor="middle">'
        "relative error (RMSE)</text>"
    )
    for number, (method, rungs) in enumerate(chart.series.items()):
        parts.append(_series(chart, method, rungs))
        y = top + 16 + 17 * number
        parts.append(
            f'<circle cx="{right - LEGEND}" cy="{y - 4}" r="4" fill="{chart.colour(method)}"/>'
            f'<text x="{right - LEGEND + 10}" y="{y}">{escape(method)}</text>'
        )
    return "\n".join(parts) + "\n</svg>"


def _series(chart: Chart, method: str, rungs: list[Rung]) -> str:
    colour = chart.colour(method)
    places = [chart.point(rung) for rung in rungs]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    parts = []
    if method != USUAL_SERIES:
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
    for rung, (x, y) in zip(rungs, places):
        upper, lower = chart.bar(rung)
        note = (
            f"{rung.method}, {rung.samples} samples: {getattr(rung, chart.clock):.3g} s, error {rung.rmse.value:.3f} "
            f"({rung.rmse.low:.3f} to {rung.rmse.high:.3f})"
        )
        parts.append(
            f'<g class="point"><title>{escape(note)}</title>'
            f'<line class="bar" x1="{x:.1f}" y1="{upper:.1f}" x2="{x:.1f}" y2="{lower:.1f}" stroke="{colour}"/>'
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/></g>'
        )
    return "".join(parts)
