# SPDX-License-Identifier: GPL-3.0-or-later
"""Six-way flipbooks, in the render properties, for every engine."""

import bpy

from ..mrpnn_addon.settings.flipbook import flipbook_settings
from ..operators.flipbook import MRPNN_OT_flipbook, MRPNN_OT_flipbook_show


class MRPNN_PT_flipbook(bpy.types.Panel):
    bl_label = "Six-Way Flipbook"
    bl_parent_id = "MRPNN_PT_render"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: "bpy.types.Context") -> None:
        settings, layout = flipbook_settings(context.scene), self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        for name in ("filepath", "file_format", "layout", "alpha", "view", "angle"):
            layout.prop(settings, name)
        column = layout.column(align=True)
        for name in ("columns", "rows", "size", "padding"):
            column.prop(settings, name)
        layout.prop(settings, "normalized")
        layout.operator(MRPNN_OT_flipbook.bl_idname, icon="RENDER_ANIMATION")
        layout.operator(MRPNN_OT_flipbook_show.bl_idname, icon="IMAGE_PLANE")


classes = (MRPNN_PT_flipbook,)
