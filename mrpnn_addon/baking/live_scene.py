# SPDX-License-Identifier: GPL-3.0-or-later
"""The live light of one scene: baked again after each change, coarse at once and finer when nothing moves."""

import os
import shutil
import time
import traceback
from dataclasses import dataclass
from typing import Any

import bpy

from ...inference import RenderCache
from ...inference.scene import SceneError
from ..runtime.background import Worker
from ..runtime.text import percent
from ..scene.changes import scene_state, volume_changes
from ..scene.reader import SceneDescription, read_frame
from ..volumes.loading import VolumeLoading
from ..volumes.reader import VolumeReader
from .bake_job import BakedScene, BakedVolume, BakeJob, BakeTarget
from .baked_scene import bake_settings, baked_keys, light_state, show_light

# Seconds without a change after which the final light is baked.
SETTLED = 0.4
# Bytes of files beyond which the oldest go, which undo may still name: they are baked again when it does.
MOST_BYTES = 2 << 30
# What a scene's worker does.
READING, COARSE, FINE = "reading", "coarse light", "finer light"


@dataclass
class _Step:
    """What the worker does."""

    kind: str
    worker: Worker


class LiveScene:
    """Bakes one scene's light whenever that changes. `advance` is called often, on Blender's main thread.

    folder: of the files. problem: why light cannot be baked, or "".
    """

    def __init__(self, folder: str) -> None:
        self.folder, self.problem = folder, ""
        self._reader, self._cache = VolumeReader(), RenderCache()
        self._known: dict[str, BakedVolume] = {}
        self._description: SceneDescription | None = None
        self._step: _Step | None = None
        # What is baked next, when nothing moves.
        self._next = ""
        # States of the scene: that was seen last, and that the description is of.
        self._seen: tuple | None = None
        self._read: tuple | None = None
        self._moved, self._volumes, self._shows = 0.0, -1, True

    def advance(self, context: "bpy.types.Context") -> None:
        """Take what the worker has done, and start what comes next. Takes a few milliseconds."""
        try:
            self._advance(context)
        except SceneError as error:
            self._fail(error)
        except Exception as error:  # Blender would end the timer.
            self._fail(error)

    def forget_shown(self) -> None:
        """Show the light again although the scene may be as before: undo may have changed what shows it."""
        self._read, self._shows = None, False

    @property
    def status(self) -> str:
        """What is going on, for the panel."""
        if self.problem:
            return self.problem
        if self._step is None:
            return "Waiting until nothing moves" if self._next else "The light is up to date"
        doing = f"{self._step.kind.capitalize()}"
        return f"{doing} {percent(self._step.worker.fraction)}" if self._step.kind == FINE else doing

    def close(self) -> None:
        """Stop the worker."""
        if self._step is not None:
            self._step.worker.stop()
            self._step = None

    def remove_files(self) -> None:
        """Remove all files, those of undo steps included."""
        self._known.clear()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _advance(self, context: "bpy.types.Context") -> None:
        now, state = time.monotonic(), scene_state(context.scene)
        if state != self._seen:
            self._seen, self._moved = state, now
        if self._step is not None:
            if not self._step.worker.done:
                # A coarse bake goes on, or nothing would be shown while something moves.
                if self._step.kind == FINE and state != self._read:
                    self._step.worker.stop()
                return
            step: Any = self._step
            if step.kind != READING and _must_wait(context, step.worker.result):
                return
            self._step = None
            self._take(context, step.kind, step.worker)
        elif state != self._read:
            self._read_scene(context)
        elif self._next and now - self._moved >= SETTLED:
            self._bake(context, self._next)

    def _read_scene(self, context: "bpy.types.Context") -> None:
        """Describe the scene, or start to read its volumes where that takes long."""
        self.problem, self._next = "", ""
        depsgraph = context.evaluated_depsgraph_get()
        # Evaluating the scene counts as a change.
        self._read = self._seen = scene_state(context.scene)
        if self._volumes != volume_changes():
            self._volumes, self._reader = volume_changes(), VolumeReader()
        sources = self._reader.wanted(depsgraph)
        if sources:
            self._step = _Step(READING, VolumeLoading(self._reader, sources))
            return
        self._description = read_frame(depsgraph, self._reader, goes_on=True)
        self._bake(context, COARSE)

    def _bake(self, context: "bpy.types.Context", kind: str) -> None:
        """Start to bake the light that was read last."""
        description: Any = self._description
        target = BakeTarget(
            self.folder,
            baked_keys(context.scene) if self._shows else {},
            coarse=kind == COARSE,
            known=dict(self._known),
            cache=self._cache,
        )
        self._next = FINE if kind == COARSE else ""
        self._step = _Step(kind, BakeJob(description, bake_settings(context.scene), target))

    def _take(self, context: "bpy.types.Context", kind: str, worker: Any) -> None:
        """Show what a worker has done."""
        if worker.stopped:
            return
        if worker.error is not None:
            raise worker.error
        if kind == READING:
            self._read_scene(context)
            return
        baked: BakedScene = worker.result
        if _changes(context.scene, baked):
            self._show(context, baked)
        self._shows = True
        if kind == FINE:
            self._known.update((one.key, one) for one in baked.volumes)
            self._remove_oldest({one.path for one in baked.volumes})

    def _show(self, context: "bpy.types.Context", baked: BakedScene) -> None:
        """Show light, which counts as no change of the scene.

        Blender reads its file when it evaluates the scene next, after the timer. Objects that come or go evaluate
        everything anew, and so what they change is taken as read at once.
        """
        objects = {item.name: item.shown for item in light_state(context.scene).volumes}
        if objects.keys() == set(baked.names) and all(objects.values()):
            show_light(context.scene, baked)
            return
        context.evaluated_depsgraph_get()
        unread, unread_volumes = scene_state(context.scene) != self._read, volume_changes() != self._volumes
        show_light(context.scene, baked)
        context.evaluated_depsgraph_get()
        if not unread:
            self._read = self._seen = scene_state(context.scene)
        if not unread_volumes:
            self._volumes = volume_changes()

    def _fail(self, error: Exception) -> None:
        """Tell the panel; the next change of the scene is another try."""
        self._step, self._next = None, ""
        self.problem = str(error)
        if not isinstance(error, (SceneError, OSError)):
            traceback.print_exception(error)
            self.problem = f"Live Light failed, which is a bug: {type(error).__name__}: {error}"

    def _remove_oldest(self, shown: set[str]) -> None:
        """Remove the oldest files beyond MOST_BYTES, but for those that are shown."""
        if not os.path.isdir(self.folder):
            return
        files = sorted(os.scandir(self.folder), key=lambda entry: entry.stat().st_mtime)
        total = sum(entry.stat().st_size for entry in files)
        for entry in files:
            if total > MOST_BYTES and entry.path not in shown:
                total -= entry.stat().st_size
                os.unlink(entry.path)
                self._known = {key: one for key, one in self._known.items() if one.path != entry.path}


def _changes(scene: "bpy.types.Scene", baked: BakedScene) -> bool:
    """Whether anything of a bake is not shown yet."""
    return bool(baked.volumes) or any(item.name not in baked.names for item in light_state(scene).volumes)


def _must_wait(context: "bpy.types.Context", baked: BakedScene | None) -> bool:
    """Whether objects would come or go while an operator such as Move runs, which may hold on to them."""
    if baked is None or not any(_operators(window) for window in context.window_manager.windows):
        return False
    shown = {item.name for item in light_state(context.scene).volumes if item.shown is not None}
    return shown != set(baked.names)


def _operators(window: "bpy.types.Window") -> bool:
    """Whether modal operators run in a window; Blender says so from 4.3 on."""
    return bool(len(getattr(window, "modal_operators", ())))
