"""What the panel says about the last comparison of this session."""

_last = None


def remember(comparison, page) -> None:
    """Keep a Comparison and the path of its report."""
    global _last
    _last = comparison, page


def last_comparison():
    """(Comparison, path of its report), or None before the first."""
    return _last
