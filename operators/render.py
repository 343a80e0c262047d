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
from ..mrpnn_addon.runtime.text import report
from ..mrpnn_addon.scene.kept_frame import goes_to
from ..mrpnn_addon.scene.reader import read_frame
from ..mrpnn_addon.settings.properties import RELATIVE_PATH, scene_settings
from ..mrpnn_addon.status.last_render import LastRender, remember, remember_finished
from .modal_job import RunsWorkers
from .waiting import SceneLoading


class MRPNN_OT_render(RunsWorkers, bpy.types.Operator):
    """Render the volumes that the active camera sees, lit by the scene's lights and World; Esc stops"""

    bl_idname = "mrpnn.render"
    bl_label = "Render Volumes"

    filepath: StringProperty(
        name="EXR File",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"} | RELATIVE_PATH,
        description="Multi-layer OpenEXR file to write; without it, the scene's setting applies",
    )

    work, doing = "render", "rendering"
    _loading: SceneLoading | None = None
    _finished: Finished
    _started = 0.0

    def execute(self, context: "bpy.types.Context") -> set[str]:
        """Render while Blender waits."""
        started = time.perf_counter()
        try:
            self._finished = render_scene(
                read_frame(context.evaluated_depsgraph_get(), go_to=goes_to(context.scene)),
                scene_settings(context.scene).settings(),
                self._exr_path(context.scene),
                started=started,
            )
        except (SceneError, OSError) as error:
            return self.fail(error)
        return self.finish(context)

    def invoke(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        """Render on a worker thread; Blender stays usable."""
        if bpy.app.background:
            return self.execute(context)
        self._started = time.perf_counter()
        return self.begin(context)

    def modal(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        return self.go_on(context, event)

    def next_worker(self, context: "bpy.types.Context", done: Any) -> Worker | None:
        """One that reads the scene's volumes, then one that renders. Neither needs bpy."""
        if done is not None and self._loading is None:
            self._finished = done.result
            return None
        exr_path = self._exr_path(context.scene)
        if self._loading is None or self._loading.outdated(context):
            self._loading = SceneLoading(context)
            if self._loading.worker is not None:
                return self._loading.worker
        # The scene may change from here on.
        found = read_frame(context.evaluated_depsgraph_get(), self._loading.reader, go_to=goes_to(context.scene))
        self._loading = None
        return RenderJob(found, scene_settings(context.scene).settings(), exr_path, self._started)

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

    def fail(self, error: Exception) -> set[str]:
        """Report the error, and remember it for the panel."""
        remember(LastRender(error=str(error)))
        return super().fail(error)

    def finish(self, context: "bpy.types.Context") -> set[str]:
        """Show the picture."""
        finished = self._finished
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
