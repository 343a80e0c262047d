# SPDX-License-Identifier: GPL-3.0-or-later
"""The last comparison of the open file, for the panel."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..comparison.results import Comparison

_last: tuple["Comparison", Path] | None = None


def remember(comparison: "Comparison", page: Path) -> None:
    """Store a Comparison and the path of its report."""
    global _last
    _last = comparison, page


def forget() -> None:
    """Called when another file is loaded."""
    global _last
    _last = None


def last_comparison() -> tuple["Comparison", Path] | None:
    """(Comparison, path of its report), or None before the first."""
    return _last
