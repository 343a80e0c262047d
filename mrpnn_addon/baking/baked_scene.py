# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows baked light in a scene, and removes it without a trace.

Each volume gets a second Volume object beside it, which only shines. The volume itself, its material and its files
stay as they are.
"""

import json
import os
from dataclasses import replace
from typing import Any

import bpy
from bpy.props import BoolProperty, CollectionProperty, PointerProperty, StringProperty

from ...inference.scene import Settings
from ..nodes.material import LIGHT_MARK
from ..scene.reader import SceneDescription
from ..settings.properties import scene_settings
from .bake_job import BakedScene, BakedVolume
from .compiling import draw_again
from .content import light_keys, volume_names
from .light_material import light_material, reuse, set_frame

COLLECTION = "Baked Light"
_ENGINES = ("CYCLES", "BLENDER_EEVEE", "BLENDER_EEVEE_NEXT")


class MRPNN_PG_lit_volume(bpy.types.PropertyGroup):
    """The baked light of one volume. name: of the volume. spare: the material of light with other nodes, since Live
    Light takes turns between coarse and final light, and nodes take long to make.
    """

    shown: PointerProperty(name="Object", type=bpy.types.Object)
    spare: PointerProperty(name="Spare Material", type=bpy.types.Material)
    key: StringProperty(name="Content")


class MRPNN_PG_light(bpy.types.PropertyGroup):
    """A scene's baked light, and what *Remove Baked Light* restores."""

    active: BoolProperty(name="Baked")
    directional: BoolProperty(name="Other Directions", default=True)
    volumes: CollectionProperty(name="Volumes", type=MRPNN_PG_lit_volume)
    collection: PointerProperty(name="Collection", type=bpy.types.Collection)
    engine: StringProperty(name="Render Engine Before")
    cycles: StringProperty(name="Cycles Settings Before", description="In JSON, by name")


def light_state(scene: "bpy.types.Scene") -> MRPNN_PG_light:
    """`scene.mrpnn_light`, which the types of bpy do not have."""
    return scene.path_resolve("mrpnn_light")


def baked_keys(scene: "bpy.types.Scene") -> dict[str, str]:
    """Content keys of what is baked and still there, by volume; without what another scene shows, too."""
    return {name: key for name, key in _keys(scene).items() if _is_own(light_state(scene).volumes[name].shown)}


def _keys(scene: "bpy.types.Scene") -> dict[str, str]:
    """Content keys of what is baked and still there, by volume."""
    return {item.name: item.key for item in light_state(scene).volumes if _is_there(scene, item.shown)}


def _is_own(shown: "bpy.types.Object") -> bool:
    """Whether one scene alone shows an object's light. A copy of a scene shares it, or its data."""
    return len(shown.users_scene) < 2 and shown.data.users < 2


def _is_there(scene: "bpy.types.Scene", shown: "bpy.types.Object | None") -> bool:
    """Whether an object shows baked light: it is in the scene, and so are its material and its file."""
    if shown is None or shown.name not in scene.objects:
        return False
    data: Any = shown.data
    return bool(len(data.materials)) and os.path.exists(bpy.path.abspath(data.filepath))


def bake_settings(scene: "bpy.types.Scene") -> Settings:
    """The scene's settings, with other directions where its light has them."""
    return replace(scene_settings(scene).settings(), directional=light_state(scene).directional)


def stale_light(scene: "bpy.types.Scene", description: SceneDescription) -> list[str]:
    """Sentences about light that is out of date, missing or left over; sequences are not compared."""
    state = light_state(scene)
    if not state.active:
        return []
    settings = bake_settings(scene)
    names, known = volume_names(description), _keys(scene)
    sequences = {item.name for item in state.volumes if not item.key}
    found = [
        f'the baked light of "{name}" is out of date; press Bake What Has Changed'
        for name, key in zip(names, light_keys(description, settings))
        if known.get(name) != key and name not in sequences
    ]
    left = [item.name for item in state.volumes if item.name not in names]
    found += light_of_libraries(scene)
    return found + [f'the baked light of "{name}" is left over; Bake What Has Changed removes it' for name in left]


def light_of_libraries(scene: "bpy.types.Scene") -> list[str]:
    """Sentences about linked objects that add the light of another file to the scene's own."""
    return [
        f'"{shown.name_full}" adds the baked light of another file; unlink it from the scene'
        for shown in _others(scene)
        if shown.library is not None and not shown.hide_render
    ]


def _others(scene: "bpy.types.Scene") -> "list[bpy.types.Object]":
    """Objects of a scene with baked light that is not its own."""
    own = [item.shown for item in light_state(scene).volumes]
    return [shown for shown in scene.objects if shown.get(LIGHT_MARK) is not None and shown not in own]


def show_light(scene: "bpy.types.Scene", baked: BakedScene) -> None:
    """Show one frame's light, instead of what was shown of its volumes before. Without either, nothing changes."""
    state = light_state(scene)
    if not (baked.names or state.active):
        return
    _prepare(scene)
    state.directional = baked.directional
    for one in baked.volumes:
        _show(scene, one)
    gone = [item.name for item in state.volumes if item.name not in baked.names]
    for name in gone:
        number = state.volumes.find(name)
        _remove_spare(state.volumes[number])
        _remove_object(state.volumes[number].shown)
        state.volumes.remove(number)


def show_sequence(scene: "bpy.types.Scene", frames: list[BakedScene]) -> None:
    """Show the light of consecutive frames, baked into one target."""
    first: dict[str, tuple[int, BakedVolume]] = {}
    for frame in frames:
        for one in frame.volumes:
            first.setdefault(one.name, (frame.frame, one))
    _prepare(scene)
    names = [name for frame in frames for name in frame.names]
    show_light(scene, replace(frames[0], volumes=[one for _, one in first.values()], names=names))
    for item in light_state(scene).volumes:
        if item.name not in first:
            continue
        start, data = first[item.name][0], item.shown.data
        baked = [(frame.frame, one) for frame in frames for one in frame.volumes if one.name == item.name]
        data.is_sequence, data.sequence_mode = True, "CLIP"
        # The number in a file's name is its frame.
        data.frame_start, data.frame_offset, data.frame_duration = start, start - 1, baked[-1][0] - start + 1
        for number, one in baked:
            set_frame(data.materials[0], one.scale, one.directional, number)
        # Its key is that of one frame: a sequence is baked again as a whole.
        item.key = ""


def remove_light(scene: "bpy.types.Scene") -> None:
    """Undo `show_light`. The files stay: other copies of the .blend may show them."""
    _part(scene)
    state = light_state(scene)
    for item in state.volumes:
        _remove_spare(item)
        _remove_object(item.shown)
    if state.collection is not None:
        bpy.data.collections.remove(state.collection)
    if state.engine:
        scene.render.engine = state.engine
    for name, value in json.loads(state.cycles or "{}").items():
        # The file may be open in an earlier version of Blender, or in one without Cycles.
        if hasattr(scene, "cycles") and hasattr(scene.cycles, name):
            setattr(scene.cycles, name, value)
    state.volumes.clear()
    for name in ("active", "directional", "collection", "engine", "cycles"):
        state.property_unset(name)


def chooses_ray_marching(scene: "bpy.types.Scene") -> bool:
    """Whether Cycles has two ways through volumes, null scattering and ray marching; Blender 5.0 and later."""
    return hasattr(scene, "cycles") and hasattr(scene.cycles, "volume_biased")


def set_cycles(scene: "bpy.types.Scene", **settings: Any) -> None:
    """Change settings of Cycles until `remove_light`."""
    state = light_state(scene)
    before = json.loads(state.cycles or "{}")
    for name, value in settings.items():
        before.setdefault(name, getattr(scene.cycles, name))
        setattr(scene.cycles, name, value)
    state.cycles = json.dumps(before)


def _part(scene: "bpy.types.Scene") -> None:
    """Leave to other scenes the light that they show. A copy of a scene begins with that of the first."""
    state = light_state(scene)
    others = [other for other in bpy.data.scenes if other != scene]
    for number in reversed(range(len(state.volumes))):
        shown = state.volumes[number].shown
        if shown is not None and any(shown.name in other.objects for other in others):
            state.volumes.remove(number)
    found = state.collection
    if found is not None and any(found in other.collection.children_recursive for other in others):
        if found.name in scene.collection.children:
            scene.collection.children.unlink(found)
        state.collection = None


def _prepare(scene: "bpy.types.Scene") -> None:
    """Settings of the whole scene, whose earlier values are kept."""
    _part(scene)
    state = light_state(scene)
    # Appended objects would shine beside the scene's own light.
    for shown in _others(scene):
        if shown.library is None and len(shown.users_scene) == 1:
            _remove_object(shown)
    if state.collection is None or COLLECTION not in state.collection.name:
        state.collection = bpy.data.collections.new(COLLECTION)
        state.collection[LIGHT_MARK] = COLLECTION
    if state.collection.name not in scene.collection.children:
        scene.collection.children.link(state.collection)
    if not state.active:
        state.active = True
        if scene.render.engine not in _ENGINES:
            render: Any = scene.render
            state.engine, render.engine = render.engine, "CYCLES"
    if hasattr(scene, "cycles"):
        # Multiple scattering is in the light already.
        set_cycles(scene, volume_bounces=0)
    if chooses_ray_marching(scene):
        # Null scattering takes about ten times as long to the same error of light that shines in a volume.
        set_cycles(scene, volume_biased=True)


def _show(scene: "bpy.types.Scene", one: BakedVolume) -> None:
    """Show a volume's light in its object, which Live Light does many times."""
    state = light_state(scene)
    item = state.volumes.get(one.name)
    if item is None:
        item = state.volumes.add()
        item.name = one.name
    if item.shown is None or item.shown.name not in scene.objects or not _is_own(item.shown):
        _remove_object(item.shown)
        item.shown = _light_object(one.name)
        state.collection.objects.link(item.shown)
    data = item.shown.data
    set_file(data, one.path)
    data.is_sequence = False
    _set_material(item, one)
    item.key = one.key


def _set_material(item: MRPNN_PG_lit_volume, one: BakedVolume) -> None:
    """Show light with the material that it has, with the spare one, or with a new one."""
    materials = item.shown.data.materials
    before = materials[0] if len(materials) else None
    if reuse(before, one.scale, one.directional):
        return
    if reuse(item.spare, one.scale, one.directional):
        found = item.spare
    else:
        _remove_spare(item)
        found = light_material(f"{one.name} Light", one.scale, one.directional)
    item.spare = before
    materials.clear()
    materials.append(found)
    draw_again()


def _light_object(name: str) -> "bpy.types.Object":
    """A new Volume object for the light of the volume of that name."""
    data = bpy.data.volumes.new(f"{name} Light")
    shown = bpy.data.objects.new(f"{name} Light", data)
    # The grids are in the world's frame. Nobody should have to click through it to the volume.
    shown.hide_select = True
    shown[LIGHT_MARK] = data[LIGHT_MARK] = name
    return shown


def set_file(data: "bpy.types.Volume", path: str) -> None:
    """Have a Volume load an absolute path, written relative to the .blend file where there is one."""
    data.filepath = bpy.path.relpath(path) if bpy.data.filepath and _near(path) else path


def _near(path: str) -> bool:
    """Whether a path can be written relative to the .blend file."""
    try:
        bpy.path.relpath(path)
    except ValueError:  # Another drive, on Windows.
        return False
    return True


def _remove_spare(item: MRPNN_PG_lit_volume) -> None:
    spare, item.spare = item.spare, None
    _remove_materials([spare])


def _remove_object(shown: "bpy.types.Object") -> None:
    if shown is None:
        return
    data: Any = shown.data
    bpy.data.objects.remove(shown)
    if data is None or data.users:
        return
    materials = list(data.materials)
    bpy.data.volumes.remove(data)
    _remove_materials(materials)


def _remove_materials(materials: "list[bpy.types.Material]") -> None:
    for material in materials:
        if material is not None and not material.users:
            animation = material.node_tree.animation_data
            action = animation.action if animation else None
            bpy.data.materials.remove(material)
            if action is not None and not action.users:
                bpy.data.actions.remove(action)


def register() -> None:
    bpy.utils.register_class(MRPNN_PG_lit_volume)
    bpy.utils.register_class(MRPNN_PG_light)
    scene: Any = bpy.types.Scene
    scene.mrpnn_light = PointerProperty(type=MRPNN_PG_light)


def unregister() -> None:
    scene: Any = bpy.types.Scene
    del scene.mrpnn_light
    bpy.utils.unregister_class(MRPNN_PG_light)
    bpy.utils.unregister_class(MRPNN_PG_lit_volume)
