# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator `mrpnn.render`: render the scene's volumes to an Image and, if requested, to an EXR file."""

import functools
import os
import time
from typing import Any

import bpy
from bpy.props import StringProperty

from ..inference.scene import SceneError
from ..mrpnn_addon.engine.render_job import Finished, RenderJob, render_scene
from ..mrpnn_addon.output.layer_image import IMAGE_NAME, show_in_image
from ..mrpnn_addon.runtime.background import Worker
from ..mrpnn_addon.runtime.text import percent, report, status_bar
from ..mrpnn_addon.scene.reader import read_frame
from ..mrpnn_addon.settings.properties import RELATIVE_PATH, scene_settings
from ..mrpnn_addon.status.last_render import LastRender, remember, remember_finished
from .waiting import SceneLoading

TICK_INTERVAL = 0.1


class MRPNN_OT_render(bpy.types.Operator):
    """Render the volumes that the active camera sees, lit by the scene's lights and World; Esc stops"""

    bl_idname = "mrpnn.render"
    bl_label = "Render Volumes"

    filepath: StringProperty(
        name="EXR File",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"} | RELATIVE_PATH,
        description="Multi-layer OpenEXR file to write; without it, the scene's setting applies",
    )

    _job: Worker | None = None
    _loading = None
    _timer = None
    _started = 0.0

    def execute(self, context: "bpy.types.Context") -> set[str]:
        """Render while Blender waits."""
        started = time.perf_counter()
        try:
            finished = render_scene(
                read_frame(context.evaluated_depsgraph_get()),
                scene_settings(context.scene).settings(),
                self._exr_path(context.scene),
                started=started,
            )
        except (SceneError, OSError) as error:
            return self._fail(error)
        return self._deliver(context, finished)

    def invoke(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        """Render on a worker thread; Blender stays usable."""
        if bpy.app.background:
            return self.execute(context)
        if MRPNN_OT_render._job is not None:
            report(self, "WARNING", "MRPNN is rendering already; Esc stops it")
            return {"CANCELLED"}
        self._started = time.perf_counter()
        try:
            MRPNN_OT_render._job = self._next(context)
        except SceneError as error:
            return self._fail(error)
        manager = context.window_manager
        self._timer = manager.event_timer_add(TICK_INTERVAL, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _next(self, context: "bpy.types.Context") -> Worker:
        """The next worker: one that reads the scene's volumes, then one that renders. Neither needs bpy."""
        exr_path = self._exr_path(context.scene)
        if self._loading is None or self._loading.outdated(context):
            self._loading = SceneLoading(context)
            if self._loading.worker is not None:
                return self._loading.worker
        # The scene may change from here on.
        found = read_frame(context.evaluated_depsgraph_get(), self._loading.reader)
        self._loading = None
        return RenderJob(found, scene_settings(context.scene).settings(), exr_path, self._started)

    def modal(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        job: Any = MRPNN_OT_render._job
        if event.type == "ESC":
            job.stop()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        context.window_manager.progress_update(int(100 * job.fraction))
        status_bar(context, f"MRPNN {percent(job.fraction)}  {job.message}  (Esc stops)")
        if not job.done:
            return {"PASS_THROUGH"}
        if self._loading is not None and job.error is None and not job.stopped:
            try:
                MRPNN_OT_render._job = self._next(context)
                return {"PASS_THROUGH"}
            except SceneError as error:
                self._end(context)
                return self._fail(error)
        self._end(context)
        # Esc may come too late for the worker to notice it.
        if job.stopped:
            report(self, "INFO", "MRPNN render stopped")
            return {"CANCELLED"}
        if isinstance(job.error, (SceneError, OSError)):
            return self._fail(job.error)
        if job.error is not None:
            raise job.error
        return self._deliver(context, job.result)

    def cancel(self, context: "bpy.types.Context") -> None:
        """Called by Blender where it ends the operator itself, as when it closes or loads a file."""
        job = MRPNN_OT_render._job
        job.stop()
        job.wait()
        self._end(context)

    def _end(self, context: "bpy.types.Context") -> None:
        MRPNN_OT_render._job = None
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        status_bar(context, None)

    def _exr_path(self, scene: "bpy.types.Scene") -> str | None:
        path = self.filepath or (scene_settings(scene).exr_path if scene_settings(scene).use_exr else "")
        if not path:
            return None
        path = bpy.path.abspath(path)
        if not os.path.isabs(path):
            raise SceneError(
                f"the EXR file {path} is relative to the .blend file, which is not saved yet; "
                "save it, or enter a full path"
            )
        # A downloaded scene has its own path, which must not overwrite anything but pictures.
        if not path.lower().endswith(".exr"):
            raise SceneError(f"the EXR file {path} must end in .exr")
        if not os.path.isdir(os.path.dirname(path)):
            raise SceneError(f"the folder of the EXR file does not exist: {os.path.dirname(path)}")
        return path

    def _fail(self, error: Exception) -> set[str]:
        remember(LastRender(error=str(error)))
        report(self, "ERROR", error)
        return {"CANCELLED"}

    def _deliver(self, context: "bpy.types.Context", finished: Finished) -> set[str]:
        # From the last to the first view, which is displayed.
        for view, layer in reversed(finished.layers):
            image = show_in_image(layer, IMAGE_NAME + view.suffix)
        if not bpy.app.background:
            # After this operator has ended: opening a window runs its handlers again.
            bpy.app.timers.register(functools.partial(_display, image.name))
        remember_finished(finished)
        for warning in finished.warnings:
            report(self, "WARNING", warning)
        report(
            self,
            "INFO",
            f"MRPNN rendered {image.size[0]} x {image.size[1]} pixels in {finished.seconds:.1f} s "
            f'into image "{image.name}"',
        )
        return {"FINISHED"}


def _display(name: str) -> None:
    """Show the image in an open Image Editor, or open a window with one."""
    image: Any = bpy.data.images.get(name)
    windows = bpy.context.window_manager.windows
    if image is None or not windows:
        return
    if not _image_editors():
        # Blender's render view: a new window or area, by the user's preferences.
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.render.view_show("INVOKE_DEFAULT")
    for editor in _image_editors()[:1]:
        editor.image = image


def _image_editors() -> list[Any]:
    return [
        area.spaces.active
        for window in bpy.context.window_manager.windows
        for area in window.screen.areas
        if area.type == "IMAGE_EDITOR"
    ]


classes = (MRPNN_OT_render,)
