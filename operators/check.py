"""Operator `mrpnn.check`: what a render would leave out or approximate, before rendering."""

import bpy

from ..mrpnn_addon.scene_check import check_scene


class MRPNN_OT_check(bpy.types.Operator):
    """Read the scene as a render would, and list everything that it would ignore or approximate"""

    bl_idname = "mrpnn.check"
    bl_label = "Check Scene"

    def execute(self, context):
        check = check_scene(context.evaluated_depsgraph_get())
        if check.error:
            self.report({'ERROR'}, check.error)
            return {'CANCELLED'}
        for warning in check.warnings:
            self.report({'WARNING'}, warning)
        if not check.warnings:
            self.report({'INFO'}, "Everything in the scene is rendered")
        return {'FINISHED'}


classes = (MRPNN_OT_check,)
