# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects and instances that a render or a viewport shows."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...inference.scene import SceneError
from ..nodes.material import SURFACES, shows_volume

#: How a message ends that names an object which is not rendered.
LEFT_OUT = " (left out)"
# Blender lists objects of these types and, as one more instance, the mesh that renders show of them. None for texts
# without letters, for all but the first member of a metaball family, and for texts that particles instance.
CONVERTED = {"CURVE", "SURFACE", "META", "FONT"}


@dataclass
class VisibleObject:
    """One visible object or instance.

    object: the evaluated object; valid only until the iterator advances.
    matrix: float64 (4, 4), object to world.
    name: for messages. Other objects have other names: one of a library is named with it, as in Blender's interface.
    source: the original object, or the one that instances it.
    host: evaluated, what instances it, such as an Empty, or the object itself; valid as long as `object`.
    key: equal for the same object or instance at other times.
    """

    # Quoted: references to Blender's types that `typing` or a dataclass holds outlive Blender, and the bpy module then
    # hangs when the process ends.
    object: "bpy.types.Object"
    matrix: np.ndarray
    name: str
    source: "bpy.types.Object"
    host: "bpy.types.Object"
    key: tuple = ()

    def visible_to(self, rays: str) -> bool:
        """Whether rays of a kind meet it, such as "camera", "shadow", "diffuse" or "volume_scatter".

        As in Cycles, an instance is hidden from them by its own *Ray Visibility* or by that of what instances it.
        """
        return all(getattr(one, f"visible_{rays}") for one in (self.object, self.host))

    @property
    def data(self) -> Any:
        """The object's evaluated data, whose properties depend on the type of the object."""
        return self.object.data


def visible_objects(
    depsgraph: "bpy.types.Depsgraph", space: "bpy.types.SpaceView3D | None" = None
) -> Iterator[VisibleObject]:
    """All objects and instances of the view layer that renders, or a viewport, show.

    space: the viewport's SpaceView3D; None for renders. As in Cycles, a viewport respects the visibility set for it
    (eye icon, local view, collections, its filter of object types) and not the visibility in renders. Both respect the
    view layer's filter. Texts, curves, surfaces and metaballs come once, as the mesh that Cycles renders.
    """
    in_render = None if space or depsgraph.mode == "RENDER" else render_visible(depsgraph.view_layer)
    for instance in depsgraph.object_instances:
        instanced = instance.object
        if instanced.type in CONVERTED:
            continue
        # Instances have the visibility of their instancer.
        if space is not None and not instanced.visible_in_viewport_get(space):
            continue
        # An instance exists because of its instancer.
        source = instance.parent if instance.is_instance else instanced
        name, own = source.original.name_full, instanced.original.name_full
        if instance.is_instance and own != name:
            name = f"{own} in {name}"
        if in_render is not None:
            # Geometry nodes and particles show instances of objects that are themselves hidden.
            from_nodes = instance.is_instance and source.instance_type == "NONE"
            if source.original not in in_render or instanced.original.hide_render and not from_nodes:
                continue
            # Renders show the instances only.
            holder = None if instance.is_instance else instanced.parent
            if holder is not None and holder.instance_type in ("VERTS", "FACES"):
                continue
        if instance.show_self and not _is_filtered_out(instanced, depsgraph.view_layer) and not _is_replaced(instanced):
            matrix = np.array(instance.matrix_world, dtype=np.float64)
            key = instanced.name_full, source.name_full, tuple(instance.persistent_id) if instance.is_instance else ()
            yield VisibleObject(instanced, matrix, name, source.original, source, key)


def _is_filtered_out(shown_object: "bpy.types.Object", view_layer: "bpy.types.ViewLayer") -> bool:
    """Whether *Filter* in the view layer's properties hides an object, as in Cycles."""
    if shown_object.type == "VOLUME":
        return not view_layer.use_volumes
    if shown_object.type == "CURVES":
        return not view_layer.use_strand
    return shown_object.type in SURFACES and not view_layer.use_solid


def _is_replaced(shown_object: "bpy.types.Object") -> bool:
    """Whether geometry nodes leave nothing of a mesh; their instances are objects of their own."""
    data: Any = shown_object.data
    return (
        shown_object.type == "MESH"
        and not data.polygons
        and any(modifier.type == "NODES" for modifier in shown_object.modifiers)
    )


def visibility_state(depsgraph: "bpy.types.Depsgraph", space: "bpy.types.SpaceView3D | None") -> tuple:
    """A value that changes when a viewport shows other objects, or shows them differently, although no object has
    changed.

    Blender notifies engines of hiding, local view and collections as of selection: the scene has changed.
    """
    view_layer = depsgraph.view_layer
    filters = view_layer.use_volumes, view_layer.use_solid, view_layer.use_strand, view_layer.use_sky
    return (
        view_layer.name,
        filters,
        frozenset(
            (
                shown.name_full,
                shown.original.indirect_only_get(view_layer=view_layer),
                shown.original.holdout_get(view_layer=view_layer),
            )
            for shown in depsgraph.objects
            if shown.visible_in_viewport_get(space)
        ),
    )


def is_holdout(shown: VisibleObject, view_layer: "bpy.types.ViewLayer") -> bool:
    """Whether an object, or its collection in the view layer, is a holdout."""
    return shown.object.is_holdout or shown.host.is_holdout or shown.source.holdout_get(view_layer=view_layer)


def hidden_from_camera(shown: VisibleObject, view_layer: "bpy.types.ViewLayer") -> str:
    """The reason why the camera does not see a volume of the scene; "" where it does."""
    if shown.source.indirect_only_get(view_layer=view_layer):
        return "is in an indirect-only collection"
    if shown.object.is_shadow_catcher or shown.host.is_shadow_catcher:
        return "is a shadow catcher"
    return "" if shown.visible_to("camera") else "is hidden from the camera"


def ignored_visibility(shown: VisibleObject) -> list[str]:
    """Ray visibility settings of a volume that have no effect here."""
    return [
        f"is hidden from {rays.replace('_', ' ')} rays, which has no effect"
        for rays in ("shadow", "volume_scatter")
        if not shown.visible_to(rays)
    ]


def render_visible(view_layer: "bpy.types.ViewLayer") -> set:
    """The view layer's objects that neither they nor their collections hide in renders."""
    return {member for member in render_objects(view_layer) if not member.hide_render}


def render_objects(view_layer: "bpy.types.ViewLayer") -> "Iterator[bpy.types.Object]":
    """The view layer's objects that their collections do not hide in renders."""
    for layer_collection in _rendered_collections(view_layer.layer_collection):
        yield from layer_collection.collection.objects


def _rendered_collections(layer_collection: "bpy.types.LayerCollection") -> Iterator[Any]:
    if layer_collection.exclude or layer_collection.collection.hide_render:
        return
    yield layer_collection
    for child in layer_collection.children:
        yield from _rendered_collections(child)


def evaluated_world(depsgraph: "bpy.types.Depsgraph") -> "bpy.types.World | None":
    """The World of an evaluated scene in this frame; None without one, or where the view layer filters it out.

    The evaluated scene refers to the original World, which is not animated during F12.
    """
    world = depsgraph.scene.world
    return world.evaluated_get(depsgraph) if world is not None and depsgraph.view_layer.use_sky else None


def unevaluated(depsgraph: "bpy.types.Depsgraph") -> "list[tuple[bpy.types.Object, SceneError]]":
    """Volumes and lights that are visible in renders but hidden in the viewport, and what to do about each.

    Outside a render, Blender evaluates what the viewport shows, and objects that only the eye of their collection
    hides: the image lacks the others.
    """
    if depsgraph.mode == "RENDER":
        return []
    hidden = [
        candidate
        for candidate in sorted(render_visible(depsgraph.view_layer), key=lambda one: one.name)
        if _rendered_kind(candidate) and not candidate.visible_get(view_layer=depsgraph.view_layer)
    ]
    if not hidden:
        return []
    evaluated = {instance.object.original for instance in depsgraph.object_instances if not instance.is_instance}
    found = []
    for candidate in hidden:
        if candidate not in evaluated:
            kind = _rendered_kind(candidate)
            problem = (
                f'{kind} "{candidate.name}" is hidden in the viewport but not in renders; show it, '
                "or hide it in renders too"
            )
            found.append((candidate, SceneError(problem)))
    return found


def _rendered_kind(candidate: "bpy.types.Object") -> str | None:
    if shows_volume(candidate):
        return "volume"
    if candidate.type == "LIGHT":
        data: Any = candidate.data
        return "sun" if data.type == "SUN" else "light"
    return None
