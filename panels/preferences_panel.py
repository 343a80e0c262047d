# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's preferences."""

import bpy

from ..mrpnn_addon.runtime.onnxruntime_version import (
    check_runtime,
    missing_provider,
    runtime_problem,
    runtime_version,
)
from ..mrpnn_addon.runtime.text import label
from ..mrpnn_addon.settings.preferences import EXTENSION, PreferenceProperties
from ..operators.documentation import MRPNN_OT_documentation
from .text import draw_text


class MRPNN_preferences(PreferenceProperties, bpy.types.AddonPreferences):
    bl_idname = EXTENSION

    def draw(self, context: "bpy.types.Context") -> None:
        layout = self.layout
        column = layout.column()
        column.use_property_split = True
        column.prop(self, "threads")
        column.prop(self, "memory_limit")
        column.prop(self, "model")
        column.prop(self, "provider")
        if problem := runtime_problem():
            label(layout, "The networks run without onnxruntime; renders look the same", icon="CHECKMARK")
            draw_text(context, layout, problem, "INFO")
        else:
            label(layout, f"onnxruntime {runtime_version()}", icon="CHECKMARK")
        for warning in check_runtime() + missing_provider(self.provider):
            draw_text(context, layout, warning, "ERROR")
        layout.operator(MRPNN_OT_documentation.bl_idname, icon="HELP")


classes = (MRPNN_preferences,)
