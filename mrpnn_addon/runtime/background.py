# SPDX-License-Identifier: GPL-3.0-or-later
"""Background threads that Blender's main thread polls; imports no bpy.

All threads of the extension start here, so that `stop_threads` ends them before Blender unloads the extension, loads
another file or quits.
"""

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from ...inference.scene import Cancelled

# What asks each running thread to stop. Only Blender's main thread starts threads here.
_running: dict[threading.Thread, Callable[[], None]] = {}


def start_thread(work: Callable[[], None], name: str, stop: Callable[[], None], awaited: bool) -> threading.Thread:
    """Run `work()` on a thread; returns it.

    stop: asks the thread to stop. awaited: whether Blender waits for the thread when it quits.
    """
    for ended in [thread for thread in list(_running) if not thread.is_alive()]:
        del _running[ended]
    thread = threading.Thread(target=work, name=name, daemon=not awaited)
    thread.start()
    _running[thread] = stop
    return thread


def stop_threads(seconds: float) -> bool:
    """Ask all threads to stop and wait for at most so many seconds; returns whether all have ended."""
    running, end = dict(_running), time.monotonic() + seconds
    for stop in running.values():
        stop()
    for thread in running:
        thread.join(max(end - time.monotonic(), 0.0))
        if not thread.is_alive():
            _running.pop(thread, None)
    return not _running


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
        self._thread = start_thread(self._run, name, self.stop, awaited)

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
    """Run `work()` on a thread of its own, to its end; returns the future of its result."""
    future: Future = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:  # Whoever asks for the result gets it.
            future.set_exception(error)

    start_thread(run, "mrpnn work", lambda: None, awaited=True)
    return future
