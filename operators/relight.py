# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator `mrpnn.relight`: sliders in the compositor for the lights of the volumes."""

import bpy

from ..mrpnn_addon.output.composite import composite_state, volume_scene
from ..mrpnn_addon.output.passes import light_names
from ..mrpnn_addon.output.relight_nodes import relight
from ..mrpnn_addon.runtime.text import report
from ..mrpnn_addon.settings.view_layer import pass_settings


class MRPNN_OT_relight(bpy.types.Operator):
    """Make a node group in the compositor whose sliders change the color and the strength of each light of the volumes
    after rendering. Light groups count as one light; without any, every light gets a pass"""

    bl_idname = "mrpnn.relight"
    bl_label = "Relight in Compositor"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: "bpy.types.Context") -> set[str]:
        scene = context.scene
        shown = composite_state(scene).surfaces or scene
        source = volume_scene(shown) or scene
        if source.render.engine != "MRPNN":
            report(self, "ERROR", "choose the render engine MRPNN Volumes, or Composite over Cycles, first")
            return {"CANCELLED"}
        layer = source.view_layers[0] if source != scene else context.view_layer
        if source != shown:
            for group in shown.view_layers[0].lightgroups:
                if group.name not in layer.lightgroups:
                    layer.lightgroups.add(name=group.name)
        if not len(layer.lightgroups):
            pass_settings(layer).use_pass_lights = True
        names = light_names(source, layer)
        if not names:
            report(self, "ERROR", "the scene has no light; add one with Add > Light")
            return {"CANCELLED"}
        layer.update_render_passes()
        shown.render.use_compositing = True
        relight(shown, source, names)
        report(self, "INFO", f"render, then change {len(names)} light(s) in the node Lights of the Volumes")
        return {"FINISHED"}


classes = (MRPNN_OT_relight,)
