"""Panel in the object properties of volumes and suns: how MRPNN sees them."""

import bpy

from ..mrpnn_addon.engine import MRPNNRenderEngine
from ..mrpnn_addon.material import shows_volume
from ..mrpnn_addon.scene_check import last_check
from .text import draw_text


class MRPNN_PT_object(bpy.types.Panel):
    bl_label = "MRPNN Volumes"
    bl_space_type = 'PROPERTIES'
    bl_region_type = 'WINDOW'
    bl_context = "object"

    @classmethod
    def poll(cls, context):
        shown = context.object
        return context.engine == MRPNNRenderEngine.bl_idname and shown is not None and (
            shows_volume(shown) or shown.type == 'LIGHT' and shown.data.type == 'SUN')

    def draw(self, context):
        layout, shown = self.layout, context.object
        layout.use_property_split = True
        layout.use_property_decorate = False
        if shown.type == 'LIGHT':
            layout.prop(shown, "visible_volume_scatter", text="Lights Volumes")
            return
        layout.prop(shown, "visible_camera", text="Visible to Camera")
        check = last_check()
        if check is None:
            draw_text(context, layout, "Check Scene in the render properties tells more", 'INFO')
            return
        column = layout.column()
        column.active = not check.outdated(context.scene)
        if shown.name in check.voxels:
            column.label(text=f"{' x '.join(map(str, check.voxels[shown.name]))} voxels", icon='OUTLINER_DATA_VOLUME')
        for text in (check.error, *check.warnings):
            if f"\"{shown.name}\"" in text:
                draw_text(context, column, text, 'INFO')


classes = (MRPNN_PT_object,)
