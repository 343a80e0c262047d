# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that wait for a thread to read the scene's volumes; Blender stays usable meanwhile."""

from typing import Any

import bpy

from ..mrpnn_addon.runtime.text import report, status_bar
from ..mrpnn_addon.scene.changes import scene_state
from ..mrpnn_addon.volumes.loading import VolumeLoading
from ..mrpnn_addon.volumes.reader import VolumeReader

TICK_INTERVAL = 0.1


class SceneLoading:
    """Reads the volumes of a context's scene. flows: as of `VolumeReader.wanted`.

    worker: the VolumeLoading, or None where nothing needs reading. reader: has the volumes in the end.
    """

    def __init__(self, context: "bpy.types.Context", flows: bool = False) -> None:
        depsgraph = context.evaluated_depsgraph_get()
        self.reader = VolumeReader()
        sources, self._state = self.reader.wanted(depsgraph, flows=flows), scene_state(context.scene)
        self.worker = VolumeLoading(self.reader, sources) if sources else None

    def outdated(self, context: "bpy.types.Context") -> bool:
        """Whether the scene has changed since."""
        context.evaluated_depsgraph_get()
        return self._state != scene_state(context.scene)


class WaitsForVolumes:
    """Mixin of an operator with a window. reader: a VolumeReader with the scene's volumes, or None."""

    reader: VolumeReader | None = None
    _loading: "SceneLoading | None" = None
    _reading_timer: Any = None

    def wait_for_volumes(self, context: "bpy.types.Context") -> bool:
        """Start to read the scene's volumes; returns whether `modal` has to wait."""
        loading = SceneLoading(context)
        if loading.worker is None:
            return False
        self._loading = loading
        self._reading_timer = context.window_manager.event_timer_add(TICK_INTERVAL, window=context.window)
        self._show_status(context)
        operator: Any = self
        context.window_manager.modal_handler_add(operator)
        return True

    def still_waiting(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str] | None:
        """The result of `modal` while reading or after an error; None once everything is read."""
        worker = self._loading.worker
        if event.type == "ESC" and worker is not None:
            worker.stop()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER" or worker is not None and not worker.done:
            self._show_status(context)
            return {"PASS_THROUGH"}
        error = worker and worker.error
        if error is None and self._loading.outdated(context):
            self._loading = SceneLoading(context)
            return {"PASS_THROUGH"}
        self.reader = self._loading.reader
        self.stop_waiting(context)
        if error is None:
            return None
        report(self, "INFO" if worker.cancelled else "ERROR", "stopped" if worker.cancelled else str(error))
        return {"CANCELLED"}

    def _show_status(self, context: "bpy.types.Context") -> None:
        if self._loading.worker is not None:
            status_bar(context, f"{self._loading.worker.message.capitalize()}  (Esc stops)")

    def stop_waiting(self, context: "bpy.types.Context") -> None:
        """Stop reading and remove the timer."""
        if self._reading_timer is None:
            return
        context.window_manager.event_timer_remove(self._reading_timer)
        status_bar(context, None)
        self._reading_timer = None
        if self._loading.worker is not None:
            self._loading.worker.stop()
        self._loading = None
