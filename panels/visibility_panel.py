# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' ray visibility settings that affect volumes."""

import bpy

from ..mrpnn_addon.nodes.material import SURFACES, shows_volume
from .engine_panel import EnginePanel


class MRPNN_PT_visibility(EnginePanel, bpy.types.Panel):
    bl_label = "Ray Visibility"
    bl_context = "object"
    bl_parent_id = "OBJECT_PT_visibility"

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return super().poll(context) and bool(_rays(context.object))

    def draw(self, context: "bpy.types.Context") -> None:
        layout = self.layout
        layout.use_property_split = True
        for ray in _rays(context.object):
            layout.prop(context.object, f"visible_{ray}", text=ray.replace("_", " ").title())


def _rays(shown: "bpy.types.Object") -> tuple[str, ...]:
    """Ray types whose setting has an effect for an object."""
    if shown is None:
        return ()
    # What instances objects may instance surfaces and lights.
    if shown.type in SURFACES and not shows_volume(shown) or shown.is_instancer:
        return "camera", "volume_scatter", "shadow"
    if shows_volume(shown):
        return ("camera",)
    return ("volume_scatter",) if shown.type == "LIGHT" else ()


classes = (MRPNN_PT_visibility,)
