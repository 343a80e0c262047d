# SPDX-License-Identifier: GPL-3.0-or-later
"""What one of several processes of a test run does for all."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock, the folder `path`, that processes share; waits while another process holds it."""
    while True:
        try:
            path.mkdir()
            break
        except FileExistsError:
            time.sleep(0.5)
    try:
        yield
    finally:
        path.rmdir()
