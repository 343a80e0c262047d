# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator `mrpnn.check`: what a render would leave out or approximate."""

import bpy

from ..mrpnn_addon.runtime.text import report
from ..mrpnn_addon.status.scene_check import check_scene
from .waiting import WaitsForVolumes


class MRPNN_OT_check(WaitsForVolumes, bpy.types.Operator):
    """Read the scene as a render does, and list everything in it that is left out or approximated"""

    bl_idname = "mrpnn.check"
    bl_label = "Check Scene"

    def invoke(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        if not bpy.app.background and self.wait_for_volumes(context):
            return {"RUNNING_MODAL"}
        return self.execute(context)

    def modal(self, context: "bpy.types.Context", event: "bpy.types.Event") -> set[str]:
        waiting = self.still_waiting(context, event)
        return self.execute(context) if waiting is None else waiting

    def cancel(self, context: "bpy.types.Context") -> None:
        """Called by Blender where it ends the operator itself, as when it closes or loads a file."""
        self.stop_waiting(context)

    def execute(self, context: "bpy.types.Context") -> set[str]:
        check = check_scene(context.evaluated_depsgraph_get(), self.reader)
        if check.error:
            report(self, "ERROR", check.error)
            return {"CANCELLED"}
        for warning in check.warnings:
            report(self, "WARNING", warning)
        if not check.warnings:
            report(self, "INFO", "Everything in the scene is rendered")
        return {"FINISHED"}


classes = (MRPNN_OT_check,)
