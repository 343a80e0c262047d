"""The extension's panels."""

import bpy

from . import composite_panel, object_panel, preferences_panel, render_panel, view_layer_panel

# Panels are drawn in the order of their registration, the parent first.
_parent, *_children = render_panel.classes
CLASSES = (*preferences_panel.classes, _parent, *composite_panel.classes, *_children, *view_layer_panel.classes,
           *object_panel.classes)


def register():
    for panel in CLASSES:
        bpy.utils.register_class(panel)


def unregister():
    for panel in reversed(CLASSES):
        bpy.utils.unregister_class(panel)
