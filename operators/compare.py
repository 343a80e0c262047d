# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator `mrpnn.compare`: error against run time of the layer and of Cycles, for the scene's view."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..inference.scene import SceneError
from ..mrpnn_addon.comparison.pictures import view_png
from ..mrpnn_addon.comparison.results import Comparison
from ..mrpnn_addon.comparison.run import REPORT_FOLDER, ComparisonRun, Options
from ..mrpnn_addon.output.layer_image import IMAGE_NAME, show_image
from ..mrpnn_addon.runtime.background import in_background
from ..mrpnn_addon.runtime.text import report, status_bar
from ..mrpnn_addon.settings.properties import RELATIVE_PATH, scene_settings
from ..mrpnn_addon.status.last_comparison import remember
from .waiting import WaitsForVolumes

REFERENCE_IMAGE = f"{IMAGE_NAME} Cycles"
ERROR_IMAGE = f"{IMAGE_NAME} error"
TEXT_NAME = f"{IMAGE_NAME} comparison"
TICK_INTERVAL, POLL_INTERVAL = 0.1, 0.01


class MRPNN_OT_compare(WaitsForVolumes, bpy.types.Operator):
    """Render this view with Cycles as well, and report samples, time and error of both.
    Cycles runs in a separate process. Esc stops it and keeps what is finished; another run continues from there"""

    bl_idname = "mrpnn.compare"
    bl_label = "Compare with Cycles"

    samples: IntProperty(
        name="Samples",
        default=32,
        min=1,
        max=65536,
        description="Samples per pixel, at most, of the reference: the Cycles image that errors are measured against. "
        "Two such images are rendered, because their difference tells their noise",
    )
    budget: FloatProperty(
        name="Time Limit",
        default=300.0,
        min=0.0,
        soft_max=3600.0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
        description="Time that Cycles may take, roughly. 0 sets no limit",
    )
    ladder: IntProperty(
        name="Cycles Up To",
        default=64,
        min=0,
        max=65536,
        description="Measure Cycles at 1, 4, 16 and so on up to this many samples per pixel. 0 measures none",
    )
    denoised: BoolProperty(
        name="Denoised Cycles", default=True, description="Measure Cycles with OpenImageDenoise, too"
    )
    usual: BoolProperty(
        name="Usual Settings",
        default=False,
        description="Measure Cycles as artists set it, too: with 0, 4 and 12 volume bounces, clamped at 10, denoised, "
        "with adaptive sampling and with path guiding",
    )
    models: EnumProperty(
        name="Networks",
        default="ONE",
        description="Networks to measure",
        items=[("ONE", "The Scene's", "The scene's network"), ("ALL", "All", "Every network of the extension")],
    )
    bounces: IntProperty(
        name="Bounces", default=1024, min=1, max=1024, description="Maximum number of volume bounces in Cycles"
    )
    scale: IntProperty(
        name="Size",
        default=25,
        min=1,
        max=100,
        subtype="PERCENTAGE",
        description="Size of the compared images, relative to the render resolution. Time grows with its square",
    )
    reference_path: StringProperty(
        name="Reference Image",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"} | RELATIVE_PATH,
        description="OpenEXR image of the same view, with alpha, to measure errors against. Without it, Cycles renders "
        "one",
    )
    folder: StringProperty(
        name="Folder",
        default=REPORT_FOLDER,
        subtype="DIR_PATH",
        options=RELATIVE_PATH,
        description="Folder of the report and of finished images, from which another run continues. While the file "
        "is not saved, it is in Blender's temporary folder",
    )

    _run = None
    _timer = None
    # The generator `_finish`, once the run is done.
    _steps: Iterator[tuple[Comparison, Path] | None] | None = None
    # Whether it runs modally, as after the dialog; scripts block.
    _modal = False

    def invoke(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        self._modal = True
        # Blender prepares its view transform for the first picture, which takes up to 0.3 s: do it before anything
        # runs.
        view_png(np.zeros((1, 1, 4)), context.scene)
        return set(context.window_manager.invoke_props_dialog(self))

    def draw(self, context: "bpy.types.Context") -> None:
        layout = self.layout
        layout.use_property_split = True
        for name in ("samples", "budget", "scale"):
            layout.prop(self, name)
        header, body = layout.panel("MRPNN_compare_settings", default_closed=True)
        header.label(text="Advanced")
        if body:
            for name in ("ladder", "denoised", "usual", "models", "bounces", "reference_path", "folder"):
                body.prop(self, name)

    def execute(self, context: "bpy.types.Context") -> set[str]:
        if MRPNN_OT_compare._run is not None:
            report(self, "WARNING", "a comparison is running already; Esc stops it")
            return {"CANCELLED"}
        if self._modal and self.wait_for_volumes(context):
            return {"RUNNING_MODAL"}
        return self._start(context)

    def _start(self, context: "bpy.types.Context") -> set[str]:
        try:
            run = ComparisonRun(context, scene_settings(context.scene).settings(), self._options(), self.reader)
        except (SceneError, OSError) as error:
            return self._fail(error)
        if not self._modal:
            run.wait()
            return self._deliver(_finish(run))
        MRPNN_OT_compare._run = run
        manager = context.window_manager
        self._timer = manager.event_timer_add(TICK_INTERVAL, window=context.window)
        manager.progress_begin(0, 100)
        # After waiting for volumes, the operator is modal already.
        if self.reader is None:
            manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        if MRPNN_OT_compare._run is None:
            waiting = self.still_waiting(context, event)
            return self._start(context) if waiting is None else waiting
        run = MRPNN_OT_compare._run
        if event.type == "ESC":
            run.job.stop()
        elif event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self._steps is not None:
            return self._step(context)
        try:
            run.job.step()
        except BaseException:
            self.cancel(context)
            raise
        context.window_manager.progress_update(int(100 * run.job.fraction))
        # Unknown before Cycles' first image.
        left = f"; about {run.job.seconds_left:.0f} s of Cycles left" if run.job.fraction > 0.0 else ""
        status_bar(context, f"Comparing: {run.job.message}{left}  (Esc stops)")
        if not run.job.done:
            return {"PASS_THROUGH"}
        self._steps = _finish(run)
        status_bar(context, "Comparing: figures and report")
        return {"RUNNING_MODAL"}

    def _step(self, context: "bpy.types.Context") -> set[str]:
        """One step of the report; Blender handles events between steps."""
        try:
            done = next(self._steps)
        except BaseException as problem:
            self.cancel(context)
            return self._failed(problem)
        if done is None:
            return {"RUNNING_MODAL"}
        self.cancel(context)
        return self._deliver([done])

    def cancel(self, context: "bpy.types.Context") -> None:
        """Also called by Blender where it ends the operator itself, as when it closes or loads a file."""
        self.stop_waiting(context)
        if MRPNN_OT_compare._run is None:
            return
        MRPNN_OT_compare._run.job.stop()
        MRPNN_OT_compare._run = None
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        status_bar(context, None)

    def _options(self) -> Options:
        return Options(
            samples=self.samples,
            seconds=self.budget,
            ladder=self.ladder,
            denoised=self.denoised,
            usual=self.usual,
            all_models=self.models == "ALL",
            bounces=self.bounces,
            scale=self.scale,
            reference_path=self.reference_path,
            folder=self.folder,
        )

    def _fail(self, error: Exception | str) -> set[str]:
        report(self, "ERROR", error)
        return {"CANCELLED"}

    def _failed(self, problem: BaseException) -> set[str]:
        if isinstance(problem, ReferenceError):
            return self._fail("the compared scene was removed; the images of Cycles are kept")
        if isinstance(problem, (SceneError, OSError)):
            return self._fail(problem)
        raise problem

    def _deliver(self, steps: Any) -> set[str]:
        """Run the steps of `_finish` to the end, and report."""
        try:
            *_, (comparison, page) = steps
        except (ReferenceError, SceneError, OSError) as problem:
            return self._failed(problem)
        remember(comparison, page)
        _keep_as_text(comparison.table())
        for warning in comparison.warnings:
            report(self, "WARNING", warning)
        report(self, "INFO", f"{comparison.table()}\nreport: {page}")
        if not bpy.app.background:
            bpy.ops.wm.url_open(url=page.as_uri())
        return {"FINISHED"}


def _finish(run: ComparisonRun) -> Iterator[tuple[Comparison, Path] | None]:
    """Figures, report and images of a finished run, in short steps: yields None, and (comparison, page) last."""
    figures = in_background(run.result)
    while not figures.done():
        time.sleep(POLL_INTERVAL)
        yield None
    comparison = figures.result()
    for page in run.writing(comparison):  # noqa: B007, the last one is returned
        yield None
    show(run)
    yield comparison, page


def show(run: ComparisonRun) -> None:
    """Show the layer, the reference and their difference as images."""
    layer, reference = run.layer_image(), run.reference_image()
    show_image(layer, IMAGE_NAME)
    show_image(reference, REFERENCE_IMAGE)
    show_image(np.concatenate([layer[..., :3] - reference[..., :3], layer[..., 3:]], axis=-1), ERROR_IMAGE)


def _keep_as_text(table: str) -> None:
    """Write the table to a Text data-block."""
    text = bpy.data.texts.get(TEXT_NAME) or bpy.data.texts.new(TEXT_NAME)
    text.clear()
    text.write(table + "\n")


classes = (MRPNN_OT_compare,)
