# SPDX-License-Identifier: GPL-3.0-or-later
"""Six-way flipbooks, in the render properties, for every engine."""

from typing import Any

import bpy

from ..mrpnn_addon.settings.flipbook import flipbook_settings
from ..operators.flipbook import MRPNN_OT_flipbook, MRPNN_OT_flipbook_show


class _FlipbookPanel:
    bl_space_type: Any = "PROPERTIES"
    bl_region_type: Any = "WINDOW"
    bl_context = "render"
    bl_options: Any = {"DEFAULT_CLOSED"}
    layout: "bpy.types.UILayout"

    def split_layout(self) -> "bpy.types.UILayout":
        """The panel's layout, labels beside values."""
        self.layout.use_property_split, self.layout.use_property_decorate = True, False
        return self.layout


class MRPNN_PT_flipbook(_FlipbookPanel, bpy.types.Panel):
    bl_label = "Six-Way Flipbook"
    bl_parent_id = "MRPNN_PT_render"

    def draw(self, context: "bpy.types.Context") -> None:
        settings, layout = flipbook_settings(context.scene), self.split_layout()
        for name in ("filepath", "file_format", "view"):
            layout.prop(settings, name)
        column = layout.column(align=True)
        for name in ("columns", "rows", "size"):
            column.prop(settings, name)
        layout.operator(MRPNN_OT_flipbook.bl_idname, icon="RENDER_ANIMATION")
        layout.operator(MRPNN_OT_flipbook_show.bl_idname, icon="IMAGE_PLANE")


class MRPNN_PT_flipbook_advanced(_FlipbookPanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "MRPNN_PT_flipbook"

    def draw(self, context: "bpy.types.Context") -> None:
        settings, layout = flipbook_settings(context.scene), self.split_layout()
        for name in ("layout", "alpha", "angle", "padding", "normalized"):
            layout.prop(settings, name)


classes = (MRPNN_PT_flipbook, MRPNN_PT_flipbook_advanced)
