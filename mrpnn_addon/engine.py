"""MRPNN as a render engine: F12 puts the layer into the render result."""

import time
import traceback

import bpy
import gpu
import numpy as np

from ..inference.scene import Cancelled, SceneError
from . import viewport
from .film import background, on_background
from .last_render import remember_finished
from .layer_frame import rgba
from .material import shows_volume
from .passes import extra_passes
from .render_job import render_scene, stamp
from .scene import read_scene
from .viewport import Viewport, viewport_camera
from .viewport_region import render_region
from .visibility import shown_objects
from .volume_loading import VolumeLoading
from .volumes import VolumeReader


SECONDS_A_LOOK = 0.05


class MRPNNRenderEngine(bpy.types.RenderEngine):
    bl_idname = "MRPNN"
    bl_label = "MRPNN Volumes"
    bl_use_preview = False
    bl_use_postprocess = True
    # Material Preview is EEVEE's.
    bl_use_eevee_viewport = True

    # Set where Blender draws a viewport with this engine.
    _viewport = None

    def update_render_passes(self, scene, renderlayer):
        """Tell the compositor which passes there will be."""
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", 'COLOR')
        for extra in extra_passes(renderlayer):
            self.register_pass(scene, renderlayer, extra.name, len(extra.channels), extra.channels, extra.kind)

    def render(self, depsgraph):
        """Blender calls this for each view layer, on its render thread, or in background on the main one."""
        # A report of ERROR ends the render and keeps Blender from writing a file. After error_set, or
        # an exception, it would go on, and write an empty image.
        try:
            self._render(depsgraph)
        except Cancelled:
            pass
        except (SceneError, OSError) as error:
            self.report({'ERROR'}, str(error))
        except Exception as error:
            traceback.print_exc()
            self.report({'ERROR'}, f"MRPNN failed, which is a bug: {type(error).__name__}: {error}")

    def view_update(self, context, depsgraph):
        """Blender calls this when something in the viewport's scene has changed."""
        if self._viewport is None:
            self._viewport = Viewport()
        elif all(isinstance(update.id, bpy.types.Scene) for update in depsgraph.updates) and (
                self._viewport.shows(depsgraph, context.space_data)):
            # Selecting, and settings, which view_draw compares: the volumes are as they were.
            return
        if not all(_leaves_volumes(update) for update in depsgraph.updates):
            self._viewport.reader = VolumeReader()
        self._viewport.read(depsgraph, context.space_data)

    def view_draw(self, context, depsgraph):
        """Blender calls this for each redraw of the viewport, also when only the view has changed."""
        view, size = context.region_data, (context.region.width, context.region.height)
        if self._viewport is None:
            return
        self._viewport.read_on(depsgraph, context.space_data)
        part = render_region(context, depsgraph.scene)
        try:
            camera = part and viewport_camera(view.view_matrix, view.window_matrix, view.is_perspective, size,
                                              context.space_data.clip_end, part)
        except SceneError:
            # Through a camera of scale 0 there is nothing to see.
            camera = None
        self._viewport.look(camera, depsgraph.scene.mrpnn.settings(), part)
        gpu.state.blend_set('ALPHA_PREMULT')
        self.bind_display_space_shader(depsgraph.scene)
        self._viewport.draw(size)
        self.unbind_display_space_shader()
        gpu.state.blend_set('NONE')
        self.update_stats("", self._viewport.status)

    def __del__(self):
        if self._viewport is not None:
            self._viewport.close()

    def _render(self, depsgraph):
        view_layer = depsgraph.view_layer
        if len(depsgraph.scene.view_layers) > 1 and not _shows_volumes(depsgraph):
            self.report({'INFO'}, f"view layer \"{view_layer.name}\" shows no Volume object and stays empty")
            return self._write_empty(depsgraph)
        self.update_stats("", "Reading volumes")
        scene = self._read(depsgraph)
        # With a render region, Blender hands out a result of the region's size.
        scene.crop = True
        settings = depsgraph.scene.mrpnn.settings()
        finished = render_scene(scene, settings, progress=_Progress(self), cancelled=self.test_break)
        remember_finished(finished)
        warnings = finished.warnings
        image = rgba(finished.layer)
        if not depsgraph.scene.render.film_transparent:
            behind, more = background(depsgraph)
            warnings = [*warnings, *more]
            image = on_background(finished.layer, behind)
        for warning in warnings:
            self.report({'WARNING'}, warning)
        extras = [(extra, extra.pixels(finished.layer)) for extra in extra_passes(view_layer)]
        self._write(view_layer, image, extras, stamp(settings, finished.layer.report))

    def _read(self, depsgraph):
        """The scene, its volumes read on a thread first, which Esc ends."""
        reader = VolumeReader()
        loading = VolumeLoading(reader, reader.wanted(depsgraph))
        while not loading.done:
            loading.wait(SECONDS_A_LOOK)
            if self.test_break():
                loading.stop()
        if loading.error is not None:
            raise loading.error
        return read_scene(depsgraph, reader, self._check)

    def _check(self):
        if self.test_break():
            raise Cancelled()

    def _write_empty(self, depsgraph):
        x, y = self.resolution_x, self.resolution_y
        image = np.zeros((y, x, 4), np.float32)
        if not depsgraph.scene.render.film_transparent:
            image[...] = (*background(depsgraph)[0], 1.0)
        self._write(depsgraph.view_layer, image, [], {})

    def _write(self, view_layer, image, extras, stamped):
        """Hand over Combined (H, W, 4) and further passes, pairs of RenderPass and pixels."""
        height, width = image.shape[:2]
        for extra, _ in extras:
            self.add_pass(extra.name, len(extra.channels), extra.channels, layer=view_layer.name)
        result = self.begin_result(0, 0, width, height, layer=view_layer.name)
        passes = result.layers[0].passes
        # Blender's rows start at the bottom.
        passes["Combined"].rect.foreach_set(np.ascontiguousarray(image[::-1]).ravel())
        for extra, pixels in extras:
            passes[extra.name].rect.foreach_set(np.ascontiguousarray(pixels[::-1]).ravel())
        self.end_result(result)
        # What is stamped on the part that was handed over gets lost; the whole keeps it.
        whole = self.get_result()
        for name, value in stamped.items():
            whole.stamp_data_add_field(f"mrpnn.{view_layer.name}.{name}", value)


class _Progress:
    """Shows how far a render is in Blender's progress bar and statistics line."""

    def __init__(self, engine):
        self.engine, self.start = engine, time.monotonic()

    def __call__(self, fraction, message):
        self.engine.update_progress(fraction)
        seconds = time.monotonic() - self.start
        # The first seconds say little about the rest.
        left = f"Remaining: {seconds / fraction - seconds:.0f} s | " if seconds > 2.0 and fraction > 0.05 else ""
        self.engine.update_stats("", f"{left}{message[:1].upper()}{message[1:]}, {fraction:.0%}")


def _leaves_volumes(update) -> bool:
    """Whether what has changed cannot have changed the voxels of a volume, only where it is and what lights it."""
    if isinstance(update.id, (bpy.types.Scene, bpy.types.World, bpy.types.Light, bpy.types.Camera)):
        return True
    if not isinstance(update.id, bpy.types.Object):
        return False
    return update.id.type in ('LIGHT', 'CAMERA') or not (update.is_updated_geometry or update.is_updated_shading)


def _shows_volumes(depsgraph) -> bool:
    return any(shows_volume(shown.object) for shown in shown_objects(depsgraph))


# Built-in panels for every engine carry BLENDER_RENDER; these hold material, sun and world besides.
MORE_PANELS = ('EEVEE_MATERIAL_PT_context_material', 'EEVEE_MATERIAL_PT_volume', 'DATA_PT_EEVEE_light',
               'VIEWLAYER_PT_layer_passes')
# Post-effects on surfaces, which this engine does not render.
FOREIGN_PANELS = ('VIEWLAYER_PT_filter', 'RENDER_PT_freestyle')


def _panels():
    """Built-in panels to show while this engine is chosen."""
    for panel in bpy.types.Panel.__subclasses__():
        engines = getattr(panel, 'COMPAT_ENGINES', ())
        general = 'BLENDER_RENDER' in engines and panel.__name__ not in FOREIGN_PANELS
        if general or panel.__name__ in MORE_PANELS:
            yield panel


def register():
    bpy.utils.register_class(MRPNNRenderEngine)
    for panel in _panels():
        panel.COMPAT_ENGINES.add(MRPNNRenderEngine.bl_idname)


def unregister():
    viewport.unregister()
    for panel in _panels():
        panel.COMPAT_ENGINES.discard(MRPNNRenderEngine.bl_idname)
    bpy.utils.unregister_class(MRPNNRenderEngine)
