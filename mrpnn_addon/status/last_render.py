# SPDX-License-Identifier: GPL-3.0-or-later
"""The last render of the open file, for the panel."""

from dataclasses import dataclass, field
from typing import Protocol

from ...inference.image.layer import Layer
from ..objects.workload import Workload
from ..runtime.redraw import redraw_panels
from .calibration import calibrate_by


class Finished(Protocol):
    """What is read of an `engine.render_job.Finished`."""

    layer: Layer
    seconds: float
    warnings: list[str]
    workload: Workload | None


@dataclass
class LastRender:
    """seconds: of the render. warnings: its warnings. error: why it failed, or "". points: predictions of the network.
    network_seconds: time they took. expected_error: in words, ""
    where it is not known.
    """

    seconds: float = 0.0
    warnings: list[str] = field(default_factory=list)
    error: str = ""
    points: int = 0
    network_seconds: float = 0.0
    expected_error: str = ""


_last: LastRender | None = None


def remember(last: LastRender) -> None:
    """Store a render until the next render or another file."""
    global _last
    _last = last
    redraw_panels()


def remember_finished(finished: Finished) -> None:
    """Store the result of a render."""
    report = finished.layer.report
    remember(
        LastRender(
            finished.seconds,
            finished.warnings,
            points=report.counts.get("network points", 0),
            network_seconds=report.seconds.get("network", 0.0),
            expected_error=str(report.expected_error or ""),
        )
    )
    calibrate_by(finished.workload, finished.layer)


def forget() -> None:
    """Called when another file is loaded."""
    global _last
    _last = None


def last_render() -> LastRender | None:
    """The LastRender, or None before the first."""
    return _last
