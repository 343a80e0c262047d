# SPDX-License-Identifier: GPL-3.0-or-later
"""The chart of error against run time as an Image data-block."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import blf
import bpy
import imbuf
import numpy as np

from ...evaluation.error_vs_time import Rung
from ..cycles.reference import read_image
from ..output.layer_image import IMAGE_NAME, show_image
from .chart import FRAME, HEIGHT, LEGEND, USUAL_SERIES, WIDTH, Chart, make_chart, ticks

CHART_IMAGE = f"{IMAGE_NAME} chart"
PAPER, INK, GRID = (np.full(3, grey, np.float32) for grey in (0.95, 0.03, 0.75))


def show_chart(rungs: list[Rung], clock: str) -> "bpy.types.Image":
    """Draw the chart of rungs into the Image CHART_IMAGE and return it; None where nothing can be drawn."""
    try:
        chart = make_chart(rungs, clock)
    except ValueError:
        return None
    return show_image(draw(chart), CHART_IMAGE)


def draw(chart: Chart) -> np.ndarray:
    """float32 (HEIGHT, WIDTH, 4), linear, rows from the top."""
    pixels = np.tile(PAPER, (HEIGHT, WIDTH, 1))
    left, top, right, bottom = FRAME
    unit = "seconds" if chart.clock == "seconds" else "processor seconds"
    words: list[tuple[str, float, float]] = [(f"{unit} per frame; relative error", left + 220, bottom + 36)]
    for value in ticks(*chart.x):
        x = chart.place(value, chart.y[0])[0]
        _line(pixels, x, top, x, bottom, GRID)
        words.append((f"{value:g}", x - 8, bottom + 18))
    for value in ticks(*chart.y):
        y = chart.place(chart.x[0], value)[1]
        _line(pixels, left, y, right, y, GRID)
        words.append((f"{value:g}", 18, y + 5))
    for number, (method, rungs) in enumerate(chart.series.items()):
        colour = _linear(chart.colour(method))
        places = [chart.point(rung) for rung in rungs]
        for (x0, y0), (x1, y1) in zip(places, places[1:] if method != USUAL_SERIES else ()):
            _line(pixels, x0, y0, x1, y1, colour)
        for rung, (x, y) in zip(rungs, places):
            upper, lower = chart.bar(rung)
            _line(pixels, x, upper, x, lower, colour)
            _dot(pixels, x, y, colour)
        _dot(pixels, right - LEGEND, top + 12 + 17 * number, colour)
        words.append((method, right - LEGEND + 10, top + 17 + 17 * number))
    ink = _rendered_text(words)[..., None]
    opaque = np.ones((HEIGHT, WIDTH, 1), np.float32)
    return np.concatenate([pixels + (INK - pixels) * ink, opaque], axis=-1)


def _line(pixels: np.ndarray, x0: float, y0: float, x1: float, y1: float, colour: np.ndarray) -> None:
    steps = int(max(abs(x1 - x0), abs(y1 - y0))) + 2
    columns = np.clip(np.rint(np.linspace(x0, x1, steps)).astype(int), 0, WIDTH - 1)
    rows = np.clip(np.rint(np.linspace(y0, y1, steps)).astype(int), 0, HEIGHT - 1)
    pixels[rows, columns] = colour


def _dot(pixels: np.ndarray, x: float, y: float, colour: np.ndarray, radius: float = 4) -> None:
    left, top = max(int(x) - radius, 0), max(int(y) - radius, 0)
    part = pixels[top : top + 2 * radius + 2, left : left + 2 * radius + 2]
    rows, columns = np.indices(part.shape[:2])
    part[(columns + left - x) ** 2 + (rows + top - y) ** 2 <= radius**2] = colour


def _linear(colour: str) -> np.ndarray:
    return np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]) ** 2.2


def _rendered_text(words: Sequence[Any]) -> np.ndarray:
    """Coverage (HEIGHT, WIDTH) of texts, each at (x, y) of its lower left from the image's upper left.

    Empty in versions of Blender that cannot draw text into images in memory.
    """
    if not hasattr(blf, "bind_imbuf"):
        return np.zeros((HEIGHT, WIDTH), np.float32)
    buffer = imbuf.new((WIDTH, HEIGHT))
    blf.size(0, 13)
    blf.color(0, 1.0, 1.0, 1.0, 1.0)
    bound: Any = blf.bind_imbuf(0, buffer)
    with bound:
        for text, x, y in words:
            blf.position(0, x, HEIGHT - y, 0)
            blf.draw_buffer(0, text)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "words.png"
        imbuf.write(buffer, filepath=str(path))
        return read_image(path)[..., :3].max(axis=-1)
