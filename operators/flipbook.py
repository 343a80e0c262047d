# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that render six-way flipbooks and show them."""

import os
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from ..inference.scene import Camera, SceneError
from ..mrpnn_addon.flipbook.atlas import Atlas
from ..mrpnn_addon.flipbook.flipbook import Flipbook, TileJob, WriteJob
from ..mrpnn_addon.flipbook.framing import framing, sized, spread, visible_corners
from ..mrpnn_addon.flipbook.preview import show_flipbook
from ..mrpnn_addon.objects.camera import read_camera
from ..mrpnn_addon.output.frames import frame_path
from ..mrpnn_addon.runtime.background import Worker
from ..mrpnn_addon.runtime.text import report
from ..mrpnn_addon.scene.kept_frame import kept_frame
from ..mrpnn_addon.scene.reader import SceneDescription, read_frame
from ..mrpnn_addon.settings.flipbook import flipbook_settings
from ..mrpnn_addon.settings.properties import scene_settings
from .modal_job import RunsWorkers
from .waiting import SceneLoading


def begin_flipbook(scene: "bpy.types.Scene", frames: list[int], automatic: bool = True) -> Flipbook:
    """The flipbook that a scene's settings ask for, without tiles yet. Visits the frames.

    automatic: whether more frames than there are tiles are thinned out; otherwise they are refused. Raises SceneError
    for settings that do not fit together, and where the scene has no camera or shows no volume.
    """
    wanted = flipbook_settings(scene)
    if len(frames) > wanted.columns * wanted.rows and not automatic:
        raise SceneError(
            f"{len(frames)} frames do not fit into {wanted.columns} x {wanted.rows} tiles; use more tiles, or fewer "
            "frames"
        )
    frames = spread(frames, wanted.columns * wanted.rows)
    atlas = Atlas(
        columns=wanted.columns,
        rows=wanted.rows,
        tile=wanted.size // wanted.columns,
        padding=wanted.padding,
        layout=wanted.layout,
        straight=wanted.alpha == "STRAIGHT",
        normalized=wanted.normalized,
    )
    base = files_of(scene)
    fps = scene.render.fps / scene.render.fps_base
    camera = _framing(scene, frames) if wanted.view == "AUTO" else None
    return Flipbook(atlas, frames, base, wanted.file_format, camera, wanted.angle, fps)


def files_of(scene: "bpy.types.Scene") -> str:
    """The absolute path of a flipbook's files without what their names end in. Raises SceneError without a name."""
    path = flipbook_settings(scene).filepath
    base = os.path.splitext(frame_path(path, 0, many=False))[0]
    if not os.path.basename(path):
        raise SceneError("the flipbook's files have no name; enter one under Files")
    return base


def _framing(scene: "bpy.types.Scene", frames: list[int]) -> Camera:
    camera, corners = None, []
    for frame in frames:
        scene.frame_set(frame)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        corners.append(visible_corners(depsgraph))
        if camera is None and len(corners[-1]):
            camera, _ = read_camera(depsgraph)
    if camera is None:
        raise SceneError("no frame shows a volume; add one, or choose other frames")
    return framing(camera, np.concatenate(corners))


def seen(flipbook: Flipbook, description: SceneDescription) -> SceneDescription:
    """A frame as the camera of the flipbook sees it."""
    return replace(description, camera=sized(flipbook.camera or description.camera, flipbook.atlas.inner))


class MRPNN_OT_flipbook(RunsWorkers, bpy.types.Operator):
    """Render the volumes of all frames lit from six sides, and pack them into textures for game engines; Esc stops"""

    bl_idname = "mrpnn.flipbook"
    bl_label = "Render Flipbook"
    work, doing, visits_frames = "flipbook", "rendering a flipbook", True

    _loading: SceneLoading | None = None
    _flipbook: Flipbook | None = None
    _paths: list[str] = []

    def execute(self, context: "bpy.types.Context") -> set[str]:
        """Render while Blender waits."""
        scene = context.scene
        try:
            with kept_frame(scene):
                book = begin_flipbook(scene, scene_frames(scene))
                for frame in book.frames:
                    scene.frame_set(frame)
                    description = read_frame(context.evaluated_depsgraph_get(), goes_on=True, flows=True)
                    book.render(seen(book, description), scene_settings(scene).settings())
            self._flipbook, self._paths = book, book.write()
        except (SceneError, OSError) as error:
            return self.fail(error)
        return self.finish(context)

    def invoke(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        """Render on worker threads; Blender stays usable."""
        return self.execute(context) if bpy.app.background else self.begin(context)

    def modal(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        return self.go_on(context, event)

    def next_worker(self, context: "bpy.types.Context", done: Any) -> Worker | None:
        """For each frame one that reads its volumes and one that renders; at the end one that writes the files."""
        scene = context.scene
        if isinstance(done, WriteJob):
            self._paths = done.result
            return None
        if self._flipbook is None:
            self._flipbook = begin_flipbook(scene, scene_frames(scene))
        book = self._flipbook
        if len(book.tiles) == len(book.frames):
            return WriteJob(book)
        if self._loading is None or self._loading.outdated(context):
            # The artist may have gone to another frame meanwhile.
            scene.frame_set(book.frames[len(book.tiles)])
            self._loading = SceneLoading(context, flows=True)
            if self._loading.worker is not None:
                return self._loading.worker
        depsgraph = context.evaluated_depsgraph_get()
        description = read_frame(depsgraph, self._loading.reader, goes_on=True, flows=True)
        self._loading = None
        return TileJob(book, seen(book, description), scene_settings(scene).settings())

    def progress(self, worker: Worker) -> tuple[float, str]:
        """Of all frames."""
        if self._flipbook is None or isinstance(worker, WriteJob):
            return 1.0, worker.message
        done, count = len(self._flipbook.tiles), len(self._flipbook.frames)
        fraction = worker.fraction if isinstance(worker, TileJob) else 0.0
        frame = self._flipbook.frames[min(done, count - 1)]
        return min(done + fraction, count) / count, f"frame {frame}, {done} of {count} tiles done"

    def finish(self, context: "bpy.types.Context") -> set[str]:
        """Tell of the files."""
        for warning in self._flipbook.warnings:
            report(self, "WARNING", warning)
        count = sum(tile is not None for tile in self._flipbook.tiles.values())
        names = ", ".join(os.path.basename(path) for path in self._paths)
        report(self, "INFO", f"wrote a flipbook of {count} tiles: {names}")
        return {"FINISHED"}


class MRPNN_OT_flipbook_show(bpy.types.Operator):
    """Add a plane that shows the flipbook, with a slider for the light from each side in its material"""

    bl_idname = "mrpnn.flipbook_show"
    bl_label = "Show Flipbook"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: "bpy.types.Context") -> set[str]:
        scene = context.scene
        try:
            plane = show_flipbook(scene, files_of(scene), flipbook_settings(scene).file_format)
        except SceneError as error:
            report(self, "ERROR", error)
            return {"CANCELLED"}
        for shown in context.selected_objects:
            shown.select_set(False)
        plane.select_set(True)
        context.view_layer.objects.active = plane
        report(self, "INFO", f'object "{plane.name}" shows the flipbook; its material has a slider for each side')
        return {"FINISHED"}


def scene_frames(scene: "bpy.types.Scene") -> list[int]:
    """The frames of an animation."""
    return list(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))


classes = (MRPNN_OT_flipbook, MRPNN_OT_flipbook_show)
