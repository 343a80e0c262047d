# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks on worker threads."""

import concurrent.futures
import ctypes
import os
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from .cancellation import NEVER, POLL_INTERVAL, CancelToken

Item = TypeVar("Item")
Result = TypeVar("Result")


class Tasks:
    """A thread pool that yields results in order of submission.

    threads: number of worker threads, 0 for one per core. cancel: polled while the calling thread waits. stopping: not
    0 once results are no longer wanted; compiled code polls it.
    """

    def __init__(self, threads: int = 0, cancel: CancelToken = NEVER):
        self.threads, self.cancel = threads or os.cpu_count() or 1, cancel
        self.stopping = ctypes.c_int32(0)
        self._pool = concurrent.futures.ThreadPoolExecutor(self.threads)

    def __enter__(self) -> "Tasks":
        return self

    def __exit__(self, *_: object) -> None:
        self.stopping.value = 1
        self._pool.shutdown(cancel_futures=True)

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Yield function(item) for each item, with a bounded number of tasks in flight.

        Raises Cancelled within POLL_INTERVAL.
        """
        iterator = iter(items)
        pending: list[concurrent.futures.Future[Result]] = []
        for item in iterator:
            pending.append(self._pool.submit(function, item))
            if len(pending) > 2 * self.threads:
                break
        while pending:
            result = self._result(pending.pop(0))
            for item in iterator:
                pending.append(self._pool.submit(function, item))
                break
            yield result

    def each(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Yield function(item) for a few long items, all submitted at once. Raises Cancelled within POLL_INTERVAL."""
        pending = [self._pool.submit(function, item) for item in items]
        yield from map(self._result, pending)

    def _result(self, future: "concurrent.futures.Future[Result]") -> Result:
        while not concurrent.futures.wait([future], POLL_INTERVAL).done:
            self.cancel.check()
        self.cancel.check()
        return future.result()


class SerialTasks:
    """Runs every task on the calling thread and is never cancelled."""

    threads, cancel, stopping = 1, NEVER, ctypes.c_int32(0)

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Yield function(item) for each item."""
        return map(function, items)

    each = map


#: For callers without a pool.
SERIAL = SerialTasks()
#: Parameter of functions that run tasks.
AnyTasks = Tasks | SerialTasks
