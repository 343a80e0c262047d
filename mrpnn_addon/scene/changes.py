"""Counts changes of the scene, so that what is computed for a panel is computed once a change."""

import bpy

_HANDLERS = ("depsgraph_update_post", "frame_change_post", "load_post", "undo_post", "redo_post")
_changes = 0


def scene_state(scene) -> tuple:
    """What differs when a render of the scene may differ. Selecting something changes nothing here."""
    render = scene.render
    return (
        _changes, scene.name, scene.frame_current, scene.camera and scene.camera.name, scene.mrpnn.settings(),
        render.resolution_x, render.resolution_y, render.resolution_percentage, render.use_border,
        render.border_min_x, render.border_min_y, render.border_max_x, render.border_max_y,
    )


@bpy.app.handlers.persistent
def _changed(_scene=None, depsgraph=None):
    # The scene itself also changes with every selection; `scene_state` looks at what matters of it.
    if depsgraph is not None and all(isinstance(update.id, bpy.types.Scene) for update in depsgraph.updates):
        return
    global _changes
    _changes += 1


def register():
    for name in _HANDLERS:
        getattr(bpy.app.handlers, name).append(_changed)


def unregister():
    for name in _HANDLERS:
        getattr(bpy.app.handlers, name).remove(_changed)
