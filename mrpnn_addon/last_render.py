"""What the panel says about the last render of this session."""

from dataclasses import dataclass, field
from typing import List


@dataclass
class LastRender:
    """seconds of the last render, its warnings; message instead of seconds where it failed."""

    seconds: float = 0.0
    warnings: List[str] = field(default_factory=list)
    error: str = ""


_last = None


def remember(last: LastRender) -> None:
    """Keep it until the next render or the end of the session."""
    global _last
    _last = last


def last_render():
    """The LastRender, or None before the first."""
    return _last
