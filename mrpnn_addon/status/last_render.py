"""What the panel says about the last render of this file."""

from dataclasses import dataclass, field
from typing import List

from .experience import learn_from


@dataclass
class LastRender:
    """seconds of the last render, its warnings; error instead where it failed.
    points: that the network predicted, in network_seconds. saved: seconds that omissions spared, roughly.
    """

    seconds: float = 0.0
    warnings: List[str] = field(default_factory=list)
    error: str = ""
    points: int = 0
    network_seconds: float = 0.0
    saved: float = 0.0


_last = None


def remember(last: LastRender) -> None:
    """Keep it until the next render or another file."""
    global _last
    _last = last


def remember_finished(finished) -> None:
    """Keep what a `render_job.Finished` tells."""
    report = finished.layer.report
    remember(LastRender(finished.seconds, finished.warnings, points=report.counts.get("network points", 0),
                        network_seconds=report.seconds.get("network", 0.0), saved=sum(report.saved.values())))
    learn_from(finished.asked, finished.layer)


def forget() -> None:
    """Another file is loaded."""
    global _last
    _last = None


def last_render():
    """The LastRender, or None before the first."""
    return _last
