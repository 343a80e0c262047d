"""Cooperative cancellation: the caller asks, long work looks several times a second."""

import contextlib

# Seconds between looks while waiting.
POLL_INTERVAL = 0.05


class Cancelled(Exception):
    """The caller's `cancelled` callback asked the work to stop."""


class CancelToken:
    """Whether the caller wants the work to stop.

    cancelled: () -> bool, cheap and safe on any thread; None for work that is never cancelled.
    """

    def __init__(self, cancelled=None):
        self._cancelled = cancelled or (lambda: False)

    def check(self) -> None:
        """Raise Cancelled if the caller wants the work to stop."""
        if self._cancelled():
            raise Cancelled()

    @contextlib.contextmanager
    def locked(self, lock):
        """Hold a lock; raises Cancelled while waiting for it."""
        while not lock.acquire(timeout=POLL_INTERVAL):
            self.check()
        try:
            yield
        finally:
            lock.release()


#: The token of work that nobody cancels.
NEVER = CancelToken()
