# SPDX-License-Identifier: GPL-3.0-or-later
"""The last comparison of the open file, for the panel."""

from pathlib import Path
from typing import Any

from ..runtime.redraw import redraw_panels

_last: tuple[Any, Path] | None = None


def remember(comparison: Any, page: Path) -> None:
    """Store a `comparison.results.Comparison` and the path of its report."""
    global _last
    _last = comparison, page
    redraw_panels()


def forget() -> None:
    """Called when another file is loaded."""
    global _last
    _last = None


def last_comparison() -> tuple[Any, Path] | None:
    """(Comparison, path of its report), or None before the first."""
    return _last
