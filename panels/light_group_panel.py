# SPDX-License-Identifier: GPL-3.0-or-later
"""The light group of an object and of the World."""

from typing import Any

import bpy

from .engine_panel import EnginePanel


class _LightGroupPanel(EnginePanel):
    bl_label = "Light Group"
    bl_options: Any = {"DEFAULT_CLOSED"}

    @classmethod
    def member(cls, context: "bpy.types.Context") -> Any:
        """What belongs to the group; None without any."""
        raise NotImplementedError

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return super().poll(context) and cls.member(context) is not None

    def draw(self: Any, context: "bpy.types.Context") -> None:
        layout, member, view_layer = self.layout, self.member(context), context.view_layer
        layout.use_property_split = True
        row = layout.row(align=True)
        row.prop_search(member, "lightgroup", view_layer, "lightgroups", results_are_suggestions=True)
        add = row.row(align=True)
        add.enabled = bool(member.lightgroup) and member.lightgroup not in view_layer.lightgroups
        add.operator("scene.view_layer_add_lightgroup", icon="ADD", text="").name = member.lightgroup


class MRPNN_PT_object_light_group(_LightGroupPanel, bpy.types.Panel):
    bl_context = "object"

    @classmethod
    def member(cls, context: "bpy.types.Context") -> Any:
        return context.object


class MRPNN_PT_world_light_group(_LightGroupPanel, bpy.types.Panel):
    bl_context = "world"

    @classmethod
    def member(cls, context: "bpy.types.Context") -> Any:
        return context.world


classes = (MRPNN_PT_object_light_group, MRPNN_PT_world_light_group)
