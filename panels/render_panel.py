"""Panel in the render properties, for every engine."""

import textwrap

import bpy

from ..mrpnn_addon.last_render import last_render
from ..operators.compare import MRPNN_OT_compare
from ..operators.render import MRPNN_OT_render

# Of Blender's interface font, at scale 1.
PIXELS_A_LETTER = 8


class MRPNN_PT_render(bpy.types.Panel):
    bl_label = "MRPNN Volumes"
    bl_space_type = 'PROPERTIES'
    bl_region_type = 'WINDOW'
    bl_context = "render"

    def draw(self, context):
        layout, settings = self.layout, context.scene.mrpnn
        layout.operator(MRPNN_OT_render.bl_idname, icon='RENDER_STILL')
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.prop(settings, "depth_samples")
        column.prop(settings, "model")
        column.prop(settings, "seed")
        column.prop(settings, "threads")
        column.prop(settings, "memory_limit")
        row = column.row(heading="Write EXR")
        row.prop(settings, "use_exr", text="")
        path = row.row()
        path.active = settings.use_exr
        path.prop(settings, "exr_path", text="")
        layout.operator(MRPNN_OT_compare.bl_idname)
        letters = context.region.width / (PIXELS_A_LETTER * context.preferences.system.ui_scale)
        _draw_last(layout, last_render(), max(int(letters), 20))


def _draw_last(layout, last, letters):
    """Time and warnings of the last render, or why it failed, in lines of so many letters."""
    if last is None:
        return
    if last.error:
        _draw_text(layout.box(), last.error, 'ERROR', letters)
        return
    layout.label(text=f"Last render: {last.seconds:.1f} s", icon='TIME')
    for warning in last.warnings:
        _draw_text(layout.box(), warning, 'INFO', letters)


def _draw_text(layout, text, icon, letters):
    # Labels do not wrap by themselves.
    column = layout.column(align=True)
    for index, line in enumerate(textwrap.wrap(text, letters)):
        column.label(text=line, icon=icon if index == 0 else 'BLANK1')


classes = (MRPNN_PT_render,)
