"""Tasks on worker threads."""

import concurrent.futures
import os

from .cancellation import NEVER, POLL_INTERVAL, CancelToken


class Tasks:
    """A pool of worker threads that gives results in order of submission.

    threads: their number, 0 for one per core. cancel: looked at while the calling thread waits.
    """

    def __init__(self, threads: int = 0, cancel: CancelToken = NEVER):
        self.threads, self.cancel = threads or os.cpu_count() or 1, cancel
        self._pool = concurrent.futures.ThreadPoolExecutor(self.threads)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._pool.shutdown(cancel_futures=True)

    def map(self, function, items):
        """Yield function(item) for each item; a bounded number is in flight. Raises Cancelled."""
        iterator, pending = iter(items), []
        for item in iterator:
            pending.append(self._pool.submit(function, item))
            if len(pending) > 2 * self.threads:
                break
        while pending:
            self.cancel.check()
            result = pending.pop(0).result()
            for item in iterator:
                pending.append(self._pool.submit(function, item))
                break
            yield result

    def each(self, function, items):
        """Yield function(item) for a few long items, all submitted at once. Raises Cancelled within POLL_INTERVAL."""
        pending = [self._pool.submit(function, item) for item in items]
        for future in pending:
            while not concurrent.futures.wait([future], POLL_INTERVAL).done:
                self.cancel.check()
            self.cancel.check()
            yield future.result()


class SerialTasks:
    """Runs everything on the calling thread; nobody cancels it."""

    threads, cancel = 1, NEVER
    map = each = staticmethod(map)


#: For callers without a pool.
SERIAL = SerialTasks()
