# SPDX-License-Identifier: GPL-3.0-or-later
"""Background threads that Blender's main thread polls; imports no bpy."""

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from ...inference.scene import Cancelled


class Worker:
    """Runs a subclass's `_work()` on a thread of its own, from `_start` on.

    fraction, message: progress. number: of pictures so far. error: the exception that ended it early, or
    None. stopped: whether it was asked to stop.
    """

    fraction, message = 0.0, ""
    number = 0
    error: BaseException | None = None

    def _start(self, name: str, awaited: bool) -> None:
        """name: of the thread. awaited: whether Blender waits for the thread when it quits."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=not awaited)
        self._thread.start()

    def _work(self) -> None:
        raise NotImplementedError

    def _run(self) -> None:
        try:
            self._work()
        except BaseException as error:  # The main thread shows it.
            self.error = error

    @property
    def done(self) -> bool:
        return not self._thread.is_alive()

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    @property
    def cancelled(self) -> bool:
        return isinstance(self.error, Cancelled)

    def stop(self) -> None:
        """Ask the thread to stop, which takes at most a second."""
        self._stop.set()

    def wait(self, seconds: float | None = None) -> None:
        """Block until the thread is done, or for at most so many seconds."""
        self._thread.join(seconds)


def in_background(work: Callable[[], Any]) -> Future:
    """Run `work()` on a thread of its own; returns the future of its result."""
    pool = ThreadPoolExecutor(1, "mrpnn work")
    found = pool.submit(work)
    # The thread ends when its work does.
    pool.shutdown(wait=False)
    return found
