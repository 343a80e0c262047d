# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light, in the render properties, for every engine."""

from typing import Any, NamedTuple

import bpy

from ..mrpnn_addon.baking.baked_scene import light_state
from ..mrpnn_addon.baking.live import is_live, live_status, not_kept
from ..mrpnn_addon.scene.changes import scene_state
from ..mrpnn_addon.status.bake_cost import BAKE
from ..mrpnn_addon.status.calibration import calibration
from ..mrpnn_addon.status.forecast import BakeForecast, forecast_bake
from ..mrpnn_addon.status.lacking import lacking
from ..mrpnn_addon.status.last_render import last_render
from ..mrpnn_addon.status.recommendation import LAYER, Recommendation, recommend, scatters_seldom
from ..mrpnn_addon.status.scene_check import last_check
from ..operators.bake import (
    MRPNN_OT_bake_animation,
    MRPNN_OT_bake_light,
    MRPNN_OT_bake_light_fast,
    MRPNN_OT_bake_light_remove,
)
from .text import draw_text


class _Told(NamedTuple):
    """What the panel tells of a scene: panels are redrawn whenever the pointer moves."""

    recommendation: Recommendation
    expected: BakeForecast | None
    lacking: str
    thin: bool


_known: dict[str, Any] = {}


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
            draw_text(context, layout, _told(context).recommendation.reason, "INFO")
            _draw_forecast(context, layout)
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
            _draw_forecast(context, layout)
        if missing_in_eevee := _told(context).lacking:
            draw_text(context, layout, missing_in_eevee, "INFO")
        if hasattr(scene, "cycles") and scene.cycles.volume_bounces > 0 and scene.render.engine == "CYCLES":
            draw_text(
                context,
                layout,
                "Cycles adds the light twice; set Light Paths > Max Bounces > Volume to 0",
                "ERROR",
            )
        if not live:
            # Beside another button, the default width would truncate it.
            layout.operator(MRPNN_OT_bake_light.bl_idname, text="Bake What Has Changed", icon="FILE_REFRESH")
        row = layout.row(align=True)
        if not live:
            row.operator(MRPNN_OT_bake_light.bl_idname, text="Bake All").everything = True
        row.prop(scene, "mrpnn_live_light", toggle=True)
        layout.operator(MRPNN_OT_bake_animation.bl_idname, icon="RENDER_ANIMATION")
        told = _told(context)
        # Among surfaces in thin fog, plain Cycles is faster at the same error.
        if scene.render.engine == "CYCLES" and (told.recommendation.way == LAYER or not told.thin):
            layout.operator(MRPNN_OT_bake_light_fast.bl_idname, icon="PREVIEW_RANGE")
        layout.operator(MRPNN_OT_bake_light_remove.bl_idname, icon="X")


def _draw_live(context: "bpy.types.Context", layout: "bpy.types.UILayout") -> None:
    status, is_problem = live_status(context.scene)
    if status:
        draw_text(context, layout, status, "ERROR" if is_problem else "INFO")
    for sentence in not_kept():
        draw_text(context, layout, sentence[0].upper() + sentence[1:], "ERROR")


def _draw_forecast(context: "bpy.types.Context", layout: "bpy.types.UILayout") -> None:
    expected = _told(context).expected
    if expected is not None:
        draw_text(context, layout, f"Baking all light takes {expected}", "TIME")


def _told(context: "bpy.types.Context") -> _Told:
    measured = last_render(), last_check(), calibration().rates.get(BAKE)
    key = context.view_layer.name, measured, *scene_state(context.scene)
    if _known.get("key") != key:
        depsgraph, state = context.evaluated_depsgraph_get(), light_state(context.scene)
        expected = forecast_bake(depsgraph, state.directional)
        value = _Told(recommend(depsgraph), expected, lacking(depsgraph), scatters_seldom(depsgraph))
        # Evaluating the scene counts as a change.
        _known.update(key=(*key[:2], *scene_state(context.scene)), value=value)
    return _known["value"]


classes = (MRPNN_PT_baked_light,)
