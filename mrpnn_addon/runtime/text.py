# SPDX-License-Identifier: GPL-3.0-or-later
"""Texts for Blender and for files, made safe: the only place that hands Blender a text that is not constant.

Paths may hold bytes that are not UTF-8, which Python shows as lone surrogates. Blender's functions raise an error for
them, and one that is raised while Blender renders can end the process.
"""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ...inference.scene import SceneError

# Lone surrogates, and the end of a text in C.
_UNSAFE = re.compile("[\ud800-\udfff\0]")


def safe_text(text: object) -> str:
    r"""`str(text)` as valid UTF-8: bytes that are not are shown as \xff."""
    return _UNSAFE.sub(_shown, str(text))


def text_of(data: Any, name: str) -> str:
    """A text that is a property of Blender's `data`; reading one that is not UTF-8 raises an error."""
    try:
        return safe_text(getattr(data, name))
    except UnicodeDecodeError as error:
        return error.object.decode("utf-8", "backslashreplace")


@contextmanager
def utf8_names() -> Iterator[None]:
    """Around what reads names of Blender's data: raises SceneError for one that is not UTF-8."""
    try:
        yield
    except UnicodeDecodeError as error:
        name = error.object.decode("utf-8", "backslashreplace")
        raise SceneError(f'the name "{name}" in this file is not UTF-8; rename it in the Outliner') from None


def report(reporter: Any, kind: str, text: object) -> None:
    """Report a text to Blender; never raises. reporter: an operator or an engine. kind: "INFO", "WARNING", "ERROR"."""
    try:
        reporter.report({kind}, safe_text(text))
    except Exception as error:  # Such as ReferenceError, where Blender has freed the reporter.
        print(f"MRPNN could not report to Blender ({error}): {safe_text(text)}", file=sys.stderr)


def reason(error: RuntimeError) -> str:
    """What Blender says of a function that failed, in one line."""
    return str(error).strip().partition("\n")[0].removeprefix("Error: ")


def label(layout: Any, text: object, icon: str = "NONE") -> None:
    """Draw a label in a panel."""
    layout.label(text=safe_text(text), icon=icon)


def status_bar(context: Any, text: str | None) -> None:
    """Show a text in the status bar; None gives the bar back to Blender."""
    context.workspace.status_text_set(None if text is None else safe_text(text))


def render_status(engine: Any, text: object) -> None:
    """Show what an engine does, in the image's header or in the viewport's corner."""
    engine.update_stats("", safe_text(text))


def stamp_field(result: Any, name: str, value: object) -> None:
    """Add a field to the metadata of a render result."""
    result.stamp_data_add_field(safe_text(name), safe_text(value))


def duration(seconds: float) -> str:
    """Seconds, or minutes of long ones, such as "12 s"."""
    return f"{max(round(seconds), 1)} s" if seconds < 100 else f"{round(seconds / 60)} min"


def percent(fraction: float) -> str:
    """How much of some work is done, in whole percent: 100 % is its end."""
    return f"{int(100.0 * fraction)}%"


def _shown(letter: re.Match[str]) -> str:
    code = ord(letter[0])
    # What stands for the bytes 0x80 to 0xff.
    return f"\\x{code & 0xFF:02x}" if code == 0 or 0xDC80 <= code <= 0xDCFF else f"\\u{code:04x}"
