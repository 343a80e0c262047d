# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light, in the render properties, for every engine."""

import bpy

from ..mrpnn_addon.baking.baked_scene import light_state
from ..mrpnn_addon.baking.live import is_live, live_status, not_kept
from ..mrpnn_addon.scene.changes import scene_state
from ..mrpnn_addon.status.recommendation import Recommendation, recommend
from ..operators.bake import (
    MRPNN_OT_bake_animation,
    MRPNN_OT_bake_light,
    MRPNN_OT_bake_light_fast,
    MRPNN_OT_bake_light_remove,
)
from .text import draw_text

_recommended: dict = {}


class MRPNN_PT_baked_light(bpy.types.Panel):
    bl_label = "Light for Cycles and EEVEE"
    bl_parent_id = "MRPNN_PT_render"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    def draw(self, context: "bpy.types.Context") -> None:
        layout, scene = self.layout, context.scene
        state = light_state(scene)
        if not state.active:
            draw_text(context, layout, _recommendation(context).reason, "INFO")
            row = layout.row(align=True)
            row.operator(MRPNN_OT_bake_light.bl_idname, icon="OUTLINER_OB_LIGHT")
            row.prop(scene, "mrpnn_live_light", toggle=True)
            layout.operator(MRPNN_OT_bake_animation.bl_idname, icon="RENDER_ANIMATION")
            _draw_live(context, layout)
            return
        missing = [item.name for item in state.volumes if item.shown is None or item.shown.name not in scene.objects]
        for name in missing:
            draw_text(context, layout, f'The light of "{name}" was deleted', "ERROR")
        live = is_live(scene)
        _draw_live(context, layout)
        if not missing and not live:
            count = len(state.volumes)
            draw_text(context, layout, f"The light of {count} volume{'s' * (count != 1)} is baked", "CHECKMARK")
        if hasattr(scene, "cycles") and scene.cycles.volume_bounces > 0 and scene.render.engine == "CYCLES":
            draw_text(context, layout, "With volume bounces, Cycles adds the light twice; set them to 0", "ERROR")
        if not live:
            # Beside another button, the default width would truncate it.
            layout.operator(MRPNN_OT_bake_light.bl_idname, text="Bake What Has Changed", icon="FILE_REFRESH")
        row = layout.row(align=True)
        if not live:
            row.operator(MRPNN_OT_bake_light.bl_idname, text="Bake All").everything = True
        row.prop(scene, "mrpnn_live_light", toggle=True)
        layout.operator(MRPNN_OT_bake_animation.bl_idname, icon="RENDER_ANIMATION")
        if scene.render.engine == "CYCLES":
            layout.operator(MRPNN_OT_bake_light_fast.bl_idname, icon="PREVIEW_RANGE")
        layout.operator(MRPNN_OT_bake_light_remove.bl_idname, icon="X")


def _draw_live(context: "bpy.types.Context", layout: "bpy.types.UILayout") -> None:
    status, is_problem = live_status(context.scene)
    if status:
        draw_text(context, layout, status, "ERROR" if is_problem else "INFO")
    for sentence in not_kept():
        draw_text(context, layout, sentence[0].upper() + sentence[1:], "ERROR")


def _recommendation(context: "bpy.types.Context") -> Recommendation:
    key = context.view_layer.name, *scene_state(context.scene)
    if _recommended.get("key") != key:
        value = recommend(context.evaluated_depsgraph_get())
        # Evaluating the scene counts as a change.
        _recommended.update(key=(key[0], *scene_state(context.scene)), value=value)
    return _recommended["value"]


classes = (MRPNN_PT_baked_light,)
