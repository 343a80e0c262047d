"""Which objects a render or a viewport shows, instances included."""

from dataclasses import dataclass
from typing import Iterator, List, Optional

import numpy as np

from ...inference.scene import SceneError
from ..nodes.material import shows_volume


@dataclass
class Shown:
    """One visible object or instance.

    object: the evaluated object; valid only until the next one is asked for.
    matrix: float64 (4, 4), object to world.
    name: for messages.
    source: the original object in the scene that is it, or instances it.
    """

    # Quoted: held by `typing` or a dataclass, Blender's types outlive
    # Blender, and the bpy module hangs when the process ends.
    object: "bpy.types.Object"
    matrix: np.ndarray
    name: str
    source: "bpy.types.Object"


def shown_objects(depsgraph, space=None) -> Iterator[Shown]:
    """All objects and instances of the depsgraph's view layer that renders show, or that a viewport shows.

    space: the viewport's SpaceView3D, or None for renders. As in Cycles, a viewport goes by what is hidden in it: by
    the eye, local view, collections and its own filter of object types, but not by what is hidden in renders.
    """
    in_render = None if space or depsgraph.mode == 'RENDER' else render_visible(depsgraph.view_layer)
    for instance in depsgraph.object_instances:
        instanced = instance.object
        # Instances carry the visibility of what makes them.
        if space is not None and not instanced.visible_in_viewport_get(space):
            continue
        # An instance is there because the object that makes it is.
        source = instance.parent if instance.is_instance else instanced
        name = source.original.name
        if instance.is_instance and instanced.name != name:
            name = f"{instanced.name} in {name}"
        if in_render is not None:
            # Geometry nodes and particles show objects that are hidden themselves.
            from_nodes = instance.is_instance and source.instance_type == 'NONE'
            if source.original not in in_render or instanced.original.hide_render and not from_nodes:
                continue
        if instance.show_self and not _used_up(instanced):
            yield Shown(instanced, np.array(instance.matrix_world, dtype=np.float64), name, source.original)


def _used_up(shown_object) -> bool:
    """Whether geometry nodes have left nothing of a mesh: what else they make is shown as objects of their own."""
    return shown_object.type == 'MESH' and not shown_object.data.polygons and any(
        modifier.type == 'NODES' for modifier in shown_object.modifiers)


def visibility_state(depsgraph, space) -> tuple:
    """What differs where a viewport comes to show other objects, or shows them otherwise, although none has changed.

    Blender tells engines of hiding, local view and collections as it does of selecting: the scene has changed.
    """
    view_layer = depsgraph.view_layer
    return view_layer.name, frozenset(
        (shown.name_full, shown.original.holdout_get(view_layer=view_layer),
         shown.original.indirect_only_get(view_layer=view_layer))
        for shown in depsgraph.objects if shown.visible_in_viewport_get(space))


def why_unseen(shown: Shown, view_layer) -> str:
    """Why the camera does not see a volume that is in the scene, or ""."""
    if shown.source.holdout_get(view_layer=view_layer):
        return "is a holdout"
    if shown.source.indirect_only_get(view_layer=view_layer):
        return "is in a collection that gives indirect light only"
    return "" if shown.object.visible_camera else "is hidden from the camera"


def ignored_visibility(shown: Shown) -> List[str]:
    """Switches of Cycles' ray visibility, set for a volume, that change nothing here."""
    rays = (("shadow", shown.object.visible_shadow), ("volume scatter", shown.object.visible_volume_scatter))
    return [f"is hidden from {name} rays, which is not respected" for name, visible in rays if not visible]


def render_visible(view_layer) -> set:
    """The view layer's objects that neither they nor their collections hide in renders."""
    return {
        member
        for layer_collection in _rendered_collections(view_layer.layer_collection)
        for member in layer_collection.collection.objects
        if not member.hide_render
    }


def _rendered_collections(layer_collection):
    if layer_collection.exclude or layer_collection.collection.hide_render:
        return
    yield layer_collection
    for child in layer_collection.children:
        yield from _rendered_collections(child)


def evaluated_world(depsgraph):
    """The World of an evaluated scene as its animation has it in this frame, or None.

    The evaluated scene itself names the original World, which F12 leaves as it was before.
    """
    world = depsgraph.scene.world
    return None if world is None else world.evaluated_get(depsgraph)


def require_evaluated(depsgraph) -> None:
    """Outside a render, Blender evaluates only what the viewport shows.

    Raises SceneError where a volume or a sun is hidden there and yet visible in renders: it could
    only be left out of the image.
    """
    if depsgraph.mode == 'RENDER':
        return
    for candidate in render_visible(depsgraph.view_layer):
        kind = _rendered_kind(candidate)
        if kind and not candidate.visible_get(view_layer=depsgraph.view_layer):
            raise SceneError(
                f"{kind} \"{candidate.name}\" is hidden in the viewport but not in renders; show it, "
                "or hide it in renders too"
            )


def _rendered_kind(candidate) -> Optional[str]:
    if shows_volume(candidate):
        return "volume"
    if candidate.type == 'LIGHT' and candidate.data.type == 'SUN':
        return "sun"
    return None
