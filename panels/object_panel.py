# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes in the object properties."""

import bpy

from ..mrpnn_addon.nodes.material import SURFACES, shows_volume
from ..mrpnn_addon.runtime.text import label
from ..mrpnn_addon.status.scene_check import last_check
from ..mrpnn_addon.volumes.fluid_domain import gas_domain
from .engine_panel import EnginePanel
from .text import draw_text


class MRPNN_PT_object(EnginePanel, bpy.types.Panel):
    bl_label = "MRPNN Volumes"
    bl_context = "object"

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        shown = context.object
        if not super().poll(context) or shown is None:
            return False
        return shows_volume(shown) or (context.scene.render.use_motion_blur and shown.type in SURFACES)

    def draw(self, context: "bpy.types.Context") -> None:
        layout, shown, check = self.layout, context.object, last_check()
        if not shows_volume(shown):
            return
        if check is None:
            said = "Press Check Scene in Render Properties to see what is rendered of this volume"
            draw_text(context, layout, said, "INFO")
            return
        column = layout.column()
        column.active = not check.outdated(context.scene)
        if shown.name_full in check.voxels:
            label(column, f"{' x '.join(map(str, check.voxels[shown.name_full]))} voxels", icon="OUTLINER_DATA_VOLUME")
        for text in (check.error, *check.warnings):
            if f'"{shown.name_full}"' in text:
                draw_text(context, column, text, "INFO")


class MRPNN_PT_object_motion(EnginePanel, bpy.types.Panel):
    bl_label = "Motion Blur"
    bl_context = "object"
    bl_parent_id = "MRPNN_PT_object"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return super().poll(context) and hasattr(context.object, "cycles")

    def draw(self, context: "bpy.types.Context") -> None:
        layout, settings = self.layout, context.object.cycles
        layout.use_property_split = True
        layout.active = context.scene.render.use_motion_blur
        layout.prop(settings, "use_motion_blur", text="Motion Blur")
        column = layout.column()
        column.active = settings.use_motion_blur
        column.prop(settings, "motion_steps", text="Steps")
        data, domain = context.object.data, gas_domain(context.object)
        if context.object.type == "VOLUME":
            for name in ("velocity_grid", "velocity_unit", "velocity_scale"):
                column.prop(data, name)
        elif domain:
            column.prop(domain, "velocity_scale")
        elif context.object.type in SURFACES:
            column.prop(settings, "use_deform_motion", text="Deformation")


classes = (MRPNN_PT_object, MRPNN_PT_object_motion)
