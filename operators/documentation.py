# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator `mrpnn.documentation`: open the documentation that the extension ships."""

from pathlib import Path

import bpy

# The shipped pages match the extension's version.
PAGES = Path(__file__).resolve().parent.parent / "docs"


class MRPNN_OT_documentation(bpy.types.Operator):
    """Open the folder with the documentation of this version"""

    bl_idname = "mrpnn.documentation"
    bl_label = "Documentation"

    def execute(self, context: "bpy.types.Context") -> set[str]:
        bpy.ops.wm.path_open(filepath=str(PAGES))
        return {"FINISHED"}


classes = (MRPNN_OT_documentation,)
