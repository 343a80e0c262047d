# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render did: its plan, counters, seconds per stage and memory."""

import contextlib
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class ExpectedError:
    """Expected error of a picture, relative to its mean.

    error: root mean square over the pixels. low, high: its 95 % interval. bias: the mean error lies between -bias and
    bias in 95 of 100 pictures. where: the region in which the error is largest, in words.
    """

    error: float
    low: float
    high: float
    bias: float
    where: str = ""

    def __str__(self) -> str:
        """A text such as "6 % (3-11 %), mostly in the upper left, at the rim"."""
        suffix = f", mostly in the {self.where}" if self.where else ""
        return f"{_percent(self.error)} % ({_percent(self.low)}\u2013{_percent(self.high)} %){suffix}"


def _percent(value: float) -> str:
    """A fraction in percent, with two significant digits below 10 %."""
    return f"{100.0 * value:.1f}" if value < 0.0995 else f"{100.0 * value:.0f}"


@dataclass
class Report:
    """Statistics of a render, filled while it runs.

    model, checksum: name of the network and SHA-256 of its weights. provider: onnxruntime execution provider that ran
    it. kernels: kind of processor that the compiled kernels use. threads: worker threads. planned, left_out: sentences
    about what the render does, and about what it skips. warnings: what the user should know; each names the object.
    counts: of pixels, rays, steps and points. seconds: wall-clock time per stage; of stages that several threads do
    side by side, the mean over the threads. "total" is measured separately. expected_error: of the picture; None where
    nothing is predicted, and where the network's error is not known. cpu_seconds: processor time of all threads of the
    process per stage. peak_memory: bytes of the whole process, None where the platform does not tell.
    """

    model: str = ""
    checksum: str = ""
    provider: str = ""
    kernels: str = ""
    threads: int = 0
    planned: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    cpu_seconds: dict[str, float] = field(default_factory=dict)
    peak_memory: int | None = None
    expected_error: ExpectedError | None = None

    def __post_init__(self) -> None:
        self._processor_time = time.process_time

    @classmethod
    def of_thread(cls) -> "Report":
        """A report for a part of a render that the calling thread does alone, to be merged into the render's."""
        report = cls()
        report._processor_time = time.thread_time
        return report

    def merge(self, part: "Report", threads: int) -> None:
        """Add the report of a part of the render; threads: number of parts that run side by side."""
        for name, number in part.counts.items():
            self.count(name, number)
        for name, seconds in part.seconds.items():
            self.seconds[name] = self.seconds.get(name, 0.0) + seconds / threads
            self.cpu_seconds[name] = self.cpu_seconds.get(name, 0.0) + part.cpu_seconds[name]
        self.warn(part.warnings)

    def add_seconds(self, before: "Report") -> None:
        """Add the time of a render before this one, whose results it uses."""
        for total, other in ((self.seconds, before.seconds), (self.cpu_seconds, before.cpu_seconds)):
            for name, seconds in other.items():
                total[name] = total.get(name, 0.0) + seconds

    def warn(self, warnings: Iterable[str]) -> None:
        """Add the warnings that are not there yet."""
        for warning in warnings:
            if warning not in self.warnings:
                self.warnings.append(warning)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Context manager that adds the time spent inside to a stage."""
        start, cpu = time.perf_counter(), self._processor_time()
        try:
            yield
        finally:
            self.cpu_seconds[name] = self.cpu_seconds.get(name, 0.0) + self._processor_time() - cpu
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def count(self, name: str, number: int) -> None:
        """Add to a counter."""
        self.counts[name] = self.counts.get(name, 0) + int(number)

    def to_dict(self) -> dict[str, Any]:
        """The fields as plain types, for JSON and image metadata."""
        fields = {name: value for name, value in vars(self).items() if not name.startswith("_")}
        if self.expected_error is not None:
            fields["expected_error"] = asdict(self.expected_error)
        return fields


def process_peak_memory() -> int | None:
    """Peak resident set size of this process in bytes; None on Windows."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
