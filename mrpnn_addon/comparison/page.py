# SPDX-License-Identifier: GPL-3.0-or-later
"""A comparison as one self-contained HTML page: pictures, chart and tables."""

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template

from ...evaluation.error import error_text
from ...evaluation.error_vs_time import Rung
from ..cycles.choices import CHOICES
from .chart import make_chart, svg
from .results import Comparison

TEMPLATE = Path(__file__).with_name("page.html")
# Error, as a share of the reference's mean, that saturates the signed error map.
ERROR_LIMIT = 0.5


def page(
    comparison: Comparison,
    title: str,
    pictures: dict[str, bytes],
    error_map: bytes,
    reference: str,
    facts: dict[str, str],
) -> str:
    """The page's text.

    pictures: PNG files by caption, the judged layer first. reference: caption of the reference. error_map: PNG. facts:
    conditions of the measurement.
    """
    width, height = comparison.resolution
    try:
        chart = svg(make_chart(comparison.rungs, comparison.clock))
    except ValueError as problem:
        chart = f'<p class="note">No chart: {escape(str(problem))}.</p>'
    return Template(TEMPLATE.read_text()).substitute(
        title=escape(title),
        width=width,
        height=height,
        chart=chart,
        summary=escape(_summary(comparison)),
        notes="".join(
            f'<p class="note">{escape(text)}</p>'
            for text in (*_verdict(comparison), *comparison.marks, *comparison.warnings)
        ),
        sentences="".join(f"<li>{escape(text)}</li>" for text in comparison.sentences()),
        left_options=_options(pictures, next(iter(pictures))),
        right_options=_options(pictures, reference),
        pictures=json.dumps({caption: _data(png) for caption, png in pictures.items()}).replace("<", "\\u003c"),
        error_map=_data(error_map),
        error_low=f"−{ERROR_LIMIT:.0%}",
        error_high=f"+{ERROR_LIMIT:.0%}",
        table=_table(
            [
                f"image (Cycles: {comparison.cycles})",
                "samples",
                "error (95 %)",
                "bias (95 %)",
                "seconds",
                "once",
                "processor seconds",
                "FLIP",
            ],
            [_row(rung) for rung in comparison.rungs],
        ),
        equal_table=_table(
            [
                f"Cycles {comparison.cycles}",
                "clock",
                "the layer's seconds",
                "seconds to its error",
                "times as long",
                "as a further frame",
                "error in its time",
            ],
            [
                [
                    one.method,
                    "wall" if one.clock == "seconds" else "processor",
                    f"{one.seconds:.3g}",
                    str(one.needed),
                    f"{one.ratio:.3g}",
                    f"{one.frame_ratio:.3g}",
                    str(one.error),
                ]
                for one in sorted(
                    comparison.equal, key=lambda one: (one.clock, CHOICES[one.method].denoised, one.ratio)
                )
            ],
        ),
        facts=_table(["", ""], [[key, value] for key, value in facts.items()]),
    )


def _summary(comparison: Comparison) -> str:
    rmse, bias, judged = comparison.rmse, comparison.bias, comparison.judged
    return (
        f"{judged.method} with {judged.samples} depth samples took {judged.seconds:.2f} s. Its relative error is "
        f"{error_text(rmse.value, rmse.low, rmse.high)}, its bias {bias.value:+.1%} "
        f"({bias.low:+.1%} to {bias.high:+.1%}), with intervals of 95 %."
    )


def _verdict(comparison: Comparison) -> list[str]:
    return [] if comparison.verdict.good else [f"The reference is {comparison.verdict}."]


def _row(rung: Rung) -> list[str]:
    return [
        rung.method,
        str(rung.samples),
        f"{rung.rmse.value:.4f} ({rung.rmse.low:.4f}–{rung.rmse.high:.4f})",
        f"{rung.bias.value:+.1%} ({rung.bias.low:+.1%} to {rung.bias.high:+.1%})",
        f"{rung.seconds:.3g}",
        f"{rung.once:.3g}",
        f"{rung.cpu_seconds:.3g}",
        "" if rung.flip is None else f"{rung.flip:.4f}",
    ]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    return "<table>" + (line(head, "th") if any(head) else "") + "".join(line(row, "td") for row in rows) + "</table>"


def _options(pictures: Mapping[str, bytes], chosen: str) -> str:
    return "".join(
        f"<option{' selected' if caption == chosen else ''}>{escape(caption)}</option>" for caption in pictures
    )


def _data(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode()
