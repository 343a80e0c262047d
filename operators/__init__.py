"""Everything the extension adds to Blender besides panels."""

import bpy

from ..mrpnn_addon import engine, properties
from . import command, compare, render

CLASSES = (*render.classes, *compare.classes)


def register():
    properties.register()
    engine.register()
    for operator in CLASSES:
        bpy.utils.register_class(operator)
    command.register()


def unregister():
    command.unregister()
    for operator in reversed(CLASSES):
        bpy.utils.unregister_class(operator)
    engine.unregister()
    properties.unregister()
