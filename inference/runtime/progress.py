# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress in time rather than in steps, from the rates measured on this machine.

A render states how much of each stage it expects (marched steps, network points, ...) and how much is done. The time
left is the rest of each stage at that stage's own rate: seconds per unit so far in this render, or at first the rate in
the last render of this process. The fraction reported is elapsed / (elapsed + left), so that elapsed / fraction -
elapsed is the time left."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator

#: Stages, and seconds per unit before anything has been measured: two cores of a desktop of 2020.
SECONDS_PER_UNIT = {
    "shadows": 1e-7,  # per voxel and sun
    "transport": 0.8,  # per solve: one group of volumes, sun and set of colour channels
    "lattices": 0.1,  # per set of lookup lattices: one group of volumes, sun, set of colour channels and tile
    "march": 6e-7,  # per evaluated step
    "network": 8e-6,  # per point
}
# Seconds of a stage after which its rate in this render is used.
ENOUGH = 0.2
# Until all stages are known, the fraction approaches UNKNOWN_FRACTION; half of it after UNKNOWN_SECONDS.
UNKNOWN_FRACTION, UNKNOWN_SECONDS = 0.2, 5.0

_measured: dict[str, float] = {}
_measuring = threading.Lock()


class Progress:
    """How far one render is.

    callback: (fraction, message) or None, called on the calling thread.
    """

    def __init__(self, callback: Callable[[float, str], None] | None = None) -> None:
        self._callback = callback
        self._start, self._fraction, self._message = time.perf_counter(), 0.0, ""
        self._expected: dict[str, float] = {}
        self._done = dict.fromkeys(SECONDS_PER_UNIT, 0.0)
        self._spent = dict.fromkeys(SECONDS_PER_UNIT, 0.0)
        self._running: dict[str, float] = {}

    @contextlib.contextmanager
    def stage(self, stage: str, amount: float = 0.0) -> Iterator[None]:
        """Time the block as part of a stage, and count `amount` more of it as done afterwards."""
        self._running[stage] = time.perf_counter()
        try:
            yield
        finally:
            self._spent[stage] += time.perf_counter() - self._running.pop(stage)
        self.advance(stage, amount)

    @property
    def wanted(self) -> bool:
        """Whether anybody is told."""
        return self._callback is not None

    def expect(self, stage: str, amount: float) -> None:
        """Set how much of a stage there is altogether."""
        self._expected[stage] = amount

    def expect_more(self, stage: str, amount: float) -> None:
        """Change how much of a stage there is, by what turns out to be more, or less where it is negative."""
        self._expected[stage] += amount

    def done(self, stage: str) -> float:
        """How much of a stage is done."""
        return self._done[stage]

    def advance(self, stage: str, amount: float, seconds: float = 0.0) -> None:
        """Count an amount of a stage as done; seconds: that it took, where no block is timed."""
        self._done[stage] += amount
        self._spent[stage] += seconds
        self._tell()

    def message(self, message: str) -> None:
        """Say what is being done."""
        self._message = message
        self._tell()

    def finish(self) -> None:
        """Report the end, and keep this render's rates for the next one's first estimate."""
        with _measuring:
            for stage, done in self._done.items():
                if done > 0.0 and self._spent[stage] > ENOUGH:
                    _measured[stage] = self._spent[stage] / done
        self._fraction = 1.0
        if self._callback is not None:
            self._callback(1.0, self._message)

    def _remaining(self) -> float:
        seconds, now = 0.0, time.perf_counter()
        for stage, usual in SECONDS_PER_UNIT.items():
            done, spent = self._done[stage], self._spent[stage]
            if stage in self._running:
                spent += now - self._running[stage]
            rate = spent / done if done > 0.0 and spent > ENOUGH else _measured.get(stage, usual)
            seconds += max(self._expected.get(stage, 0.0) - done, 0.0) * rate
        return seconds

    def _tell(self) -> None:
        if self._callback is None:
            return
        elapsed = time.perf_counter() - self._start
        if len(self._expected) == len(SECONDS_PER_UNIT):
            fraction = elapsed / max(elapsed + self._remaining(), 1e-9)
        else:
            fraction = UNKNOWN_FRACTION * elapsed / (elapsed + UNKNOWN_SECONDS)
        # Estimates are revised; the reported fraction never falls, and `finish` reports the end.
        self._fraction = max(self._fraction, min(fraction, 0.999))
        self._callback(self._fraction, self._message)
