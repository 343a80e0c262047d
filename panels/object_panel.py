# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes in the object properties."""

import bpy

from ..mrpnn_addon.nodes.material import shows_volume
from ..mrpnn_addon.runtime.text import label
from ..mrpnn_addon.status.scene_check import last_check
from .engine_panel import EnginePanel
from .text import draw_text


class MRPNN_PT_object(EnginePanel, bpy.types.Panel):
    bl_label = "MRPNN Volumes"
    bl_context = "object"

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return super().poll(context) and context.object is not None and shows_volume(context.object)

    def draw(self, context: "bpy.types.Context") -> None:
        layout, shown, check = self.layout, context.object, last_check()
        if check is None:
            draw_text(context, layout, "Check Scene in the render properties reads its voxels", "INFO")
            return
        column = layout.column()
        column.active = not check.outdated(context.scene)
        if shown.name in check.voxels:
            label(column, f"{' x '.join(map(str, check.voxels[shown.name]))} voxels", icon="OUTLINER_DATA_VOLUME")
        for text in (check.error, *check.warnings):
            if f'"{shown.name}"' in text:
                draw_text(context, column, text, "INFO")


classes = (MRPNN_PT_object,)
