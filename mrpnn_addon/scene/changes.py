# SPDX-License-Identifier: GPL-3.0-or-later
"""Counts scene changes, so that panels recompute only after one."""

import bpy

from ..runtime.text import text_of
from ..settings.properties import scene_settings

_HANDLERS = ("depsgraph_update_post", "frame_change_post", "load_post", "undo_post", "redo_post")
_changes = 0


def scene_state(scene: "bpy.types.Scene") -> tuple:
    """A value that differs where a render of the scene may differ. Selection does not change it."""
    render = scene.render
    return (
        _changes,
        text_of(scene, "name"),
        scene.frame_current,
        scene.camera and text_of(scene.camera, "name"),
        scene_settings(scene).settings(),
        scene.world and text_of(scene.world, "name_full"),
        render.resolution_x,
        render.resolution_y,
        render.resolution_percentage,
        render.use_border,
        render.border_min_x,
        render.border_min_y,
        render.border_max_x,
        render.border_max_y,
    )


@bpy.app.handlers.persistent
def _changed(_scene: "bpy.types.Scene | None" = None, depsgraph: "bpy.types.Depsgraph | None" = None) -> None:
    # Scene data-blocks change with every selection; `scene_state` includes their relevant properties.
    if depsgraph is not None and all(isinstance(update.id, bpy.types.Scene) for update in depsgraph.updates):
        return
    global _changes
    _changes += 1


def register() -> None:
    for name in _HANDLERS:
        getattr(bpy.app.handlers, name).append(_changed)


def unregister() -> None:
    for name in _HANDLERS:
        getattr(bpy.app.handlers, name).remove(_changed)
