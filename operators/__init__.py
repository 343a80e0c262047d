"""Everything the extension adds to Blender besides panels."""

import bpy

from ..mrpnn_addon.engine import engine
from ..mrpnn_addon.output import composite as composited_scenes
from ..mrpnn_addon.output import passes
from ..mrpnn_addon.scene import changes
from ..mrpnn_addon.settings import properties
from ..mrpnn_addon.status import experience, file_watch
from . import check, command, compare, composite, documentation, render

CLASSES = (*render.classes, *check.classes, *compare.classes, *composite.classes, *documentation.classes)


def register():
    properties.register()
    passes.register()
    changes.register()
    file_watch.register()
    engine.register()
    composited_scenes.register()
    experience.register()
    for operator in CLASSES:
        bpy.utils.register_class(operator)
    command.register()


def unregister():
    command.unregister()
    for operator in reversed(CLASSES):
        bpy.utils.unregister_class(operator)
    experience.unregister()
    composited_scenes.unregister()
    engine.unregister()
    file_watch.unregister()
    changes.unregister()
    passes.unregister()
    properties.unregister()
