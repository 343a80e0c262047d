# SPDX-License-Identifier: GPL-3.0-or-later
"""MRPNN as a render engine: F12 writes the layer to the render result."""

import os
import threading
import time
import traceback
from dataclasses import replace
from typing import Any

import bpy
import gpu

from ...inference.image.layer import Layer, empty_layer
from ...inference.scene import Camera, Cancelled, SceneError
from ..nodes.material import shows_volume
from ..objects.camera import film_exposure, read_views
from ..objects.views import View
from ..objects.visibility import visible_objects
from ..output.frames import picture_path
from ..output.passes import RenderPass, extra_passes
from ..runtime.atomic_write import make_folder
from ..runtime.background import Worker
from ..runtime.text import percent, render_status, report, utf8_names
from ..scene.changes import keeps_volumes
from ..scene.film import Background, read_background
from ..scene.outputs import wanted
from ..scene.reader import SceneDescription, read_frame
from ..scene.unrendered import composited, unrendered
from ..settings.properties import scene_settings
from ..status.last_render import remember_finished
from ..volumes.loading import VolumeLoading
from ..volumes.read_ahead import ReadAhead
from ..volumes.reader import VolumeReader
from . import builtin_panels, viewport
from .render_job import render_scene, stamp, write_deep_files
from .render_result import RenderResult
from .viewport import Viewport, viewport_camera, viewport_lens
from .viewport_region import WHOLE, coarser, pixel_size, render_region

# Seconds between two looks at a thread, and between two updates of the clock.
POLL_INTERVAL, CLOCK_INTERVAL = 0.05, 0.5


class MRPNNRenderEngine(bpy.types.RenderEngine):
    bl_idname = "MRPNN"
    bl_label = "MRPNN Volumes"
    # When Python sets some properties, such as the engine, Blender waits for a preview's thread while it holds the
    # interpreter's lock. It hangs where the preview's engine is written in Python, as Cycles' is, too (4.3 and 5.2).
    # Without this flag Blender shows no previews, as for Workbench.
    bl_use_preview = False
    bl_use_postprocess = True
    # The default hides the Shader Editor.
    bl_use_shading_nodes_custom = False
    # Material Preview uses EEVEE.
    bl_use_eevee_viewport = True

    # Set when Blender draws a viewport with this engine.
    _viewport: Viewport | None = None
    # The last message shown, and when.
    _said = ("", 0.0)
    # In front of messages: Blender's progress bar stays full after Cycles, and only the text counts on.
    _part = ""
    # Of the class, since each view layer has an engine of its own: when the first one was begun.
    _asked = 0.0
    # Of the class, since each frame has an engine of its own: what reads the files of an animation's next frame.
    _ahead: ReadAhead | None = None

    def update_render_passes(self, scene: "bpy.types.Scene", renderlayer: "bpy.types.ViewLayer") -> None:
        """Register the passes for the compositor."""
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        # Blender's view layer knows no scene here, and its objects end the process.
        for extra in extra_passes(scene, scene.view_layers[renderlayer.name]):
            self.register_pass(scene, renderlayer, extra.name, len(extra.channels), extra.channels, extra.kind)

    def render(self, depsgraph: "bpy.types.Depsgraph") -> None:
        """Called by Blender for each view layer, on its render thread or, in background, on the main thread."""
        try:
            self._render(depsgraph)
        except Cancelled:
            pass
        except (SceneError, OSError) as error:
            self._fail(depsgraph, str(error))
        except Exception as error:
            traceback.print_exc()
            self._fail(depsgraph, f"MRPNN failed, which is a bug: {type(error).__name__}: {error}")

    def _fail(self, depsgraph: "bpy.types.Depsgraph", message: str) -> None:
        """Report why a frame cannot be rendered. An animation goes on behind an empty picture of it."""
        if self.is_animation:
            try:
                with utf8_names():
                    self._write_empty(depsgraph)
                return report(self, "WARNING", f"frame {depsgraph.scene.frame_current} is an empty picture: {message}")
            except Cancelled:
                return
            except (SceneError, OSError) as error:
                # The camera, without which there is no picture, may be what is wrong.
                message = message if str(error) in message else f"{message}; {error}"
            except Exception:
                traceback.print_exc()
        # An ERROR report ends the render and keeps Blender from writing a file. After error_set, or an exception, it
        # would continue and write an empty image.
        report(self, "ERROR", message)

    def view_update(self, context: "bpy.types.Context", depsgraph: "bpy.types.Depsgraph") -> None:
        """Called by Blender when something in the viewport's scene has changed."""
        if self._viewport is None:
            self._viewport = Viewport()
        self._viewport.backdrop.read(depsgraph)
        self._viewport.playing = context.screen.is_animation_playing
        space: Any = context.space_data
        if all(isinstance(update.id, bpy.types.Scene) for update in depsgraph.updates) and (
            self._viewport.shows(depsgraph, space)
        ):
            # Selection and settings, which view_draw compares, do not change the volumes.
            return
        if not all(keeps_volumes(update) for update in depsgraph.updates):
            self._viewport.reader = VolumeReader()
        if self._viewport.holds:
            self._viewport.postponed = True
            return
        self._viewport.read(depsgraph, space)

    def view_draw(self, context: "bpy.types.Context", depsgraph: "bpy.types.Depsgraph") -> None:
        """Called by Blender for each redraw of the viewport, also when only the view has changed."""
        view, size = context.region_data, (context.region.width, context.region.height)
        if self._viewport is None:
            return
        self._viewport.playing = context.screen.is_animation_playing
        space: Any = context.space_data
        self._viewport.read_on(depsgraph, space)
        part = render_region(context, depsgraph.scene)
        try:
            camera = part and viewport_camera(
                view.view_matrix, view.window_matrix, view.is_perspective, size, space.clip_end, part
            )
            camera = camera and replace(
                camera,
                resolution=coarser(camera.resolution, pixel_size(depsgraph.scene)),
                exposure=film_exposure(depsgraph.scene),
                lens=viewport_lens(context, depsgraph),
            )
        except SceneError:
            # A camera of scale 0 shows nothing.
            camera = None
        self._viewport.update(camera, scene_settings(depsgraph.scene).settings(), part or WHOLE)
        gpu.state.blend_set("ALPHA_PREMULT")
        self.bind_display_space_shader(depsgraph.scene)
        self._viewport.draw(size)
        self.unbind_display_space_shader()
        gpu.state.blend_set("NONE")
        render_status(self, self._viewport.status)
        if self._viewport.postponed and not self._viewport.holds:
            self._viewport.read(depsgraph, space)
            self.tag_redraw()

    def __del__(self) -> None:
        try:
            shown = self._viewport
        except ReferenceError:
            # Blender has freed an engine that failed in F12, which has no viewport.
            return
        if shown is not None:
            shown.close()

    @utf8_names()
    def _render(self, depsgraph: "bpy.types.Depsgraph") -> None:
        cls, view_layer, started = type(self), depsgraph.view_layer, time.perf_counter()
        self._part = "Volumes of the composite | " if composited(depsgraph.scene) else ""
        first = next((layer.name for layer in depsgraph.scene.view_layers if layer.use), view_layer.name)
        if view_layer.name == first or depsgraph.scene.render.use_single_layer:
            cls._asked = started
        if len(depsgraph.scene.view_layers) > 1 and not _shows_volumes(depsgraph):
            report(self, "INFO", f'view layer "{view_layer.name}" shows no Volume object and stays empty')
            return self._write_empty(depsgraph)
        scene = self._read(depsgraph)
        # With a render region, Blender's result has the region's size.
        scene.crop = True
        transparent = depsgraph.scene.render.film_transparent
        settings = scene_settings(depsgraph.scene).settings()
        backgrounds = [None if transparent else self._background(depsgraph, view.camera) for view in scene.views]
        passes = _passes(depsgraph)
        results = {
            view.name: RenderResult(self, view_layer, (view.camera, background), view.name, passes)
            for view, background in zip(scene.views, backgrounds)
        }
        # Background renders need no intermediate pictures.
        parts = None if bpy.app.background else results
        progress = _Progress(self, started)
        try:
            finished = render_scene(scene, settings, None, progress, progress.cancelled, parts, started)
        except BaseException:
            self.stop_reading_ahead()
            for result in results.values():
                result.end()
            raise
        told = finished.warnings if composited(depsgraph.scene) else unrendered(depsgraph).told_last(finished.warnings)
        for warning in told:
            report(self, "WARNING", warning)
        for view, layer in finished.layers:
            stamped = stamp(settings, layer.report, time.perf_counter() - started)
            results[view.name].finish(layer, stamped, scene.wanted.metadata(view_layer.name, layer))
        self._write_deep(depsgraph, finished.layers)
        finished.seconds = time.perf_counter() - cls._asked
        remember_finished(finished)

    def _read(self, depsgraph: "bpy.types.Depsgraph") -> SceneDescription:
        """The scene; a thread reads its volumes first, which Esc stops."""
        cls, reader, frames = type(self), VolumeReader(), depsgraph.scene
        sources = reader.wanted(depsgraph)
        # What was read ahead is held until this frame's volumes hold it.
        ahead, cls._ahead = cls._ahead, None
        if ahead is not None:
            self._finish(ahead)
        loading = VolumeLoading(reader, sources)
        self._finish(loading)
        if loading.error is not None:
            raise loading.error
        # Blender renders the scene of composited volumes as a still, whose picture is Cycles' with or without volumes.
        goes_on = self.is_animation or composited(frames) or len(frames.view_layers) > 1
        scene = read_frame(depsgraph, reader, self._check, goes_on, self.frame_set)
        if self.is_animation and frames.frame_current + frames.frame_step <= frames.frame_end:
            cls._ahead = ReadAhead(sources, frames.frame_step)
        return scene

    @classmethod
    def stop_reading_ahead(cls) -> None:
        """Drop what was read of an animation's next frame."""
        ahead, cls._ahead = cls._ahead, None
        if ahead is not None:
            ahead.stop()

    def _finish(self, worker: Worker) -> None:
        """Wait for a thread, which Esc stops."""
        while not worker.done:
            self.say(worker.message.capitalize())
            worker.wait(POLL_INTERVAL)
            if self.test_break():
                worker.stop()

    def _background(self, depsgraph: "bpy.types.Depsgraph", camera: Camera) -> Background:
        """The Background of a camera's pixels; reports its warnings."""

        def check() -> None:
            # Called where Cycles renders it.
            self.say("Rendering the sky")
            self._check()

        found = read_background(depsgraph, camera, check)
        for warning in found.warnings:
            report(self, "WARNING", warning)
        return found

    def say(self, message: str, before: str = "") -> None:
        """Show what is done, and Blender's clock beside it, which stands still between two messages. before: text in
        front that is no news.
        """
        now = time.perf_counter()
        if message != self._said[0] or now - self._said[1] > CLOCK_INTERVAL and not bpy.app.background:
            self._said = message, now
            render_status(self, self._part + before + message)

    def _check(self) -> None:
        if self.test_break():
            raise Cancelled()

    def _write_empty(self, depsgraph: "bpy.types.Depsgraph") -> None:
        for view in read_views(depsgraph)[0]:
            camera = view.camera
            background = None if depsgraph.scene.render.film_transparent else self._background(depsgraph, camera)
            result = RenderResult(self, depsgraph.view_layer, (camera, background), view.name, _passes(depsgraph))
            asked = wanted(depsgraph.scene, depsgraph.view_layer)
            layer = empty_layer(camera, asked.outputs)
            asked.add_to(layer, camera)
            result.finish(layer, {})
            self._write_deep(depsgraph, [(view, layer)])

    def _write_deep(self, depsgraph: "bpy.types.Depsgraph", layers: list[tuple[View, Layer]]) -> None:
        """Write deep samples beside the picture, if any. The picture stays where that fails."""
        if all(layer.deep is None for _, layer in layers):
            return
        scene, name = depsgraph.scene, depsgraph.view_layer.name
        # Blender renders the volumes of a composite as a still, in animations too.
        numbered = self.is_animation or composited(scene)
        others = sum(one.use for one in scene.view_layers) > 1 and not scene.render.use_single_layer
        try:
            path = picture_path(scene, numbered, name if others else "") + ".exr"
            make_folder(os.path.dirname(path))
            write_deep_files(path, layers, self._check)
        except (SceneError, OSError) as error:
            report(self, "WARNING", f"no deep samples are written: {error}")


class _Progress:
    """Shows a render's progress in Blender's progress bar and statistics line.

    engine: that renders, on the thread that makes this. started: `time.perf_counter()` when the render was asked for.
    """

    def __init__(self, engine: MRPNNRenderEngine, started: float) -> None:
        self._engine, self._started, self._thread = engine, started, threading.get_ident()
        self._fraction, self._message = 0.0, "Preparing"

    def __call__(self, fraction: float, message: str) -> None:
        self._fraction, self._message = fraction, f"{message[:1].upper()}{message[1:]}"
        self._engine.update_progress(fraction)
        self._tell()

    def cancelled(self) -> bool:
        """Whether Esc was pressed; asked several times a second, which keeps the clock going."""
        if threading.get_ident() == self._thread:
            self._tell()
        return self._engine.test_break()

    def _tell(self) -> None:
        seconds, fraction = time.perf_counter() - self._started, self._fraction
        # The first seconds do not predict the rest.
        left = f"Remaining: {seconds / fraction - seconds:.0f} s | " if seconds > 2.0 and fraction > 0.05 else ""
        # The seconds left differ at every call.
        self._engine.say(f"{self._message}, {percent(fraction)}", left)


def _passes(depsgraph: "bpy.types.Depsgraph") -> list[RenderPass]:
    scene = depsgraph.scene.original
    return extra_passes(scene, scene.view_layers[depsgraph.view_layer.name])


def _shows_volumes(depsgraph: "bpy.types.Depsgraph") -> bool:
    return any(shows_volume(shown.object) for shown in visible_objects(depsgraph))


def register() -> None:
    bpy.utils.register_class(MRPNNRenderEngine)
    builtin_panels.register(MRPNNRenderEngine.bl_idname)


def unregister() -> None:
    viewport.unregister()
    MRPNNRenderEngine.stop_reading_ahead()
    builtin_panels.unregister(MRPNNRenderEngine.bl_idname)
    bpy.utils.unregister_class(MRPNNRenderEngine)
