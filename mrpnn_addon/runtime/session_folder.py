# SPDX-License-Identifier: GPL-3.0-or-later
"""A temporary folder of this Blender, and the removal of those that crashed ones have left behind; imports no bpy.

A folder belongs to a running process as long as that holds the lock on its file LOCK. The system gives up the locks of
processes that end, however they end.
"""

import shutil
import tempfile
from pathlib import Path
from typing import IO

LOCK = ".lock"


class SessionFolder:
    """A new folder below a base. path: of the folder."""

    def __init__(self, base: Path, prefix: str) -> None:
        self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=base))
        self._lock: IO[bytes] | None = (self.path / LOCK).open("wb")
        _hold(self._lock)

    def remove(self) -> None:
        """Remove the folder with all that is in it, as far as the system allows it."""
        if self._lock is not None:
            # Windows removes no file that is open.
            self._lock.close()
            self._lock = None
        shutil.rmtree(self.path, ignore_errors=True)


def remove_leftovers(base: Path, prefix: str) -> None:
    """Remove folders below a base whose processes have ended."""
    for left in base.glob(f"{prefix}*"):
        if not left.is_symlink() and (left / LOCK).is_file() and not _is_held(left / LOCK):
            shutil.rmtree(left, ignore_errors=True)


def _is_held(path: Path) -> bool:
    """Whether a process holds the lock on a file."""
    try:
        with path.open("r+b") as file:
            _hold(file)
    except OSError:
        return True
    return False


def _hold(file: IO[bytes]) -> None:
    """Lock an open file until it is closed. Raises OSError where another process has locked it."""
    try:
        import fcntl
    except ImportError:  # On Windows.
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
