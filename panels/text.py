# SPDX-License-Identifier: GPL-3.0-or-later
"""Wraps sentences in panels, whose labels do not wrap, and tells in them which names cannot be read."""

import functools
import re
from collections.abc import Callable
from typing import Any

import blf
import bpy

from ..inference.scene import SceneError
from ..mrpnn_addon.runtime.text import label, safe_text, utf8_names

# Margins of panel and box, icon and label padding, in pixels at scale 1.
MARGIN = 72
# Units that stay beside their numbers.
UNITS = "s|min|h|GiB"


Draw = Callable[[Any, "bpy.types.Context"], None]


def tells_names(draw: Draw) -> Draw:
    """A panel's `draw` that shows, instead of an error on the console, a name in the file that is not UTF-8."""

    @functools.wraps(draw)
    def told(self: Any, context: "bpy.types.Context") -> None:
        try:
            with utf8_names():
                draw(self, context)
        except SceneError as problem:
            draw_text(context, self.layout, str(problem), "ERROR")

    return told


def draw_text(context: "bpy.types.Context", layout: "bpy.types.UILayout", text: str, icon: Any = "NONE") -> None:
    """Draw a sentence as labels that fit the region's width, the icon before the first."""
    scale, points = context.preferences.system.ui_scale, context.preferences.ui_styles[0].widget.points
    blf.size(0, points * scale)
    column = layout.column(align=True)
    column.scale_y = 0.8
    width = context.region.width - MARGIN * scale
    for index, line in enumerate(wrapped(safe_text(text), width, lambda part: blf.dimensions(0, part)[0])):
        label(column, line, icon=icon if index == 0 or icon == "NONE" else "BLANK1")


def wrapped(text: str, width: float, measure: Callable[[str], float]) -> list:
    """The words of a text in lines that are no wider than `width` by `measure`; wider words are split.

    A number and its unit are one word.
    """
    lines = [""]
    for word in re.split(rf"\s+(?!%|(?<=\d\s)(?:{UNITS})\b)", text.strip()):
        longer = f"{lines[-1]} {word}".lstrip()
        if measure(longer) <= width:
            lines[-1] = longer
            continue
        lines += [""] if lines[-1] else []
        for letter in word:
            if lines[-1] and measure(lines[-1] + letter) > width:
                lines.append("")
            lines[-1] += letter
    return lines
