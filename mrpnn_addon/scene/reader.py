"""The evaluated scene as plain descriptions that `inference.render` takes."""

import functools
from dataclasses import dataclass, field
from typing import List, Set, Tuple

from ...inference.scene import Camera, Medium, SceneError, Sun, Surface, Volume
from ..nodes.material import SURFACES, shows_volume
from ..objects.camera import read_camera
from ..objects.lights import read_suns
from ..objects.surfaces import OpaqueMesh, read_surface, surface_warnings
from ..objects.visibility import ignored_visibility, require_evaluated, shown_objects, why_unseen
from ..objects.workload import Box, Workload, estimate_workload
from ..volumes.bounding_boxes import box_around, remember_density
from ..volumes.reader import EmptyVolume, VolumeReader
from ..world.lighting import read_world
from .overlap_warnings import overlap_warnings

NO_LIGHT = "the scene shows no sun, and its World gives no light; add a sun (Add > Light > Sun)"


@dataclass
class SceneDescription:
    """volumes, suns, camera, surfaces: arguments of `inference.render`. opaque: what the surfaces are made of.
    crop: whether the image has the region's size, or the full frame's with nothing around it.
    view_layer: its name.
    frame: the scene's frame number.
    environment: whether `suns` hold the World's light.
    warnings: what is left out or approximated, naming each object.
    left_out: names of the volumes and lights that are not in the description although the scene shows them.
    unseen: which volumes, and why; empty: those of them that hold nothing in this frame. Where no other volume is
    left, a scene with some of these is described without volumes.
    refused: why objects, or the World, cannot be rendered and are left out: mistakes, naming each.
    boxes: around the volumes, and how many colours differ in extinction: what a render's seconds are told by.
    """

    volumes: List[Tuple[Volume, Medium]] = field(default_factory=list)
    suns: List[Sun] = field(default_factory=list)
    camera: Camera = None
    opaque: List[OpaqueMesh] = field(default_factory=list)
    crop: bool = True
    view_layer: str = "ViewLayer"
    frame: int = 0
    environment: bool = False
    warnings: List[str] = field(default_factory=list)
    left_out: Set[str] = field(default_factory=set)
    unseen: List[str] = field(default_factory=list)
    empty: List[str] = field(default_factory=list)
    refused: List[str] = field(default_factory=list)
    boxes: List[Tuple[Box, int]] = field(default_factory=list)

    def workload(self, depth_samples: int) -> Workload:
        """What a render has to do."""
        boxes, channels = zip(*self.boxes)
        return estimate_workload(boxes, self.camera, len(self.suns), depth_samples, max(channels))

    @functools.cached_property
    def surfaces(self) -> List[Surface]:
        """Made when they are first asked for, which takes a while for large meshes: by the thread that renders."""
        return [mesh.surface() for mesh in self.opaque]


def read_scene(depsgraph, reader: VolumeReader = None, check=lambda: None) -> SceneDescription:
    """Read everything that a render needs; bpy is not needed afterwards.

    An object that cannot be rendered is left out with a warning that names it.

    reader: that has read volumes of this scene before, none of which has changed since. check: called before each object;
    what it raises ends the reading.

    Raises SceneError, saying what to add or change, where the scene cannot be rendered: where its camera cannot, or
    where no volume or no light is left.
    """
    require_evaluated(depsgraph)
    camera, warnings = read_camera(depsgraph)
    description = _described(depsgraph, reader, check)
    description.camera, description.warnings = camera, warnings + description.warnings
    description.warnings += surface_warnings(description.opaque, camera.projection == "equirectangular")
    if not description.volumes and description.empty:
        return description
    require_volumes(description)
    if not description.volumes:
        raise SceneError("the scene shows no Volume object; add one (Add > Volume > Import OpenVDB), or give a "
                         "closed mesh a material with a volume and no surface")
    if not _lit(description):
        raise SceneError("; ".join([NO_LIGHT, *description.refused]))
    return description


def read_view(depsgraph, space, reader: VolumeReader = None) -> SceneDescription:
    """What the viewport of a SpaceView3D shows of the scene, without a camera; see `read_scene`.

    It may be nothing at all. Without light, volumes are black as they are in Cycles.
    """
    description = _described(depsgraph, reader, space=space)
    if description.volumes and not _lit(description):
        description.suns.append(Sun((0.0, 0.0, 1.0), 0.0, name="no light"))
        description.refused.append(NO_LIGHT)
        description.warnings.append(NO_LIGHT)
    return description


def _described(depsgraph, reader, check=lambda: None, space=None) -> SceneDescription:
    scene = depsgraph.scene
    description = SceneDescription(
        crop=scene.render.use_crop_to_border, view_layer=depsgraph.view_layer.name, frame=scene.frame_current,
        warnings=_view_layer_warnings(depsgraph.view_layer))
    reader = reader or VolumeReader()
    for shown in shown_objects(depsgraph, space):
        check()
        try:
            _add(description, shown, reader, depsgraph.view_layer)
        except SceneError as problem:
            _refuse(description, shown, problem)
    description.warnings += overlap_warnings(description.volumes)
    try:
        lights, warnings = read_world(depsgraph, description.suns, check)
    except SceneError as problem:
        lights, warnings = [], _refused(description, problem)
    description.environment = bool(lights)
    description.suns += lights
    description.warnings += warnings
    return description


def _refuse(description: SceneDescription, shown, problem: SceneError) -> None:
    """Leave an object out."""
    description.left_out.add(shown.name)
    if shows_volume(shown.object) and str(problem) not in description.unseen:
        description.unseen.append(str(problem))
    description.warnings += _refused(description, problem)


def _refused(description: SceneDescription, problem: SceneError) -> List[str]:
    """Remember why something is left out; the warning, of instances only once."""
    if str(problem) in description.refused:
        return []
    description.refused.append(str(problem))
    return [f"{problem} (left out)"]


def _lit(description: SceneDescription) -> bool:
    return bool(description.suns) or any(volume.emission is not None for volume, _ in description.volumes)


def require_volumes(description: SceneDescription) -> None:
    """Raises SceneError where all volumes are left out, saying why."""
    if not description.volumes and description.unseen:
        raise SceneError("no volume is left to render: " + "; ".join(description.unseen))


def require_all(description: SceneDescription) -> None:
    """Raises SceneError where an object that the scene shows cannot be rendered, saying why of each."""
    if description.refused:
        raise SceneError("; ".join(description.refused))


def _add(description: SceneDescription, shown, reader: VolumeReader, view_layer) -> None:
    kind = shown.object.type
    if shows_volume(shown.object):
        _add_volume(description, shown, reader, view_layer)
    elif kind == 'LIGHT' and shown.object.data.type == 'SUN':
        # Cycles' ray visibility of a lamp: without it the sun lights surfaces only.
        if not shown.object.visible_volume_scatter:
            description.warnings.append(f"sun \"{shown.name}\" is hidden from volume scattering and left out")
            return
        suns, warnings = read_suns(shown)
        description.suns += suns
        description.warnings += warnings
    elif kind == 'LIGHT':
        lamp = shown.object.data.type.lower()
        description.warnings.append(
            f"light \"{shown.name}\" ({lamp}) is left out; only suns and the World light volumes")
    elif kind in SURFACES:
        surface, warnings = read_surface(shown, view_layer, reader.meshes)
        description.opaque += [surface] if surface else []
        description.warnings += warnings


def _add_volume(description: SceneDescription, shown, reader: VolumeReader, view_layer) -> None:
    where, unseen = f"volume \"{shown.name}\"", why_unseen(shown, view_layer)
    if not unseen:
        try:
            volume, medium, warnings = reader.read(shown)
            description.volumes.append((volume, medium))
            remember_density(shown, volume, medium)
            description.boxes.append(box_around(shown))
            description.warnings += [*warnings, *(f"{where} {ignored}" for ignored in ignored_visibility(shown))]
            return
        except EmptyVolume as nothing:
            unseen = f"{nothing} frame {description.frame}"
            description.empty.append(f"{where} {unseen}")
    description.left_out.add(shown.name)
    description.unseen.append(f"{where} {unseen}")
    description.warnings.append(f"{where} {unseen} and is left out")


def _view_layer_warnings(view_layer) -> List[str]:
    """What a view layer asks for and does not get."""
    where, found = f"view layer \"{view_layer.name}\"", []
    if view_layer.material_override is not None:
        found.append(f"{where} overrides materials; volumes keep their own")
    # Later than Blender 4.2.
    if getattr(view_layer, "world_override", None) is not None:
        found.append(f"{where} overrides the World; the scene's own is rendered")
    if not view_layer.use_volumes:
        found.append(f"{where} filters volumes out; they are rendered")
    return found
