"""Forgets what was said of a file once another one is loaded."""

import bpy

from . import last_comparison, last_render, scene_check


@bpy.app.handlers.persistent
def _loaded(_file):
    for said in (last_render, last_comparison, scene_check):
        said.forget()


def register():
    bpy.app.handlers.load_post.append(_loaded)


def unregister():
    bpy.app.handlers.load_post.remove(_loaded)
