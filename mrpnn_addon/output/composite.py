"""A scene by Cycles whose volumes a second scene renders with MRPNN; its compositor lays them over it.

The first scene keeps all that it holds. Volumes are invisible to the camera in its renders only: a handler hides the
evaluated copies of objects that Blender makes for a render and drops after it, so that instances, linked libraries and
the viewport stay as they are. The second scene shows the same collections and takes its settings from the first one.
"""

import threading
from typing import List, Optional

import bpy
from bpy.props import BoolProperty, PointerProperty, StringProperty

from ..nodes.material import shows_volume
from .composite_nodes import build_nodes, remove_nodes, what_is_wrong

ENGINE = 'MRPNN'
# What differs between the two scenes by design.
_OWN_RENDER = {"rna_type", "engine", "film_transparent", "use_compositing", "use_sequencer", "filepath"}
_OWN_SETTINGS = {"rna_type", "name", "version", "preset"}
# On these depend which values others of a file format may take.
_FORMAT = ("media_type", "file_format", "color_mode")
_OF_SCENE = ("frame_start", "frame_end", "frame_step", "camera", "world", "background_set")
_OF_LAYER_COLLECTION = ("exclude", "holdout", "indirect_only", "hide_viewport")
_RAYS = ("visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission", "visible_volume_scatter",
         "visible_shadow")


class MRPNN_PG_composite(bpy.types.PropertyGroup):
    """Of a composited scene: volumes, and what *Remove Composite* restores. Of the scene of its volumes: surfaces."""

    active: BoolProperty(name="Composited", description="Whether the volumes are composited over this scene")
    volumes: PointerProperty(name="Scene of the Volumes", type=bpy.types.Scene)
    surfaces: PointerProperty(name="Scene of the Surfaces", type=bpy.types.Scene)
    shadows: BoolProperty(
        name="Shadows on Surfaces", default=True,
        description="Keep the volumes in Cycles, invisible to the camera, so that they shade surfaces")
    engine: StringProperty(name="Render Engine Before")
    compositing: BoolProperty(name="Compositing Before")
    made_tree: BoolProperty(name="Compositor Made")


def composite(scene, shadows: bool) -> None:
    """Composite a scene's volumes over what Cycles renders of it, or mend what differs from that.

    Raises ValueError where another scene has the name that the volumes' scene is to have.
    """
    kept = scene.mrpnn_composite
    if volume_scene(scene) is None:
        name = f"{scene.name} MRPNN"
        if name in bpy.data.scenes:
            raise ValueError(f"there is a scene \"{name}\" already; delete or rename it")
        volumes = _volume_scene(scene, name)
        kept.volumes, volumes.mrpnn_composite.surfaces = volumes, scene
    if not kept.active:
        kept.engine, kept.compositing = scene.render.engine, scene.render.use_compositing
    kept.shadows = shadows
    scene.render.engine, scene.render.use_compositing = 'CYCLES', True
    kept.made_tree = build_nodes(scene, kept.volumes) or (kept.active and kept.made_tree)
    kept.active = True
    follow(scene)


def remove_composite(scene) -> None:
    """Undo `composite`: the scene is as before, the scene of its volumes is gone."""
    kept, volumes = scene.mrpnn_composite, volume_scene(scene)
    remove_nodes(scene, kept.made_tree)
    if kept.engine:
        scene.render.engine = kept.engine
    scene.render.use_compositing = kept.compositing
    for name in ("active", "volumes", "shadows", "engine", "compositing", "made_tree"):
        kept.property_unset(name)
    if volumes is not None:
        bpy.data.scenes.remove(volumes)
    # A render that Blender keeps between frames remembers the volumes as hidden.
    for shown in bpy.data.objects:
        if shows_volume(shown):
            shown.update_tag()


def volume_scene(scene) -> Optional["bpy.types.Scene"]:
    """The scene that renders this one's volumes; None where there is none, as for a copy of a composited scene."""
    volumes = scene.mrpnn_composite.volumes
    return volumes if volumes is not None and volumes.mrpnn_composite.surfaces == scene else None


def out_of_date(scene) -> List[str]:
    """What keeps a composited scene's render from showing its volumes as it should; `composite` mends it."""
    volumes, found = volume_scene(scene), []
    if volumes is None:
        other = scene.mrpnn_composite.volumes
        found.append("The scene of the volumes was deleted" if other is None else
                     f"The volumes are those of another scene, in \"{other.name}\"")
    if scene.render.engine != 'CYCLES':
        found.append("The render engine is not Cycles")
    if not scene.render.use_compositing:
        found.append("Output > Post Processing > Compositing is off")
    return found + what_is_wrong(scene, volumes)


def follow(scene, structure: bool = True) -> None:
    """Bring the scene of a composited scene's volumes up to date; writes only what differs.

    structure: whether to follow objects, collections and view layers as well, which needs Blender's main thread.
    """
    volumes = volume_scene(scene)
    if not scene.mrpnn_composite.active or volumes is None:
        return
    _set(volumes.render, "engine", ENGINE)
    _set(volumes.render, "film_transparent", True)
    _set(volumes.render, "use_compositing", False)
    _set(volumes.render, "use_sequencer", False)
    _follow_values(scene.render, volumes.render, _OWN_RENDER)
    _set(volumes.render, "filepath", _beside(scene.render.filepath))
    _follow_values(scene.mrpnn, volumes.mrpnn, _OWN_SETTINGS)
    for name in _OF_SCENE:
        _set(volumes, name, getattr(scene, name))
    if not structure:
        return
    _follow_format(scene.render.image_settings, volumes.render.image_settings)
    _follow_markers(scene, volumes)
    for name in ("objects", "children"):
        _follow_links(getattr(scene.collection, name), getattr(volumes.collection, name))
    for view_layer in volumes.view_layers[1:]:
        volumes.view_layers.remove(view_layer)
    layer = volumes.view_layers[0]
    _set(layer, "use", True)
    _set(layer, "use_pass_z", True)
    rendered = [one for one in scene.view_layers if one.use] or scene.view_layers[:1]
    _follow_layer(layer.layer_collection, [one.layer_collection for one in rendered])


def _volume_scene(scene, name: str):
    """A scene of the same collections and animation."""
    volumes = scene.copy()
    volumes.name = name
    own = volumes.mrpnn_composite
    for prop in ("active", "volumes", "shadows", "engine", "compositing", "made_tree"):
        own.property_unset(prop)
    if bpy.app.version >= (5, 0, 0):
        volumes.compositing_node_group = None
    else:
        volumes.use_nodes = False
    return volumes


def _set(owner, name: str, value) -> None:
    if getattr(owner, name) != value:
        setattr(owner, name, value)


def _follow_values(source, target, own) -> None:
    """Give `target` the values of all plain properties of `source` but those named in `own`."""
    for prop in source.bl_rna.properties:
        if prop.identifier in own or prop.is_readonly or prop.type in ('POINTER', 'COLLECTION'):
            continue
        value, known = getattr(source, prop.identifier), getattr(target, prop.identifier)
        if getattr(prop, "is_array", False):
            value, known = tuple(value), tuple(known)
        if value != known:
            try:
                setattr(target, prop.identifier, value)
            except TypeError:
                # A choice that this version of Blender does not know, as a later one may have left.
                continue


def _follow_format(source, target) -> None:
    for name in _FORMAT:
        if hasattr(source, name):
            _set(target, name, getattr(source, name))
    _follow_values(source, target, {"rna_type", *_FORMAT})


def _beside(path: str) -> str:
    """The volumes' own files lie beside the first scene's."""
    start = max(path.rfind("/"), path.rfind("\\")) + 1
    return f"{path[:start]}volumes_{path[start:]}"


def _follow_markers(scene, volumes) -> None:
    """Markers bind cameras to frames."""
    def told(markers):
        return [(marker.name, marker.frame, marker.camera) for marker in markers]

    if told(scene.timeline_markers) != told(volumes.timeline_markers):
        volumes.timeline_markers.clear()
        for name, frame, camera in told(scene.timeline_markers):
            volumes.timeline_markers.new(name, frame=frame).camera = camera


def _follow_links(source, target) -> None:
    """Link what is in one collection's objects or children to another's, and nothing else."""
    wanted, there = set(source), set(target)
    for other in there - wanted:
        target.unlink(other)
    for missing in wanted - there:
        target.link(missing)


def _follow_layer(target, sources) -> None:
    """Show what any of the rendered view layers shows."""
    children = {}
    for source in sources:
        for child in source.children:
            children.setdefault(child.collection, []).append(child)
    for child in target.children:
        found = children.get(child.collection, ())
        for name in _OF_LAYER_COLLECTION:
            if found:
                _set(child, name, all(getattr(one, name) for one in found))
        _follow_layer(child, found)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _follow_all() -> None:
    for scene in bpy.data.scenes:
        if scene.library is None and scene.mrpnn_composite.active:
            follow(scene)


@bpy.app.handlers.persistent
def _after_change(*_):
    # While Blender renders, its render thread reads both scenes.
    if _in_main_thread() and not bpy.app.is_job_running('RENDER'):
        _follow_all()


@bpy.app.handlers.persistent
def _before_render(scene, *_):
    """Changes that no update of the scene has told of yet, as those of a script."""
    if scene.mrpnn_composite.active:
        follow(scene, structure=_in_main_thread())


@bpy.app.handlers.persistent
def _hide_volumes(scene, depsgraph=None):
    """Make volumes invisible to the camera in a render of a composited scene, or where wanted to everything."""
    if depsgraph is None or depsgraph.mode != 'RENDER' or not scene.mrpnn_composite.active:
        return
    if volume_scene(scene) is None or scene.render.engine == ENGINE:
        return
    hidden = {instance.object.original for instance in depsgraph.object_instances if shows_volume(instance.object)}
    for shown in hidden:
        evaluated = shown.evaluated_get(depsgraph)
        for name in _RAYS[:1] if scene.mrpnn_composite.shadows else _RAYS:
            setattr(evaluated, name, False)


_HANDLERS = {"depsgraph_update_post": _after_change, "save_pre": _after_change, "load_post": _after_change,
             "render_init": _before_render, "frame_change_post": _hide_volumes}


def register():
    bpy.utils.register_class(MRPNN_PG_composite)
    bpy.types.Scene.mrpnn_composite = PointerProperty(type=MRPNN_PG_composite)
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)


def unregister():
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(handler)
    del bpy.types.Scene.mrpnn_composite
    bpy.utils.unregister_class(MRPNN_PG_composite)
