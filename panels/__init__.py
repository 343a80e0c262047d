"""The extension's panels."""

import bpy

from . import render_panel


def register():
    for panel in render_panel.classes:
        bpy.utils.register_class(panel)


def unregister():
    for panel in reversed(render_panel.classes):
        bpy.utils.unregister_class(panel)
