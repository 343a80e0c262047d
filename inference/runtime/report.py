"""What a render did: the plan, counts, seconds a stage, memory."""

import contextlib
import sys
import time
from dataclasses import dataclass, field


@dataclass
class Report:
    """Filled while a render runs.

    model, checksum: the network's name and sha256; provider: of onnxruntime, that ran it. planned, left_out: sentences.
    warnings: what the user should know, naming objects. counts: pixels, rays, points.
    saved: seconds that omissions spared, roughly, as `savings` tells.
    seconds: by stage; "march" and "network" overlap on several threads, so that "total" is measured
    apart. cpu_seconds: by stage, of all threads of the process. peak_memory: bytes, of the whole process, None
    where the platform does not tell.
    """

    model: str = ""
    checksum: str = ""
    provider: str = ""
    threads: int = 0
    planned: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    saved: dict[str, float] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    cpu_seconds: dict[str, float] = field(default_factory=dict)
    peak_memory: int | None = None

    def __post_init__(self):
        self._running = {}

    @contextlib.contextmanager
    def stage(self, name: str):
        """Add the time spent inside to a stage."""
        start, cpu = time.perf_counter(), time.process_time()
        self._running[name] = start
        try:
            yield
        finally:
            del self._running[name]
            self.cpu_seconds[name] = self.cpu_seconds.get(name, 0.0) + time.process_time() - cpu
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def elapsed(self, name: str) -> float:
        """Seconds of a stage so far, while it runs as well."""
        running = time.perf_counter() - self._running[name] if name in self._running else 0.0
        return self.seconds.get(name, 0.0) + running

    def count(self, name: str, number: int):
        self.counts[name] = self.counts.get(name, 0) + int(number)

    def to_dict(self) -> dict:
        """Plain types only, for JSON and image metadata."""
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}


def process_peak_memory() -> int | None:
    """Largest resident size of this process so far in bytes; None on Windows."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
