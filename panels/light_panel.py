# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of lights."""

from typing import Any

import bpy

from .engine_panel import EnginePanel, draw_shader


class _LightPanel(EnginePanel):
    bl_context = "data"

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return super().poll(context) and context.light is not None


class MRPNN_PT_light(_LightPanel, bpy.types.Panel):
    bl_label = "Light"

    def draw(self, context: "bpy.types.Context") -> None:
        layout = self.layout
        light: Any = context.light
        layout.row().prop(light, "type", expand=True)
        layout.use_property_split = True
        column = layout.column()
        # Lights have temperature, exposure and normalization from Blender 4.5 on.
        tinted = getattr(light, "use_temperature", False)
        if hasattr(light, "use_temperature"):
            row = column.column(heading="Temperature").row()
            row.prop(light, "use_temperature", text="")
            value = row.row()
            value.active = tinted
            value.prop(light, "temperature", text="")
        column.prop(light, "color", text="Tint" if tinted else "Color")
        column = layout.column()
        for name in ("energy", "exposure", "normalize"):
            if hasattr(light, name):
                column.prop(light, name)
        column = layout.column()
        if light.type == "SUN":
            column.prop(light, "angle")
        elif light.type == "AREA":
            column.prop(light, "shape")
            column = column.column(align=True)
            if light.shape in {"SQUARE", "DISK"}:
                column.prop(light, "size")
            else:
                column.prop(light, "size", text="Size X")
                column.prop(light, "size_y", text="Y")
        else:
            column.prop(light, "shadow_soft_size", text="Radius")
            column.prop(light, "use_soft_falloff")


class MRPNN_PT_beam_shape(_LightPanel, bpy.types.Panel):
    bl_label = "Beam Shape"
    bl_parent_id = "MRPNN_PT_light"

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return super().poll(context) and context.light.type in {"SPOT", "AREA"}

    def draw(self, context: "bpy.types.Context") -> None:
        layout = self.layout
        light: Any = context.light
        layout.use_property_split = True
        if light.type == "AREA":
            layout.prop(light, "spread")
            return
        layout.prop(light, "spot_size", text="Angle")
        layout.prop(light, "spot_blend", text="Blend", slider=True)
        layout.prop(light, "show_cone")


class MRPNN_PT_light_nodes(_LightPanel, bpy.types.Panel):
    bl_label = "Nodes"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: "bpy.types.Context") -> None:
        draw_shader(self.layout, context.light, "Surface")


classes = (MRPNN_PT_light, MRPNN_PT_beam_shape, MRPNN_PT_light_nodes)
