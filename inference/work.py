"""Tasks on threads, with progress and cancellation."""

import concurrent.futures
import os

from .scene import Cancelled, Settings

SECONDS_A_LOOK = 0.1


class Work:
    """Runs tasks on threads, in order of submission, with progress and cancellation."""

    def __init__(self, settings: Settings, progress, cancelled):
        self.threads = settings.threads or os.cpu_count() or 1
        self.pool = concurrent.futures.ThreadPoolExecutor(self.threads)
        self.progress = progress or (lambda fraction, message: None)
        self.cancelled = cancelled or (lambda: False)

    def check(self):
        if self.cancelled():
            raise Cancelled()

    def map(self, function, tasks, start: float, end: float, message: str):
        """Yield function(task) for each task; a bounded number is in flight."""
        tasks = list(tasks)
        pending, done = [], 0
        iterator = iter(tasks)
        for task in iterator:
            pending.append(self.pool.submit(function, task))
            if len(pending) > 2 * self.threads:
                break
        while pending:
            self.check()
            result = pending.pop(0).result()
            for task in iterator:
                pending.append(self.pool.submit(function, task))
                break
            done += 1
            self.progress(start + (end - start) * done / len(tasks), message)
            yield result

    def each(self, function, tasks):
        """As the built-in map over a few tasks side by side; asks several times a second whether to stop."""
        pending = [self.pool.submit(function, task) for task in tasks]
        for future in pending:
            while not concurrent.futures.wait([future], SECONDS_A_LOOK).done:
                self.check()
            self.check()
            yield future.result()

    def close(self):
        self.pool.shutdown(cancel_futures=True)
