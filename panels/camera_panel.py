# SPDX-License-Identifier: GPL-3.0-or-later
"""Panorama settings, of which Blender's own panel shows only Cycles'."""

import bpy

from ..mrpnn_addon.objects.camera import panorama_settings
from .engine_panel import EnginePanel
from .text import draw_text


class MRPNN_PT_panorama(EnginePanel, bpy.types.Panel):
    bl_label = "Panorama"
    bl_context = "data"
    bl_parent_id = "DATA_PT_lens"

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return (
            super().poll(context)
            and context.camera is not None
            and context.camera.type == "PANO"
            and panorama_settings(context.camera) is not None
        )

    def draw(self, context: "bpy.types.Context") -> None:
        layout, settings = self.layout, panorama_settings(context.camera)
        layout.use_property_split = True
        layout.prop(settings, "panorama_type", text="Type")
        if settings.panorama_type != "EQUIRECTANGULAR":
            draw_text(context, layout, "Only equirectangular panoramas are rendered", "ERROR")
            return
        for name in ("latitude", "longitude"):
            column = layout.column(align=True)
            column.prop(settings, f"{name}_min", text=f"{name.title()} Min")
            column.prop(settings, f"{name}_max", text="Max")


classes = (MRPNN_PT_panorama,)
