"""Progress in time rather than in steps, from the rates at which this machine has been measured to work.

A render says how much of each stage it expects (marched steps, network points, ...) and how much is done. What remains
is the rest of each stage at the stage's own rate: seconds per unit so far in this render, or before that as in the last
render of this process. The fraction reported is elapsed / (elapsed + remaining), so that elapsed / fraction - elapsed
is the time left.
"""

import threading
import time
from typing import Callable, Dict, Optional

from .report import Report

#: Stages, and seconds per unit before anything has been measured: two cores of a desktop of 2020.
SECONDS_PER_UNIT = {
    "shadows": 1e-7,  # per voxel and sun
    "fields": 0.8,  # per group of volumes and sun
    "march": 2e-7,  # per marched step
    "network": 8e-6,  # per point
}
# Seconds of a stage after which its rate is its own.
ENOUGH = 0.2

_measured: Dict[str, float] = {}
_measuring = threading.Lock()


class Progress:
    """How far one render is.

    report: whose stages are being timed. callback: (fraction, message) or None, called on the calling thread.
    """

    def __init__(self, report: Report, callback: Optional[Callable[[float, str], None]] = None):
        self._report, self._callback = report, callback
        self._start, self._fraction, self._message = time.perf_counter(), 0.0, ""
        self._expected: Dict[str, float] = {}
        self._done = dict.fromkeys(SECONDS_PER_UNIT, 0.0)

    def expect(self, stage: str, amount: float) -> None:
        """Set how much of a stage there will be altogether."""
        self._expected[stage] = amount

    def done(self, stage: str) -> float:
        """How much of a stage is done."""
        return self._done[stage]

    def advance(self, stage: str, amount: float) -> None:
        """Tell that so much more of a stage is done."""
        self._done[stage] += amount
        self._tell()

    def message(self, message: str) -> None:
        """Say what is being done."""
        self._message = message
        self._tell()

    def finish(self) -> None:
        """Keep this render's rates for the next one's first estimate."""
        with _measuring:
            for stage, done in self._done.items():
                if done > 0.0 and self._report.elapsed(stage) > ENOUGH:
                    _measured[stage] = self._report.elapsed(stage) / done

    def _remaining(self) -> float:
        seconds = 0.0
        for stage, usual in SECONDS_PER_UNIT.items():
            done, spent = self._done[stage], self._report.elapsed(stage)
            rate = spent / done if done > 0.0 and spent > ENOUGH else _measured.get(stage, usual)
            seconds += max(self._expected.get(stage, 0.0) - done, 0.0) * rate
        return seconds

    def _tell(self):
        if self._callback is None:
            return
        elapsed, fraction = time.perf_counter() - self._start, 0.0
        # Until every stage is known, nothing can be said.
        if len(self._expected) == len(SECONDS_PER_UNIT):
            fraction = elapsed / max(elapsed + self._remaining(), 1e-9)
        # Estimates are revised; what is shown never goes back.
        self._fraction = max(self._fraction, min(fraction, 1.0))
        self._callback(self._fraction, self._message)
