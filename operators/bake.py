# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that bake predicted scattering into light for Cycles and EEVEE, and remove it again."""

from dataclasses import replace
from typing import Any

import bpy
from bpy.props import BoolProperty, StringProperty

from ..inference.scene import SceneError, Settings
from ..mrpnn_addon.baking.bake_job import BakeJob, BakeTarget, bake_scene
from ..mrpnn_addon.baking.baked_scene import baked_keys, chooses_ray_marching, light_state, remove_light, show_light
from ..mrpnn_addon.baking.fast_settings import set_fast
from ..mrpnn_addon.baking.light_folder import FOLDER, light_folder
from ..mrpnn_addon.objects.visibility import visible_objects
from ..mrpnn_addon.runtime.background import Worker
from ..mrpnn_addon.runtime.text import percent, report, status_bar
from ..mrpnn_addon.scene.reader import SceneDescription, read_frame
from ..mrpnn_addon.settings.properties import RELATIVE_PATH, scene_settings
from ..mrpnn_addon.status.recommendation import LAYER, recommend
from .waiting import SceneLoading

TICK_INTERVAL = 0.1


class MRPNN_OT_bake_light(bpy.types.Operator):
    """Predict the light that volumes scatter more than once and show it in Cycles and EEVEE, which add the rest; only
    volumes that have changed are baked. Esc stops"""

    bl_idname = "mrpnn.bake_light"
    bl_label = "Bake Light"
    bl_options = {"REGISTER", "UNDO"}

    folder: StringProperty(
        name="Folder",
        subtype="DIR_PATH",
        default=FOLDER,
        options=RELATIVE_PATH,
        description="Folder of the .vdb files with the light. Without a saved .blend file, a temporary one",
    )
    directional: BoolProperty(
        name="Other Directions",
        default=True,
        description="Also bake how the light differs from other directions than the camera's: for mirrors, glass, and "
        "cameras that move",
    )
    everything: BoolProperty(
        name="Bake All", default=False, options={"SKIP_SAVE"}, description="Also volumes that have not changed"
    )

    _job: Worker | None = None
    _loading = None
    _timer = None

    def execute(self, context: "bpy.types.Context") -> set[str]:
        """Bake while Blender waits."""
        try:
            description = read_frame(context.evaluated_depsgraph_get())
            baked = bake_scene(description, self._settings(context), self._target(context.scene))
        except (SceneError, OSError) as error:
            return self._fail(error)
        return self._deliver(context, description, baked)

    def invoke(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        """Bake on a worker thread; Blender stays usable."""
        if bpy.app.background:
            return self.execute(context)
        if MRPNN_OT_bake_light._job is not None:
            report(self, "WARNING", "MRPNN is baking already; Esc stops it")
            return {"CANCELLED"}
        try:
            MRPNN_OT_bake_light._job = self._next(context)
        except SceneError as error:
            return self._fail(error)
        manager = context.window_manager
        self._timer = manager.event_timer_add(TICK_INTERVAL, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _next(self, context: "bpy.types.Context") -> Worker:
        """The next worker: one that reads the scene's volumes, then one that bakes. Neither needs bpy."""
        if self._loading is None or self._loading.outdated(context):
            self._loading = SceneLoading(context)
            if self._loading.worker is not None:
                return self._loading.worker
        self._description = read_frame(context.evaluated_depsgraph_get(), self._loading.reader)
        self._loading = None
        return BakeJob(self._description, self._settings(context), self._target(context.scene))

    def modal(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        job: Any = MRPNN_OT_bake_light._job
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
                MRPNN_OT_bake_light._job = self._next(context)
                return {"PASS_THROUGH"}
            except SceneError as error:
                self._end(context)
                return self._fail(error)
        self._end(context)
        # Esc may come too late for the worker to notice it.
        if job.stopped:
            report(self, "INFO", "MRPNN bake stopped")
            return {"CANCELLED"}
        if isinstance(job.error, (SceneError, OSError)):
            return self._fail(job.error)
        if job.error is not None:
            raise job.error
        return self._deliver(context, self._description, job.result)

    def cancel(self, context: "bpy.types.Context") -> None:
        """Called by Blender where it ends the operator itself, as when it closes or loads a file."""
        job = MRPNN_OT_bake_light._job
        job.stop()
        job.wait()
        self._end(context)

    def _end(self, context: "bpy.types.Context") -> None:
        MRPNN_OT_bake_light._job = None
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        status_bar(context, None)

    def _settings(self, context: "bpy.types.Context") -> Settings:
        return replace(scene_settings(context.scene).settings(), directional=self.directional)

    def _target(self, scene: "bpy.types.Scene") -> BakeTarget:
        return BakeTarget(light_folder(self.folder), {} if self.everything else baked_keys(scene))

    def _fail(self, error: Exception) -> set[str]:
        report(self, "ERROR", error)
        return {"CANCELLED"}

    def _deliver(self, context: "bpy.types.Context", description: SceneDescription, baked: Any) -> set[str]:
        show_light(context.scene, baked)
        for warning in baked.warnings + bake_warnings(description):
            report(self, "WARNING", warning)
        if not bpy.data.filepath and self.folder.startswith("//"):
            report(
                self,
                "WARNING",
                "the .blend file is not saved: the light is in a temporary folder, gone when Blender ends",
            )
        if not baked.names:
            report(self, "INFO", f"frame {baked.frame} shows no volume, so there is no light to bake")
        elif not baked.volumes:
            report(self, "INFO", "the light of every volume is up to date")
        else:
            report(
                self,
                "INFO",
                f"baked the light of {_count(baked.volumes)} in {baked.seconds:.1f} s; volume bounces are 0 now"
                f"{' and volumes biased (ray marching)' if chooses_ray_marching(context.scene) else ''}, for the whole "
                "scene",
            )
        return {"FINISHED"}


class MRPNN_OT_bake_light_remove(bpy.types.Operator):
    """Remove the baked light from the scene, and restore the settings that it needed"""

    bl_idname = "mrpnn.bake_light_remove"
    bl_label = "Remove Baked Light"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return light_state(context.scene).active

    def execute(self, context: "bpy.types.Context") -> set[str]:
        remove_light(context.scene)
        scene: Any = context.scene
        scene.mrpnn_live_light = False
        return {"FINISHED"}


class MRPNN_OT_bake_light_fast(bpy.types.Operator):
    """Set what is right and fast in Cycles with baked light, which has little noise: longer steps through volumes in
    Blender 4, denoising, and a single sample where the scene shows nothing but volumes. Remove Baked Light restores the
    settings"""

    bl_idname = "mrpnn.bake_light_fast"
    bl_label = "Fast Cycles Settings"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return light_state(context.scene).active and context.scene.render.engine == "CYCLES"

    def execute(self, context: "bpy.types.Context") -> set[str]:
        report(self, "INFO", make_fast(context.evaluated_depsgraph_get()))
        return {"FINISHED"}


def make_fast(depsgraph: "bpy.types.Depsgraph") -> str:
    """Set what shows a scene's baked light fast in Cycles; gives a sentence about it."""
    lamps = any(shown.object.type == "LIGHT" and not is_sun(shown.object) for shown in visible_objects(depsgraph))
    return set_fast(bpy.context.scene, recommend(depsgraph).way == LAYER and not lamps)


def is_sun(shown_object: "bpy.types.Object") -> bool:
    """Whether a light is a sun, whose single scattering has little noise in Cycles."""
    light: Any = shown_object.data
    return light.type == "SUN"


def _count(volumes: list) -> str:
    return "1 volume" if len(volumes) == 1 else f"{len(volumes)} volumes"


def bake_warnings(description: SceneDescription) -> list[str]:
    """What a scene with baked light lacks."""
    warnings = []
    if description.unseen:
        warnings.append(f"not baked, so they scatter light once only: {'; '.join(description.unseen)}")
    return warnings


classes = (MRPNN_OT_bake_light, MRPNN_OT_bake_light_fast, MRPNN_OT_bake_light_remove)
