"""The evaluated scene as plain descriptions that `inference.render` takes."""

import functools
from dataclasses import dataclass, field
from typing import List, Tuple

from ..inference.scene import Camera, Medium, SceneError, Sun, Volume
from ..inference.surfaces import Surface
from .camera import read_camera
from .cost_model import Box, Work, work
from .lights import read_suns
from .material import SURFACES, shows_volume
from .overlap_warnings import overlap_warnings
from .surfaces import OpaqueMesh, read_surface, surface_warnings
from .visibility import ignored_visibility, require_evaluated, shown_objects, why_unseen
from .volume_boxes import box_around, remember_density
from .volumes import VolumeReader, why_empty
from .world import read_world


@dataclass
class SceneDescription:
    """volumes, suns, camera, surfaces: arguments of `inference.render`. opaque: what the surfaces are made of.
    crop: whether the image has the region's size, or the full frame's with nothing around it.
    view_layer: its name.
    frame: the scene's frame number.
    environment: whether `suns` hold the World's light.
    warnings: what is left out or approximated, naming each object. unseen: which volumes, and why; empty: those of them that
    hold nothing in this frame. A scene all of whose volumes do is described without volumes.
    boxes: around the volumes, each with how many colours differ in extinction; they tell the seconds of a render.
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
    unseen: List[str] = field(default_factory=list)
    empty: List[str] = field(default_factory=list)
    boxes: List[Tuple[Box, int]] = field(default_factory=list)

    def work(self, depth_samples: int) -> Work:
        """What a render has to do."""
        boxes, channels = zip(*self.boxes)
        return work(boxes, self.camera, len(self.suns), depth_samples, max(channels))

    @functools.cached_property
    def surfaces(self) -> List[Surface]:
        """Made when they are first asked for, which takes a while for large meshes: by the thread that renders."""
        return [mesh.surface() for mesh in self.opaque]


def read_scene(depsgraph, reader: VolumeReader = None, check=lambda: None) -> SceneDescription:
    """Read everything that a render needs; bpy is not needed afterwards.

    reader: that has read volumes of this scene before, none of which has changed since. check: called before each object;
    what it raises ends the reading.

    Raises SceneError, saying what to add or change, where the scene cannot be rendered.
    """
    require_evaluated(depsgraph)
    scene = depsgraph.scene
    camera, warnings = read_camera(depsgraph)
    description = SceneDescription(
        camera=camera, crop=scene.render.use_crop_to_border,
        view_layer=depsgraph.view_layer.name, frame=scene.frame_current, warnings=warnings,
    )
    reader = reader or VolumeReader()
    description.warnings += _view_layer_warnings(depsgraph.view_layer)
    for shown in shown_objects(depsgraph):
        check()
        _add(description, shown, reader, depsgraph.view_layer)
    description.warnings += overlap_warnings(description.volumes)
    description.warnings += surface_warnings(description.opaque, camera.projection == "equirectangular")
    lights, warnings = read_world(depsgraph, description.suns, check)
    description.environment = bool(lights)
    description.suns += lights
    description.warnings += warnings
    if not description.volumes and description.unseen == description.empty != []:
        return description
    require_volumes(description)
    if not description.volumes:
        raise SceneError("the scene shows no Volume object; add one (Add > Volume > Import OpenVDB), or give a "
                         "closed mesh a material with a volume and no surface")
    if not description.suns and not any(volume.emission is not None for volume, _ in description.volumes):
        raise SceneError("the scene shows no sun, and its World gives no light; add a sun (Add > Light > Sun)")
    return description


def require_volumes(description: SceneDescription) -> None:
    """Raises SceneError where all volumes are left out, saying why."""
    if not description.volumes and description.unseen:
        raise SceneError("no volume is left to render: " + "; ".join(description.unseen))


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
        description.warnings.append(f"light \"{shown.name}\", of type {lamp}, is not rendered; only suns are")
    elif kind in SURFACES:
        surface, warnings = read_surface(shown, view_layer, reader.meshes)
        description.opaque += [surface] if surface else []
        description.warnings += warnings


def _add_volume(description: SceneDescription, shown, reader: VolumeReader, view_layer) -> None:
    where, unseen = f"volume \"{shown.name}\"", why_unseen(shown, view_layer)
    empty = "" if unseen else why_empty(shown.object)
    if empty:
        unseen = f"{empty} frame {description.frame}"
        description.empty.append(f"{where} {unseen}")
    if unseen:
        description.unseen.append(f"{where} {unseen}")
        description.warnings.append(f"{where} {unseen} and is left out")
        return
    volume, medium, warnings = reader.read(shown)
    description.volumes.append((volume, medium))
    remember_density(shown, volume, medium)
    description.boxes.append(box_around(shown))
    description.warnings += [*warnings, *(f"{where} {ignored}" for ignored in ignored_visibility(shown))]


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
