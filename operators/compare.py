"""Operator `mrpnn.compare`: the layer against Cycles on the same view."""

import bpy


class MRPNN_OT_compare(bpy.types.Operator):
    """Render the same view in Cycles and report the layer's error against it"""

    bl_idname = "mrpnn.compare"
    bl_label = "Compare with Cycles"
    bl_options = {"REGISTER"}

    def execute(self, context):
        self.report({"ERROR"}, "The comparison is not implemented yet")
        return {"CANCELLED"}


classes = (MRPNN_OT_compare,)
