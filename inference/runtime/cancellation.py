# SPDX-License-Identifier: GPL-3.0-or-later
"""Cooperative cancellation: long work polls the caller's callback several times a second."""

import contextlib
import threading
from collections.abc import Callable, Iterator

# Seconds between two polls while waiting.
POLL_INTERVAL = 0.05


class Cancelled(Exception):
    """The caller's `cancelled` callback asked the work to stop."""


class CancelToken:
    """Tells long work whether the caller wants it to stop.

    cancelled: () -> bool, cheap and safe to call on any thread; None for work that is never cancelled.
    """

    def __init__(self, cancelled: Callable[[], bool] | None = None):
        self._cancelled = cancelled or (lambda: False)

    def check(self) -> None:
        """Raise Cancelled if the caller wants the work to stop."""
        if self._cancelled():
            raise Cancelled()

    @contextlib.contextmanager
    def locked(self, lock: threading.Lock) -> Iterator[None]:
        """Context manager that holds `lock`; raises Cancelled while waiting for it."""
        while not lock.acquire(timeout=POLL_INTERVAL):
            self.check()
        try:
            yield
        finally:
            lock.release()


#: Token of work that is never cancelled.
NEVER = CancelToken()
