"""Everything the extension adds to Blender besides panels."""

import bpy

from ..mrpnn_addon import composite as composited_scenes
from ..mrpnn_addon import engine, experience, file_watch, passes, properties, scene_watch
from . import check, command, compare, composite, documentation, render

CLASSES = (*render.classes, *check.classes, *compare.classes, *composite.classes, *documentation.classes)


def register():
    properties.register()
    passes.register()
    scene_watch.register()
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
    scene_watch.unregister()
    passes.unregister()
    properties.unregister()
