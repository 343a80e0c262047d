"""Work on a thread of its own, watched from Blender's main thread; no bpy."""

import threading
from concurrent.futures import Future, ThreadPoolExecutor

from ...inference.scene import Cancelled


class Worker:
    """Runs `_work()`, of a subclass, on a thread from `_start` on.

    fraction, message: how far it is. error: what ended it early, or None. stopped: whether it was asked to end.
    """

    fraction, message, error = 0.0, "", None

    def _start(self, name: str, awaited: bool) -> None:
        """name: of the thread. awaited: whether Blender, when it quits, waits for its end."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=not awaited)
        self._thread.start()

    def _run(self):
        try:
            self._work()
        except BaseException as error:  # Carried to the main thread, which knows how to show it.
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
        """Ask it to end; it does within a second."""
        self._stop.set()

    def wait(self, seconds=None) -> None:
        """Until it is done, but no longer than that."""
        self._thread.join(seconds)


def in_background(work) -> Future:
    """The future of what `work()` gives, on a thread of its own."""
    pool = ThreadPoolExecutor(1, "mrpnn work")
    found = pool.submit(work)
    # The thread ends with its work.
    pool.shutdown(wait=False)
    return found
