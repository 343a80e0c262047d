"""What the command line says while it works: lines for people, or one JSON object a line."""

import json
import sys


class Console:
    """Speaks to stdout; warnings and errors of the text form go to stderr.

    machine: one JSON object a line, each with an "event": "progress", "warning", "frame", "skipped",
    "report", "comparison", "error" or "end".
    """

    def __init__(self, machine: bool):
        self.machine = machine
        self._tenth = -1

    def event(self, kind: str, text: str, **facts) -> None:
        """Say `text`, or in the machine's form all `facts`."""
        if self.machine:
            # A line of its own, in one piece: Blender prints to the same place.
            print(json.dumps({"event": kind, **facts}), flush=True)
        elif text:
            loud = kind in ("warning", "error")
            print(f"mrpnn: {f'{kind}: ' if loud else ''}{text}", file=sys.stderr if loud else sys.stdout, flush=True)

    def progress(self, frame: int):
        """A progress(fraction, message) for one frame that speaks at each tenth of the work."""
        self._tenth = -1

        def tell(fraction, message):
            if int(fraction * 10) > self._tenth:
                self._tenth = int(fraction * 10)
                self.event("progress", f"frame {frame}: {fraction:4.0%} {message}",
                           frame=frame, fraction=round(fraction, 3), message=message)
        return tell
