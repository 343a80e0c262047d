"""MRPNN as a render engine: F12 puts the layer into the render result."""

import bpy
import numpy as np

from ..inference.scene import Cancelled, SceneError
from .layer_frame import finite_depth, rgba
from .render_job import render_scene
from .scene import read_scene


class MRPNNRenderEngine(bpy.types.RenderEngine):
    bl_idname = "MRPNN"
    bl_label = "MRPNN Volumes"
    bl_use_preview = False
    bl_use_postprocess = True

    def update_render_passes(self, scene, renderlayer):
        """Tell the compositor which passes there will be."""
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", 'COLOR')
        if renderlayer.use_pass_z:
            self.register_pass(scene, renderlayer, "Depth", 1, "Z", 'VALUE')

    def render(self, depsgraph):
        """Blender calls this on its render thread, or in background on the main one."""
        try:
            scene = read_scene(depsgraph)
            # With a render region, Blender hands out a result of the region's size.
            scene.crop = True
            settings = depsgraph.scene.mrpnn.settings()
            finished = render_scene(scene, settings, progress=self._progress, cancelled=self.test_break)
        except Cancelled:
            return
        except SceneError as error:
            self.error_set(str(error))
            return
        for warning in finished.warnings:
            self.report({'WARNING'}, warning)
        self._write(finished.layer, depsgraph.view_layer)

    def _progress(self, fraction, message):
        self.update_progress(fraction)
        self.update_stats("", message)

    def _write(self, layer, view_layer):
        height, width = layer.alpha.shape
        if view_layer.use_pass_z:
            self.add_pass("Depth", 1, "Z", layer=view_layer.name)
        result = self.begin_result(0, 0, width, height, layer=view_layer.name)
        passes = result.layers[0].passes
        # Blender's rows start at the bottom.
        passes["Combined"].rect.foreach_set(np.ascontiguousarray(rgba(layer)[::-1]).ravel())
        if view_layer.use_pass_z:
            passes["Depth"].rect.foreach_set(np.ascontiguousarray(finite_depth(layer)[::-1]).ravel())
        self.end_result(result)


# Built-in panels for every engine carry BLENDER_RENDER; these hold material, sun and world besides.
MORE_PANELS = ('EEVEE_MATERIAL_PT_context_material', 'EEVEE_MATERIAL_PT_volume', 'DATA_PT_EEVEE_light')
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
    for panel in _panels():
        panel.COMPAT_ENGINES.discard(MRPNNRenderEngine.bl_idname)
    bpy.utils.unregister_class(MRPNNRenderEngine)
