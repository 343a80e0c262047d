# SPDX-License-Identifier: GPL-3.0-or-later
"""The World's shader and ray visibility."""

import bpy

from .engine_panel import EnginePanel, draw_shader


class _WorldPanel(EnginePanel):
    bl_context = "world"

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return super().poll(context) and context.world is not None


class MRPNN_PT_world_surface(_WorldPanel, bpy.types.Panel):
    bl_label = "Surface"

    def draw(self, context: "bpy.types.Context") -> None:
        draw_shader(self.layout, context.world, "Surface", "color")


class MRPNN_PT_world_visibility(_WorldPanel, bpy.types.Panel):
    bl_label = "Ray Visibility"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        # Properties of Cycles, absent while Cycles is disabled.
        return super().poll(context) and hasattr(context.world, "cycles_visibility")

    def draw(self, context: "bpy.types.Context") -> None:
        self.layout.use_property_split = True
        visibility = context.world.cycles_visibility
        self.layout.prop(visibility, "camera")
        self.layout.prop(visibility, "scatter")


classes = (MRPNN_PT_world_surface, MRPNN_PT_world_visibility)
