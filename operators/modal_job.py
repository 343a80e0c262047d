# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that run workers one after the other, while Blender stays usable; Esc stops them."""

from typing import Any, cast

import bpy

from ..inference.scene import SceneError
from ..mrpnn_addon.runtime.background import Worker
from ..mrpnn_addon.runtime.text import percent, report, status_bar
from ..mrpnn_addon.scene.kept_frame import KeptFrame

TICK_INTERVAL = 0.1

# The workers of each kind of work.
_working: dict[str, Worker] = {}


class RunsWorkers:
    """Mixin of an operator.

    work: what it does, such as "bake", of which one runs at a time. doing: the same, such as "baking". visits_frames:
    whether it goes to other frames; the scene is back in its own at the end, also after Esc and errors.
    """

    work, doing, visits_frames = "", "", False
    _timer: Any = None
    _frame: KeptFrame | None = None

    def next_worker(self, context: "bpy.types.Context", done: Any) -> Worker | None:
        """The worker to run after the one that is done, which is None at first; None at the end. Raises SceneError."""
        raise NotImplementedError

    def finish(self, context: "bpy.types.Context") -> set[str]:
        """Take what the workers have done; the result of the operator."""
        raise NotImplementedError

    def fail(self, error: Exception) -> set[str]:
        """Report a SceneError or OSError; the result of the operator."""
        report(self, "ERROR", error)
        return {"CANCELLED"}

    def progress(self, worker: Worker) -> tuple[float, str]:
        """How much is done, 0 to 1, and of what."""
        return worker.fraction, worker.message

    def begin(self, context: "bpy.types.Context") -> set[str]:
        """Start the first worker; for `invoke`."""
        if self.work in _working:
            report(self, "WARNING", f"MRPNN is {self.doing} already; Esc stops it")
            return {"CANCELLED"}
        self._frame = KeptFrame(context.scene) if self.visits_frames else None
        try:
            worker = self.next_worker(context, None)
        except BaseException as error:
            self._go_back()
            if isinstance(error, (SceneError, OSError)):
                return self.fail(error)
            raise
        if worker is None:
            self._go_back()
            return self.finish(context)
        _working[self.work] = worker
        manager, operator = context.window_manager, cast(Any, self)
        self._timer = manager.event_timer_add(TICK_INTERVAL, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(operator)
        return {"RUNNING_MODAL"}

    def go_on(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        """Show the progress, and take what is done; for `modal`."""
        worker: Any = _working[self.work]
        if event.type == "ESC":
            worker.stop()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        fraction, message = self.progress(worker)
        context.window_manager.progress_update(int(100 * fraction))
        status_bar(context, f"MRPNN {percent(fraction)}  {message}  (Esc stops)")
        if not worker.done:
            return {"PASS_THROUGH"}
        try:
            # Esc may come too late for the worker to notice it.
            if not worker.stopped:
                if worker.error is not None:
                    raise worker.error
                following = self.next_worker(context, worker)
                if following is not None:
                    _working[self.work] = following
                    return {"PASS_THROUGH"}
        except (SceneError, OSError) as error:
            self._end(context)
            return self.fail(error)
        except BaseException:
            self._end(context)
            raise
        self._end(context)
        if worker.stopped:
            report(self, "INFO", f"MRPNN {self.work} stopped")
            return {"CANCELLED"}
        return self.finish(context)

    def cancel(self, context: "bpy.types.Context") -> None:
        """Called by Blender where it ends the operator itself, as when it closes or loads a file."""
        worker = _working[self.work]
        worker.stop()
        worker.wait()
        self._end(context)

    def _go_back(self) -> None:
        if self._frame is not None:
            self._frame.restore()

    def _end(self, context: "bpy.types.Context") -> None:
        del _working[self.work]
        self._go_back()
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        status_bar(context, None)
