# SPDX-License-Identifier: GPL-3.0-or-later
"""A running comparison: one image after another, layers on a thread, Cycles in a process, without blocking."""

import time
from collections.abc import Callable
from dataclasses import replace

from ...inference.scene import Cancelled, SceneError, Settings
from ..cycles.choices import CHOICES
from ..cycles.pass_store import Job, Pass, PassStore
from ..cycles.process import CyclesProcess, PassFailed
from ..engine.render_job import RenderJob
from ..output.layer_frame import rgba
from ..runtime.background import in_background
from ..scene.reader import SceneDescription
from .plan import Request, next_job, remaining_seconds

ONCE = ("network loading", "fields", "shadows", "light paths")


class ComparisonJob:
    """Renders the missing images of a request, and stores Cycles' images; layers are quick to render again.

    description: from `read_scene`, cropped. open_store: returns the PassStore; called on a thread, because the key of
    large volumes takes long. process: of the same view; ended with the job. Call `step` repeatedly from the main thread
    until `done`, and always `stop` at the end.

    passes: finished images of the request. marks: candidates that failed, as text. message, fraction: progress. error:
    the exception that ended the job.
    """

    def __init__(
        self,
        request: Request,
        description: SceneDescription,
        settings: Settings,
        open_store: Callable[[], PassStore],
        process: CyclesProcess,
    ) -> None:
        self.request, self.description, self.settings = request, description, settings
        self.store: PassStore | None = None
        self._opening = in_background(open_store)
        self._process = process
        self.passes: dict[Job, Pass] = {}
        self.marks: list[str] = []
        self.message = ""
        self.error: BaseException | None = None
        self._failed: set[Job] = set()
        self._spent = 0.0
        self._job: Job | None = None
        self._layer: RenderJob | None = None
        self.done = False
        self._start = time.monotonic()

    def _find_finished(self) -> None:
        for job in self.request.cycles_jobs():
            found = self.store.get(job)
            if found is not None:
                self.passes[job] = found

    def step(self) -> None:
        """Collect the current image if it is finished, and start the next. Never blocks."""
        if self.done:
            return
        try:
            if self.store is None:
                if not self._opening.done():
                    return
                self.store = self._opening.result()
                self._find_finished()
            if self._job is not None:
                finished = self._finished()
                if finished is None:
                    return
                self.passes[self._job] = finished
                if self._job.by_cycles:
                    self.store.put(self._job, finished)
                    self._spent += finished.seconds
            self._begin(next_job(self.request, self.passes, self._failed, self._spent))
        except PassFailed as problem:  # Only one candidate failed.
            if not CHOICES[self._job.method].denoised:
                self._end(SceneError(f"Cycles could not render: {problem}"))
                return
            self._failed.update(job for job in self.request.cycles_jobs() if CHOICES[job.method].denoised)
            self.marks.append(f"Cycles could not denoise here: {problem}")
            self._job = None
        except (SceneError, OSError) as problem:
            self._end(problem)

    def stop(self) -> None:
        """Stop; finished images are kept."""
        if not self.done:
            self._end(Cancelled())

    @property
    def cancelled(self) -> bool:
        return isinstance(self.error, Cancelled)

    @property
    def fraction(self) -> float:
        # Unknown before Cycles' first image.
        if not self.done and not any(job.by_cycles for job in self.passes):
            return 0.0
        passed = time.monotonic() - self._start
        return passed / max(passed + self.seconds_left, 1e-9)

    @property
    def seconds_left(self) -> float:
        return remaining_seconds(self.request, self.passes, self._failed, self._spent)

    def _begin(self, job: Job | None) -> None:
        self._job = job
        if job is None:
            self._end(None)
        elif job.by_cycles:
            self.message = f"Cycles: {job.method.removeprefix('cycles ')}, {job.samples} samples"
            self._process.ask(job)
        else:
            self.message = f"{job.method}, {job.samples} depth samples"
            settings = replace(self.settings, model=job.method, depth_samples=job.samples)
            self._layer = RenderJob(self.description, settings, None)

    def _finished(self) -> Pass | None:
        if self._job.by_cycles:
            return self._process.answer()
        if not self._layer.done:
            return None
        layer, self._layer = self._layer, None
        if layer.error is not None:
            raise layer.error
        report = layer.result.layer.report
        once, once_cpu = (
            sum(clock.get(stage, 0.0) for stage in ONCE) for clock in (report.seconds, report.cpu_seconds)
        )
        return Pass(
            rgba(layer.result.layer),
            report.seconds["total"],
            report.cpu_seconds["total"],
            once,
            once_cpu,
            layer.result.warnings,
        )

    def _end(self, error: Exception | None) -> None:
        self.error, self.done = error, True
        if self._layer is not None:
            # The thread ends within a second; do not wait for it.
            self._layer.stop()
            self._layer = None
        self._process.stop()
