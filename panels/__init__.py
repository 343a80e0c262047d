"""The extension's panels."""

import bpy

from . import composite_panel, object_panel, preferences_panel, render_panel, view_layer_panel

CLASSES = (*preferences_panel.classes, *render_panel.classes, *composite_panel.classes, *view_layer_panel.classes,
           *object_panel.classes)


def register():
    for panel in CLASSES:
        bpy.utils.register_class(panel)


def unregister():
    for panel in reversed(CLASSES):
        bpy.utils.unregister_class(panel)
