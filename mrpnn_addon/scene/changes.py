# SPDX-License-Identifier: GPL-3.0-or-later
"""Counts scene changes, so that panels and Live Light work only after one."""

from typing import Any

import bpy

from ..nodes.material import LIGHT_MARK
from ..objects.camera import film_exposure
from ..runtime.text import text_of
from ..settings.properties import scene_settings

_HANDLERS = ("depsgraph_update_post", "frame_change_post", "load_post", "undo_post", "redo_post")
# What a render depends on of a scene's render settings, besides its size.
_RENDER_SETTINGS = (
    "pixel_aspect_x",
    "pixel_aspect_y",
    "use_border",
    "border_min_x",
    "border_min_y",
    "border_max_x",
    "border_max_y",
    "use_crop_to_border",
    "use_motion_blur",
    "motion_blur_shutter",
    "use_multiview",
    "use_simplify",
)
# A view layer's filters of what it shows, and how its collections show their objects.
_FILTERS = "use", "use_volumes", "use_solid", "use_strand", "use_sky"
_COLLECTION = "exclude", "holdout", "indirect_only", "hide_viewport"
_changes = 0
_volume_changes = 0
# Addresses of the objects that view layers showed last, by the names of scene and layer.
_visible: dict[tuple[str, str], frozenset[int]] = {}


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
        scene.frame_subframe,
        film_exposure(scene),
        *(getattr(render, name) for name in _RENDER_SETTINGS),
        *(_layer_state(layer) for layer in scene.view_layers),
    )


def _layer_state(layer: "bpy.types.ViewLayer") -> tuple:
    """Of a view layer, what changes the scene alone when an artist changes it."""
    own, found = [getattr(layer, name) for name in _FILTERS], []
    below = [layer.layer_collection]
    while below:
        collection = below.pop()
        below += collection.children
        found.append(tuple(getattr(collection, name) for name in _COLLECTION))
    return (text_of(layer, "name"), *own, *found)


def _visibility_changed(depsgraph: "bpy.types.Depsgraph") -> bool:
    """Whether a view layer shows other objects than when this was last asked of it."""
    layer = depsgraph.view_layer
    visible = frozenset(
        one.original.as_pointer()
        for one in layer.objects
        if one.visible_get(view_layer=layer) and not _is_baked_light(one)
    )
    key = _layer_key(depsgraph)
    known, _visible[key] = _visible.get(key, visible), visible
    return known != visible


def _layer_key(depsgraph: "bpy.types.Depsgraph") -> tuple[str, str]:
    return text_of(depsgraph.scene, "name"), text_of(depsgraph.view_layer, "name")


@bpy.app.handlers.persistent
def _changed(_scene: "bpy.types.Scene | None" = None, depsgraph: "bpy.types.Depsgraph | None" = None) -> None:
    global _changes, _volume_changes
    updates = None if depsgraph is None else [one for one in depsgraph.updates if not _is_baked_light(one.id)]
    if depsgraph is None:
        # Another file may have objects at the same addresses.
        _visible.clear()
    elif updates is not None:
        # Scene data-blocks change with every selection; `scene_state` includes their relevant properties. An object
        # that is hidden changes nothing else. It takes long to look at ten thousand objects in other updates, too.
        selected = all(isinstance(update.id, bpy.types.Scene) for update in updates)
        shows_others = (selected or _layer_key(depsgraph) not in _visible) and _visibility_changed(depsgraph)
        if selected and not shows_others:
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
