# SPDX-License-Identifier: GPL-3.0-or-later
"""Counts scene changes, so that panels and Live Light work only after one."""

from typing import Any

import bpy

from ..nodes.material import LIGHT_MARK
from ..runtime.text import text_of
from ..settings.properties import scene_settings

_HANDLERS = ("depsgraph_update_post", "frame_change_post", "load_post", "undo_post", "redo_post")
_changes = 0
_volume_changes = 0


def volume_changes() -> int:
    """A number that grows where a `VolumeReader` may be out of date: volumes, meshes or materials have changed."""
    return _volume_changes


def keeps_volumes(update: "bpy.types.DepsgraphUpdate") -> bool:
    """Whether a change cannot affect a volume's voxels, only its transform or lighting."""
    if isinstance(update.id, (bpy.types.Scene, bpy.types.World, bpy.types.Light, bpy.types.Camera)):
        return True
    if not isinstance(update.id, bpy.types.Object):
        return False
    return update.id.type in ("LIGHT", "CAMERA") or not (update.is_updated_geometry or update.is_updated_shading)


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
    global _changes, _volume_changes
    updates = None if depsgraph is None else [one for one in depsgraph.updates if not _is_baked_light(one.id)]
    # Scene data-blocks change with every selection; `scene_state` includes their relevant properties.
    if updates is not None and all(isinstance(update.id, bpy.types.Scene) for update in updates):
        return
    _changes += 1
    if updates is None or not all(map(keeps_volumes, updates)):
        _volume_changes += 1


def _is_baked_light(changed: Any) -> bool:
    """Whether it shows baked light, which no render of volumes depends on."""
    return changed.get(LIGHT_MARK) is not None


def register() -> None:
    for name in _HANDLERS:
        getattr(bpy.app.handlers, name).append(_changed)


def unregister() -> None:
    for name in _HANDLERS:
        getattr(bpy.app.handlers, name).remove(_changed)
