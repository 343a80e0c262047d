# SPDX-License-Identifier: GPL-3.0-or-later
"""The last comparison of the open file, for the panel."""

_last = None


def remember(comparison, page) -> None:
    """Store a Comparison and the path of its report."""
    global _last
    _last = comparison, page


def forget() -> None:
    """Called when another file is loaded."""
    global _last
    _last = None


def last_comparison():
    """(Comparison, path of its report), or None before the first."""
    return _last
