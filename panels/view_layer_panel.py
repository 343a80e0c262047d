# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes in the view layer properties."""

import bpy

from ..mrpnn_addon.settings.view_layer import pass_settings
from ..operators.relight import MRPNN_OT_relight
from .engine_panel import EnginePanel


class MRPNN_PT_passes(EnginePanel, bpy.types.Panel):
    bl_label = "Data"
    bl_context = "view_layer"
    bl_parent_id = "VIEWLAYER_PT_layer_passes"

    def draw(self, context: "bpy.types.Context") -> None:
        layout, view_layer = self.layout, context.view_layer
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column(heading="Include", align=True)
        column.prop(view_layer, "use_pass_z", text="Depth")
        column.prop(pass_settings(view_layer), "use_pass_median_depth")
        column.prop(view_layer, "use_pass_position")
        column = layout.column(heading="Volume", align=True)
        column.prop(pass_settings(view_layer), "use_pass_volume_direct", text="Direct")
        column.prop(pass_settings(view_layer), "use_pass_volume_indirect", text="Indirect")
        column.prop(pass_settings(view_layer), "use_pass_emission")
        column.prop(view_layer, "use_pass_shadow")
        column.prop(pass_settings(view_layer), "use_pass_uncertainty")
        column = layout.column(heading="Lights", align=True)
        column.prop(pass_settings(view_layer), "use_pass_lights")
        column.operator(MRPNN_OT_relight.bl_idname, icon="NODE_COMPOSITING")


classes = (MRPNN_PT_passes,)
