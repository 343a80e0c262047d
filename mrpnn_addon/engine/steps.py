# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress of a render of several pictures as that of one; imports no bpy."""

import time
from collections.abc import Callable

Tell = Callable[[float, str], None]

# Share of the time that the coarse picture takes, with all that the whole one needs too; of the last render, once there
# is one.
_coarse_share = 0.5


class Steps:
    """A coarse picture, if any, and whole ones of each light group.

    tell: the progress of all, (fraction, message); None where nobody is told. number: of whole pictures. coarse_first:
    whether there is a coarse picture.
    """

    def __init__(self, tell: Tell | None, number: int, coarse_first: bool) -> None:
        self._tell, self._number, self._start = tell, number, time.perf_counter()
        self._first, self._coarse_seconds = _coarse_share if coarse_first else 0.0, 0.0

    def coarse(self, fraction: float, message: str) -> None:
        """Progress of the coarse picture."""
        self._coarse_seconds = time.perf_counter() - self._start
        if self._tell is not None:
            self._tell(self._first * fraction, message)

    def picture(self, number: int) -> Tell | None:
        """The progress of a whole picture."""
        if self._tell is None:
            return None
        tell = self._tell

        def picture(fraction: float, message: str) -> None:
            if fraction == 1.0 and self._coarse_seconds:
                self._learn()
            done = (number + fraction) / self._number
            tell(self._first + (1.0 - self._first) * done, message)

        return picture

    def _learn(self) -> None:
        global _coarse_share
        _coarse_share = min(max(self._coarse_seconds / (time.perf_counter() - self._start), 0.02), 0.9)
