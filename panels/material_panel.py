# SPDX-License-Identifier: GPL-3.0-or-later
"""Shaders of the active material."""

import bpy

from .engine_panel import EnginePanel, draw_shader


class _MaterialPanel(EnginePanel):
    bl_context = "material"

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        material = context.material
        return super().poll(context) and material is not None and not material.grease_pencil


class MRPNN_PT_material_surface(_MaterialPanel, bpy.types.Panel):
    bl_label = "Surface"

    def draw(self, context: "bpy.types.Context") -> None:
        draw_shader(self.layout, context.material, "Surface", "diffuse_color")


class MRPNN_PT_material_volume(_MaterialPanel, bpy.types.Panel):
    bl_label = "Volume"

    def draw(self, context: "bpy.types.Context") -> None:
        draw_shader(self.layout, context.material, "Volume")


classes = (MRPNN_PT_material_surface, MRPNN_PT_material_volume)
