# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that bake predicted scattering into light for Cycles and EEVEE, and remove it again."""

import math
import time
from dataclasses import replace
from typing import Any

import bpy
from bpy.props import BoolProperty, StringProperty

from ..inference.scene import SceneError, Settings
from ..mrpnn_addon.baking.bake_job import BakedScene, BakeJob, BakeTarget, bake_scene
from ..mrpnn_addon.baking.baked_scene import (
    baked_keys,
    chooses_ray_marching,
    light_of_libraries,
    light_state,
    remove_light,
    show_light,
    show_sequence,
)
from ..mrpnn_addon.baking.fast_settings import set_fast
from ..mrpnn_addon.baking.light_folder import FOLDER, light_folder
from ..mrpnn_addon.baking.light_sequence import LightSequence
from ..mrpnn_addon.objects.visibility import visible_objects
from ..mrpnn_addon.runtime.background import Worker
from ..mrpnn_addon.runtime.text import report
from ..mrpnn_addon.scene.kept_frame import kept_frame
from ..mrpnn_addon.scene.reader import SceneDescription, read_frame
from ..mrpnn_addon.settings.properties import RELATIVE_PATH, scene_settings
from ..mrpnn_addon.status.calibration import calibrate_by_bake
from ..mrpnn_addon.status.forecast import BakeForecast, forecast_bake
from ..mrpnn_addon.status.lacking import lacking
from ..mrpnn_addon.status.recommendation import LAYER, recommend
from ..mrpnn_addon.volumes.reader import VolumeReader
from .modal_job import RunsWorkers
from .waiting import SceneLoading


class _LightProperties:
    """What a bake is asked for."""

    folder: StringProperty(
        name="Folder",
        subtype="DIR_PATH",
        default=FOLDER,
        options=RELATIVE_PATH,
        description="Folder for the .vdb files of the light. Until the .blend file is saved, a temporary folder",
    )
    directional: BoolProperty(
        name="Other Directions",
        default=True,
        description="Also bake the light in directions other than the camera's: for mirrors, glass, "
        "and cameras that move",
    )


class MRPNN_OT_bake_light(_LightProperties, RunsWorkers, bpy.types.Operator):
    """Predict the light that volumes scatter more than once and show it in Cycles and EEVEE, which add the rest; only
    volumes that have changed are baked. Esc stops"""

    bl_idname = "mrpnn.bake_light"
    bl_label = "Bake Light"
    bl_options = {"REGISTER", "UNDO"}
    work, doing = "bake", "baking"

    everything: BoolProperty(
        name="Bake All", default=False, options={"SKIP_SAVE"}, description="Bake unchanged volumes, too"
    )

    _loading: SceneLoading | None = None
    _description: SceneDescription
    _expected: BakeForecast | None
    _baked: BakedScene

    def execute(self, context: "bpy.types.Context") -> set[str]:
        """Bake while Blender waits."""
        try:
            self._describe(context)
            self._baked = bake_scene(self._description, self._settings(context), self._target(context.scene))
        except (SceneError, OSError) as error:
            return self.fail(error)
        return self.finish(context)

    def invoke(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        """Bake on a worker thread; Blender stays usable."""
        return self.execute(context) if bpy.app.background else self.begin(context)

    def modal(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        return self.go_on(context, event)

    def next_worker(self, context: "bpy.types.Context", done: Any) -> Worker | None:
        """One that reads the scene's volumes, then one that bakes. Neither needs bpy."""
        if done is not None and self._loading is None:
            self._baked = done.result
            return None
        if self._loading is None or self._loading.outdated(context):
            self._loading = SceneLoading(context)
            if self._loading.worker is not None:
                return self._loading.worker
        self._describe(context, self._loading.reader)
        self._loading = None
        return BakeJob(self._description, self._settings(context), self._target(context.scene))

    def _describe(self, context: "bpy.types.Context", reader: VolumeReader | None = None) -> None:
        depsgraph = context.evaluated_depsgraph_get()
        self._description = read_frame(depsgraph, reader)
        self._expected = forecast_bake(depsgraph, self.directional)

    def _settings(self, context: "bpy.types.Context") -> Settings:
        return replace(scene_settings(context.scene).settings(), directional=self.directional)

    def _target(self, scene: "bpy.types.Scene") -> BakeTarget:
        return BakeTarget(light_folder(self.folder), {} if self.everything else baked_keys(scene))

    def finish(self, context: "bpy.types.Context") -> set[str]:
        """Show the light."""
        baked = self._baked
        show_light(context.scene, baked)
        for warning in [*baked.warnings, *bake_warnings(self._description), *light_of_libraries(context.scene)]:
            report(self, "WARNING", warning)
        warn_of_temporary(self, self.folder, "save the file to keep it")
        if not baked.names:
            report(self, "INFO", f"frame {baked.frame} shows no volume, so there is no light to bake")
        elif not baked.volumes:
            report(self, "INFO", "the light of every volume is up to date")
        else:
            learn_from_bake(baked, self._expected)
            what = f"baked the light of {_count(baked.volumes)} in {baked.seconds:.1f} s"
            report(self, "INFO", f"{what}; {changed_settings(context.scene)}")
            if sentence := lacking(context.evaluated_depsgraph_get()):
                report(self, "INFO", sentence)
        return {"FINISHED"}


class MRPNN_OT_bake_animation(_LightProperties, RunsWorkers, bpy.types.Operator):
    """Bake the light of every frame from Start to End, for Cycles and EEVEE. Frames that have not changed are not
    baked again. Esc stops; the next bake goes on from there"""

    bl_idname = "mrpnn.bake_animation"
    bl_label = "Bake Animation"
    bl_options = {"REGISTER", "UNDO"}
    work, doing, visits_frames = "bake", "baking", True

    _loading: SceneLoading | None = None
    _sequence: LightSequence
    # Seconds of the frames that had to be baked, and when the present one began.
    _seconds: list
    _began = 0.0

    def execute(self, context: "bpy.types.Context") -> set[str]:
        """Bake while Blender waits."""
        try:
            self._prepare(context.scene)
            with kept_frame(context.scene):
                for frame in self._frames:
                    context.scene.frame_set(frame)
                    description = read_frame(context.evaluated_depsgraph_get(), goes_on=True)
                    self._take(bake_scene(description, self._settings, self._sequence.target))
        except (SceneError, OSError) as error:
            return self.fail(error)
        return self.finish(context)

    def invoke(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        """Bake on worker threads; Blender stays usable."""
        if bpy.app.background:
            return self.execute(context)
        try:
            self._prepare(context.scene)
        except SceneError as error:
            return self.fail(error)
        return self.begin(context)

    def modal(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        return self.go_on(context, event)

    def next_worker(self, context: "bpy.types.Context", done: Any) -> Worker | None:
        """For each frame one that reads its volumes and one that bakes."""
        if done is not None and self._loading is None:
            self._take(done.result)
        if len(self._sequence.frames) == len(self._frames):
            return None
        if self._loading is None or self._loading.outdated(context):
            # The artist may have gone to another frame meanwhile.
            context.scene.frame_set(self._frames[len(self._sequence.frames)])
            self._loading = SceneLoading(context)
            if self._loading.worker is not None:
                return self._loading.worker
        description = read_frame(context.evaluated_depsgraph_get(), self._loading.reader, goes_on=True)
        self._loading = None
        return BakeJob(description, self._settings, self._sequence.target)

    def progress(self, worker: Worker) -> tuple[float, str]:
        """Of all frames, with the time that those which are left take about."""
        done, count = len(self._sequence.frames), len(self._frames)
        fraction = worker.fraction if self._loading is None else 0.0
        text = f"frame {self._frames[min(done, count - 1)]}, {done} of {count} done"
        if self._seconds:
            left = max(count - done - fraction, 0.0) * sum(self._seconds) / len(self._seconds)
            text += f", about {math.ceil(left / 60)} min left" if left > 90 else f", about {math.ceil(left)} s left"
        return (done + fraction) / count, text

    def finish(self, context: "bpy.types.Context") -> set[str]:
        """Show the light."""
        frames = self._sequence.frames
        shows_light = any(one.volumes for one in frames)
        if shows_light:
            show_sequence(context.scene, frames)
        warnings = [warning for one in frames for warning in one.warnings] + light_of_libraries(context.scene)
        for warning in dict.fromkeys(warnings):
            report(self, "WARNING", warning)
        warn_of_temporary(self, self.folder, "save the file and bake again to keep it")
        what = f"baked the light of {len(self._seconds)} of {len(frames)} frames"
        if len(self._seconds) == len(frames):
            what = f"baked the light of {len(frames)} frames"
        empty = sum(not one.volumes for one in frames)
        if unchanged := len(frames) - empty - len(self._seconds):
            what += f"; {unchanged} {'has' if unchanged == 1 else 'have'} not changed"
        if empty:
            what += f"; {empty} {'shows' if empty == 1 else 'show'} no volume"
        if shows_light:
            report(self, "INFO", f"{what}; {changed_settings(context.scene)}")
        else:
            report(self, "INFO", "no frame shows a volume, so there is no light to bake")
        return {"FINISHED"}

    def _prepare(self, scene: "bpy.types.Scene") -> None:
        self._seconds, self._began = [], time.perf_counter()
        # It would bake each frame once more, and show that alone.
        switched: Any = scene
        switched.mrpnn_live_light = False
        self._frames = light_frames(list(range(scene.frame_start, scene.frame_end + 1)))
        self._settings = replace(scene_settings(scene).settings(), directional=self.directional)
        self._sequence = LightSequence(light_folder(self.folder))

    def _take(self, baked: BakedScene) -> None:
        self._sequence.add(baked)
        if baked.seconds:
            self._seconds.append(time.perf_counter() - self._began)
        self._began = time.perf_counter()


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
    """Set up Cycles to render baked light quickly: denoising, longer steps through volumes in Blender 4, and a single
    sample where the scene shows nothing but volumes. Remove Baked Light restores the settings"""

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


def learn_from_bake(baked: BakedScene, expected: BakeForecast | None) -> None:
    """Let further estimates know how long a bake took, unless it left out volumes that had not changed."""
    if expected is not None and baked.seconds and {one.name for one in baked.volumes} == set(baked.names):
        calibrate_by_bake(expected.work, expected.threads, baked.seconds)


def changed_settings(scene: "bpy.types.Scene") -> str:
    """What a bake has changed in the settings of the scene."""
    marching = " and Volumes > Biased is on" if chooses_ray_marching(scene) else ""
    return f"Light Paths > Max Bounces > Volume is 0 now{marching}, for the whole scene"


def light_frames(frames: list[int]) -> list[int]:
    """Frames of light, sorted. Raises SceneError where files cannot number them."""
    frames = sorted(frames)
    if not frames or frames != list(range(frames[0], frames[-1] + 1)):
        raise SceneError("baked frames must follow each other without gaps")
    if frames[0] < 0:
        raise SceneError("files of baked light cannot have negative frames; shift the animation")
    return frames


def warn_of_temporary(reporter: Any, folder: str, remedy: str) -> None:
    """Tell that light goes when Blender ends. remedy: what keeps it."""
    if not bpy.data.filepath and folder.startswith("//"):
        report(reporter, "WARNING", f"the .blend file is not saved, so the light is lost when Blender ends; {remedy}")


def _count(volumes: list) -> str:
    return "1 volume" if len(volumes) == 1 else f"{len(volumes)} volumes"


def bake_warnings(description: SceneDescription) -> list[str]:
    """What a scene with baked light lacks."""
    warnings = []
    if description.unseen:
        warnings.append(f"not baked, so they scatter light once only: {'; '.join(description.unseen)}")
    return warnings


classes = (MRPNN_OT_bake_light, MRPNN_OT_bake_animation, MRPNN_OT_bake_light_fast, MRPNN_OT_bake_light_remove)
