# SPDX-License-Identifier: GPL-3.0-or-later
"""Composites volumes, rendered with MRPNN in a second scene, over a scene rendered by Cycles.

The first scene keeps its objects. Volumes are invisible to the camera only in its renders: a handler hides the
evaluated copies of objects that Blender makes for a render, so instances, linked libraries and the viewport are
unaffected. The second scene shows the same collections and copies the first one's settings.
"""

import threading
from typing import Any

import bpy
from bpy.props import BoolProperty, PointerProperty, StringProperty

from ..nodes.material import shows_volume
from ..runtime.text import utf8_names
from ..settings.properties import scene_settings
from .composite_nodes import build_nodes, compositor_problems, remove_nodes

ENGINE = "MRPNN"
# Properties that differ between the two scenes by design.
_OWN_RENDER_PROPERTIES = {"rna_type", "engine", "film_transparent", "use_compositing", "use_sequencer", "filepath"}
_OWN_SETTINGS_PROPERTIES = {"rna_type", "name", "version", "preset"}
# Set before other properties of a file format, whose values depend on them.
_FORMAT = ("media_type", "file_format", "color_mode")
_SCENE_PROPERTIES = ("frame_start", "frame_end", "frame_step", "camera", "world", "background_set")
_LAYER_COLLECTION_PROPERTIES = ("exclude", "holdout", "indirect_only", "hide_viewport")
# What `composite` sets in a scene's MRPNN_PG_composite.
_OWN_STATE = "active", "volumes", "shadows", "engine", "compositing", "made_tree", "depth_layer"
_RAYS = (
    "visible_camera",
    "visible_diffuse",
    "visible_glossy",
    "visible_transmission",
    "visible_volume_scatter",
    "visible_shadow",
)


class MRPNN_PG_composite(bpy.types.PropertyGroup):
    """A composited scene's volume scene, and what *Remove Composite* restores; of a volume scene, its surfaces."""

    active: BoolProperty(name="Composited", description="Whether the volumes are composited over this scene")
    volumes: PointerProperty(name="Scene of the Volumes", type=bpy.types.Scene)
    surfaces: PointerProperty(name="Scene of the Surfaces", type=bpy.types.Scene)
    shadows: BoolProperty(
        name="Shadows on Surfaces",
        default=True,
        description="Keep the volumes in Cycles, invisible to the camera, so that they cast shadows on surfaces",
    )
    engine: StringProperty(name="Render Engine Before")
    compositing: BoolProperty(name="Compositing Before")
    made_tree: BoolProperty(name="Compositor Made")
    depth_layer: StringProperty(name="View Layer Given a Depth Pass")


def composite_state(scene: "bpy.types.Scene") -> MRPNN_PG_composite:
    """`scene.mrpnn_composite`, which the types of bpy do not have."""
    return scene.path_resolve("mrpnn_composite")


@utf8_names()
def composite(scene: "bpy.types.Scene", shadows: bool) -> None:
    """Composite a scene's volumes over its render by Cycles, or repair a composite.

    Raises ValueError where another scene has the name of the volumes' scene.
    """
    state = composite_state(scene)
    if volume_scene(scene) is None:
        name = f"{scene.name} MRPNN"
        if name in bpy.data.scenes:
            raise ValueError(f'there is a scene "{name}" already; delete or rename it')
        volumes = _volume_scene(scene, name)
        state.volumes, composite_state(volumes).surfaces = volumes, scene
    if not state.active:
        state.engine, state.compositing = scene.render.engine, scene.render.use_compositing
    state.shadows = shadows
    render: Any = scene.render
    render.engine, render.use_compositing = "CYCLES", True
    without_depth = [layer.name for layer in scene.view_layers if not layer.use_pass_z]
    state.made_tree = build_nodes(scene, state.volumes) or (state.active and state.made_tree)
    given = [name for name in without_depth if scene.view_layers[name].use_pass_z]
    state.depth_layer = given[0] if given else state.depth_layer
    state.active = True
    synchronize(scene)


def remove_composite(scene: "bpy.types.Scene") -> None:
    """Undo `composite`: restore the scene and remove the scene of its volumes."""
    state, volumes = composite_state(scene), volume_scene(scene)
    remove_nodes(scene, state.made_tree)
    if state.engine:
        scene.render.engine = state.engine
    scene.render.use_compositing = state.compositing
    if state.depth_layer in scene.view_layers:
        scene.view_layers[state.depth_layer].use_pass_z = False
    for name in _OWN_STATE:
        state.property_unset(name)
    if volumes is not None:
        bpy.data.scenes.remove(volumes)
    # Persistent render data remembers the volumes as hidden.
    for shown in bpy.data.objects:
        if shows_volume(shown):
            shown.update_tag()


def volume_scene(scene: "bpy.types.Scene") -> "bpy.types.Scene | None":
    """The scene that renders this one's volumes; None without one, as for a copy of a composited scene."""
    volumes = composite_state(scene).volumes
    return volumes if volumes is not None and composite_state(volumes).surfaces == scene else None


def out_of_date(scene: "bpy.types.Scene") -> list[str]:
    """Reasons why a composited scene does not show its volumes; `composite` repairs them."""
    volumes, found = volume_scene(scene), []
    if volumes is None:
        other = composite_state(scene).volumes
        found.append(
            "The scene of the volumes was deleted"
            if other is None
            else f'The volumes are those of another scene, in "{other.name}"'
        )
    if scene.render.engine != "CYCLES":
        found.append("The render engine is not Cycles")
    if not scene.render.use_compositing:
        found.append("Output > Post Processing > Compositing is off")
    return found + compositor_problems(scene, volumes)


def synchronize(scene: "bpy.types.Scene", structure: bool = True) -> None:
    """Update the scene of a composited scene's volumes; writes only what differs.

    structure: whether to update objects, collections and view layers too, which needs Blender's main thread.
    """
    volumes = volume_scene(scene)
    if not composite_state(scene).active or volumes is None:
        return
    _set(volumes.render, "engine", ENGINE)
    _set(volumes.render, "film_transparent", True)
    _set(volumes.render, "use_compositing", False)
    _set(volumes.render, "use_sequencer", False)
    _copy_values(scene.render, volumes.render, _OWN_RENDER_PROPERTIES)
    _set(volumes.render, "filepath", _beside(scene.render.filepath))
    if hasattr(scene, "cycles"):
        _set(volumes.cycles, "film_exposure", scene.cycles.film_exposure)
    _copy_values(scene_settings(scene), scene_settings(volumes), _OWN_SETTINGS_PROPERTIES)
    for name in _SCENE_PROPERTIES:
        _set(volumes, name, getattr(scene, name))
    if not structure:
        return
    _copy_views(scene.render.views, volumes.render.views)
    _copy_format(scene.render.image_settings, volumes.render.image_settings)
    _copy_markers(scene, volumes)
    for name in ("objects", "children"):
        _copy_links(getattr(scene.collection, name), getattr(volumes.collection, name))
    for view_layer in volumes.view_layers[1:]:
        volumes.view_layers.remove(view_layer)
    layer = volumes.view_layers[0]
    _set(layer, "use", True)
    _set(layer, "use_pass_z", True)
    rendered = [one for one in scene.view_layers if one.use] or scene.view_layers[:1]
    _copy_layer(layer.layer_collection, [one.layer_collection for one in rendered])


def _volume_scene(scene: "bpy.types.Scene", name: str) -> "bpy.types.Scene":
    """A scene with the same collections and animation."""
    volumes = scene.copy()
    volumes.name = name
    own = composite_state(volumes)
    for prop in _OWN_STATE:
        own.property_unset(prop)
    if bpy.app.version >= (5, 0, 0):
        settings: Any = volumes
        settings.compositing_node_group = None
    else:
        volumes.use_nodes = False
    return volumes


def _set(owner: Any, name: str, value: Any) -> None:
    if getattr(owner, name) != value:
        setattr(owner, name, value)


def _copy_values(source: Any, target: Any, own: Any) -> None:
    """Copy all plain properties of `source` to `target` but those named in `own`."""
    for prop in source.bl_rna.properties:
        if prop.identifier in own or prop.is_readonly or prop.type in ("POINTER", "COLLECTION"):
            continue
        value, known = getattr(source, prop.identifier), getattr(target, prop.identifier)
        if getattr(prop, "is_array", False):
            value, known = tuple(value), tuple(known)
        if value != known:
            try:
                setattr(target, prop.identifier, value)
            except TypeError:
                # A choice of a later version of Blender.
                continue


def _copy_format(source: Any, target: Any) -> None:
    for name in _FORMAT:
        if hasattr(source, name):
            _set(target, name, getattr(source, name))
    _copy_values(source, target, {"rna_type", *_FORMAT})


def _copy_views(
    source: "bpy.types.RenderViews",
    target: "bpy.types.RenderViews",
) -> None:
    """Make the views of stereoscopy and multi-view those of another scene, in the same order."""
    if [view.name for view in source] != [view.name for view in target]:
        # One view always stays, and has the first name in the end.
        for view in list(target)[1:]:
            target.remove(view)
        target[0].name = source[0].name
        for view in list(source)[1:]:
            target.new(view.name)
    for view, other in zip(source, target):
        _copy_values(view, other, {"rna_type", "name"})


def _beside(path: str) -> str:
    """The path of the volumes' files, beside the first scene's."""
    start = max(path.rfind("/"), path.rfind("\\")) + 1
    return f"{path[:start]}volumes_{path[start:]}"


def _copy_markers(scene: "bpy.types.Scene", volumes: "bpy.types.Scene") -> None:
    """Copy markers, which bind cameras to frames."""

    def described(markers: Any) -> list:
        return [(marker.name, marker.frame, marker.camera) for marker in markers]

    if described(scene.timeline_markers) != described(volumes.timeline_markers):
        volumes.timeline_markers.clear()
        for name, frame, camera in described(scene.timeline_markers):
            volumes.timeline_markers.new(name, frame=frame).camera = camera


def _copy_links(source: Any, target: Any) -> None:
    """Make a collection's objects or children those of another."""
    wanted, there = set(source), set(target)
    for other in there - wanted:
        target.unlink(other)
    for missing in wanted - there:
        target.link(missing)


def _copy_layer(target: Any, sources: Any) -> None:
    """Show what any of the rendered view layers shows."""
    children: dict[Any, list] = {}
    for source in sources:
        for child in source.children:
            children.setdefault(child.collection, []).append(child)
    for child in target.children:
        found = children.get(child.collection, ())
        for name in _LAYER_COLLECTION_PROPERTIES:
            if found:
                _set(child, name, all(getattr(one, name) for one in found))
        _copy_layer(child, found)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _synchronize_all() -> None:
    for scene in bpy.data.scenes:
        if scene.library is None and composite_state(scene).active:
            synchronize(scene)


@bpy.app.handlers.persistent
def _after_change(*_: Any) -> None:
    # During a render, Blender's render thread reads both scenes.
    if _in_main_thread() and not bpy.app.is_job_running("RENDER"):
        _synchronize_all()


@bpy.app.handlers.persistent
def _before_render(scene: "bpy.types.Scene", *_: Any) -> None:
    """Apply changes without a depsgraph update, such as those of scripts."""
    if composite_state(scene).active:
        synchronize(scene, structure=_in_main_thread())


@bpy.app.handlers.persistent
def _hide_volumes(scene: "bpy.types.Scene", depsgraph: "bpy.types.Depsgraph" = None) -> None:
    """Hide volumes from the camera, or from all rays if wanted, in a render of a composited scene."""
    if depsgraph is None or depsgraph.mode != "RENDER" or not composite_state(scene).active:
        return
    if volume_scene(scene) is None or scene.render.engine == ENGINE:
        return
    hidden = {instance.object.original for instance in depsgraph.object_instances if shows_volume(instance.object)}
    for shown in hidden:
        evaluated = shown.evaluated_get(depsgraph)
        for name in _RAYS[:1] if composite_state(scene).shadows else _RAYS:
            setattr(evaluated, name, False)


_HANDLERS = {
    "depsgraph_update_post": _after_change,
    "save_pre": _after_change,
    "load_post": _after_change,
    "render_init": _before_render,
    "frame_change_post": _hide_volumes,
}


def register() -> None:
    bpy.utils.register_class(MRPNN_PG_composite)
    scene: Any = bpy.types.Scene
    scene.mrpnn_composite = PointerProperty(type=MRPNN_PG_composite)
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(handler)
    scene: Any = bpy.types.Scene
    del scene.mrpnn_composite
    bpy.utils.unregister_class(MRPNN_PG_composite)
