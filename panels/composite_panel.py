# SPDX-License-Identifier: GPL-3.0-or-later
"""Composited scenes and the scenes of their volumes, in the render properties."""

from typing import Any

import bpy

from ..mrpnn_addon.output.composite import composite_state, out_of_date, volume_scene
from ..operators.composite import MRPNN_OT_composite, MRPNN_OT_composite_remove, MRPNN_OT_show_scene
from ..operators.relight import MRPNN_OT_relight
from .text import draw_text


class MRPNN_PT_composite(bpy.types.Panel):
    bl_label = "Composite over Cycles"
    bl_parent_id = "MRPNN_PT_render"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        composite = composite_state(context.scene)
        return composite.active or composite.surfaces is not None

    def draw(self, context: "bpy.types.Context") -> None:
        layout, composite = self.layout, composite_state(context.scene)
        if composite.active:
            _draw_composited(context, layout, composite)
        else:
            draw_text(
                context,
                layout,
                f'Renders the volumes of scene "{composite.surfaces.name}", whose settings '
                "it copies; change them there",
                "INFO",
            )
            _show(layout, composite.surfaces)
        layout.operator(MRPNN_OT_composite_remove.bl_idname, icon="X")


def _draw_composited(context: "bpy.types.Context", layout: "bpy.types.UILayout", composite: Any) -> None:
    scene, volumes = context.scene, volume_scene(context.scene)
    problems = out_of_date(scene)
    if problems:
        for problem in problems:
            draw_text(context, layout, problem, "ERROR")
        layout.operator(
            MRPNN_OT_composite.bl_idname, text="Update Composite", icon="FILE_REFRESH"
        ).shadows = composite.shadows
    else:
        draw_text(
            context,
            layout,
            f'F12 lays the volumes, rendered in scene "{volumes.name}", over what Cycles renders',
            "CHECKMARK",
        )
    layout.prop(composite, "shadows")
    layout.operator(MRPNN_OT_relight.bl_idname, icon="NODE_COMPOSITING")
    if volumes is not None:
        _show(layout, volumes)


def _show(layout: "bpy.types.UILayout", scene: "bpy.types.Scene") -> None:
    layout.operator(MRPNN_OT_show_scene.bl_idname, text=f'Go to "{scene.name}"', icon="SCENE_DATA").scene = scene.name


classes = (MRPNN_PT_composite,)
