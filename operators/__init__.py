# SPDX-License-Identifier: GPL-3.0-or-later
"""Registration of everything but the panels."""

import bpy

from ..mrpnn_addon.baking import baked_scene, compiling, live
from ..mrpnn_addon.engine import engine
from ..mrpnn_addon.output import composite as composite_scene
from ..mrpnn_addon.runtime import redraw, shutdown
from ..mrpnn_addon.scene import changes
from ..mrpnn_addon.settings import flipbook as flipbook_settings
from ..mrpnn_addon.settings import properties, view_layer
from ..mrpnn_addon.status import calibration, file_watch
from . import bake, check, command, compare, composite, documentation, flipbook, relight, render

# Registered in this order and removed in the opposite one: settings first, the command line last. `shutdown` ends all
# threads before anything is removed that they might use.
MODULES = (
    properties,
    view_layer,
    flipbook_settings,
    changes,
    file_watch,
    engine,
    composite_scene,
    baked_scene,
    compiling,
    live,
    calibration,
    redraw,
    shutdown,
)
CLASSES = (
    *render.classes,
    *check.classes,
    *compare.classes,
    *composite.classes,
    *bake.classes,
    *flipbook.classes,
    *documentation.classes,
    *relight.classes,
)


def register() -> None:
    for module in MODULES:
        module.register()
    for operator in CLASSES:
        bpy.utils.register_class(operator)
    command.register()


def unregister() -> None:
    command.unregister()
    for operator in reversed(CLASSES):
        bpy.utils.unregister_class(operator)
    for module in reversed(MODULES):
        module.unregister()
