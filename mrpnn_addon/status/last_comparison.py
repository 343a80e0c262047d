"""What the panel says about the last comparison of this file."""

_last = None


def remember(comparison, page) -> None:
    """Keep a Comparison and the path of its report."""
    global _last
    _last = comparison, page


def forget() -> None:
    """Another file is loaded."""
    global _last
    _last = None


def last_comparison():
    """(Comparison, path of its report), or None before the first."""
    return _last
