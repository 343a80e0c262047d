# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's panels."""

import bpy

from . import (
    camera_panel,
    composite_panel,
    flipbook_panel,
    light_bake_panel,
    light_group_panel,
    light_panel,
    material_panel,
    object_panel,
    preferences_panel,
    render_panel,
    view_layer_panel,
    visibility_panel,
    world_panel,
)
from .text import tells_names

# Blender draws panels in the order of their registration, parents first.
# What to know before rendering stands right below the buttons.
_parent, _forecast, _plan, *_children = render_panel.classes
MODULES = (
    view_layer_panel,
    object_panel,
    visibility_panel,
    material_panel,
    light_panel,
    camera_panel,
    world_panel,
    light_group_panel,
)
CLASSES = (
    *preferences_panel.classes,
    _parent,
    _forecast,
    _plan,
    *composite_panel.classes,
    *light_bake_panel.classes,
    *flipbook_panel.classes,
    *_children,
    *(panel for module in MODULES for panel in module.classes),
)
for _panel in CLASSES:
    _panel.draw = tells_names(_panel.draw)


def register() -> None:
    for panel in CLASSES:
        bpy.utils.register_class(panel)


def unregister() -> None:
    for panel in reversed(CLASSES):
        bpy.utils.unregister_class(panel)
