# SPDX-License-Identifier: GPL-3.0-or-later
"""Output of the command line: text, or one JSON object per line."""

import json
import sys
from collections.abc import Callable
from typing import Any

from ..mrpnn_addon.runtime.text import safe_text


class Console:
    """Writes to stdout; warnings and errors of the text form go to stderr.

    machine: whether to write JSON, one object per line, with an "event": "progress", "warning", "estimate", "frame",
    "skipped", "report", "comparison", "error" or "end".
    """

    def __init__(self, machine: bool) -> None:
        self.machine = machine
        self._tenth = -1

    def event(self, kind: str, text: str, **facts: Any) -> None:
        """Write `text`, or all `facts` as JSON."""
        if self.machine:
            # One complete line: Blender prints to the same stream.
            print(json.dumps({"event": kind, **facts}), flush=True)
        elif text:
            loud = kind in ("warning", "error")
            line = safe_text(f"mrpnn: {f'{kind}: ' if loud else ''}{text}")
            print(line, file=sys.stderr if loud else sys.stdout, flush=True)

    def progress(self, frame: int) -> Callable[[float, str], None]:
        """A progress(fraction, message) for one frame that writes at each tenth."""
        self._tenth = -1

        def write(fraction: float, message: str) -> None:
            if int(fraction * 10) > self._tenth:
                self._tenth = int(fraction * 10)
                self.event(
                    "progress",
                    f"frame {frame}: {fraction:4.0%} {message}",
                    frame=frame,
                    fraction=round(fraction, 3),
                    message=message,
                )

        return write
