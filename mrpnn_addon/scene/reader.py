# SPDX-License-Identifier: GPL-3.0-or-later
"""The evaluated scene as plain descriptions for `inference.render`."""

import copy
import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from ...inference.plan.lights import predicted_suns
from ...inference.plan.plan import Plan, make_plan, merge_parallel
from ...inference.scene import (
    Camera,
    Environment,
    Medium,
    Motion,
    SceneError,
    Settings,
    Sun,
    Surface,
    Volume,
)
from ..nodes.material import SURFACES, first_material, shows_volume
from ..objects.animation import changes, volumes_change, with_instanced
from ..objects.camera import read_camera, read_views
from ..objects.ignored_settings import SCENE, VIEW_LAYER, VOLUME, VOLUME_MATERIAL, ignored_settings
from ..objects.light_linking import LightLinks
from ..objects.lights import Lamp, read_lamp, read_suns
from ..objects.motion import GoTo, read_motion, uses_motion_blur
from ..objects.surfaces import OWN_FOG, SOME_FACES, VOLUME_INSIDE, OpaqueMesh, read_surface, surface_warnings
from ..objects.views import View, in_one_file, wanted_views
from ..objects.visibility import (
    LEFT_OUT,
    VisibleObject,
    hidden_from_camera,
    ignored_visibility,
    is_holdout,
    render_objects,
    unevaluated,
    visible_objects,
)
from ..objects.workload import Box, Workload, estimate_workload
from ..runtime.text import utf8_names
from ..volumes.bounding_boxes import box_around, remember_density
from ..volumes.reader import EmptyVolume, VolumeReader, carries
from ..world.lighting import WORLD_FOG, read_world, surface_light_warnings
from .light_groups import LightGroups, lone_lights
from .outputs import Owner, Wanted, wanted
from .overlap_warnings import overlap_warnings
from .unrendered import composited

NO_VOLUME = (
    "the scene shows no Volume object; add one (Add > Volume > Import OpenVDB), or give a closed mesh a material with "
    "a volume and no surface"
)
NO_LIGHT = "the scene shows no sun and no lamp, and its World gives no light; add a sun (Add > Light > Sun)"


@dataclass
class SceneDescription:
    """What a render needs of a scene.

    volumes, lights, camera, surfaces: arguments of `inference.render`. opaque: meshes of the surfaces.
    crop: whether the image has the region's size instead of the full frame's.
    view_layer: its name. frame: its number.
    lamps: point, spot and area lights. environments: the World's light without its discs, which are among the suns.
    environment: whether the World shines.
    warnings: what is left out or approximated, naming each object.
    left_out: names of visible volumes and lights that are not in the description.
    unseen: which volumes are invisible, and why. empty: those among them that are empty in this frame; a scene of only
        such volumes has a description without volumes.
    refused: user errors of objects or the World, which are left out, naming each.
    boxes: around the volumes, each with the number of colour channels that differ; for `workload`.
    groups: which light group lights, volumes and meshes are in.
    views: what a picture shows; several where the scene is stereoscopic. `camera` is the active one. in_one_file:
        whether an OpenEXR file holds all of them.
    placed: key and matrix of the object of each volume.
    wanted: what the view layer and the scene ask for besides colours.
    """

    volumes: list[tuple[Volume, Medium]] = field(default_factory=list)
    suns: list[Sun] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    environments: list[Environment] = field(default_factory=list)
    camera: Camera = None
    opaque: list[OpaqueMesh] = field(default_factory=list)
    crop: bool = True
    view_layer: str = "ViewLayer"
    frame: int = 0
    environment: bool = False
    warnings: list[str] = field(default_factory=list)
    left_out: set[str] = field(default_factory=set)
    unseen: list[str] = field(default_factory=list)
    empty: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    boxes: list[tuple[Box, int]] = field(default_factory=list)
    groups: LightGroups = field(default_factory=LightGroups)
    views: list[View] = field(default_factory=list)
    in_one_file: bool = False
    placed: list[tuple[tuple, np.ndarray]] = field(default_factory=list)
    wanted: Wanted = field(default_factory=Wanted)

    def seen_by(self, view: View) -> "SceneDescription":
        """The same scene with a view's camera. Makes the surfaces, which the views share."""
        self.surfaces  # noqa: B018
        found = copy.copy(self)
        found.camera = view.camera
        return found

    def plan(self, settings: Settings) -> Plan | None:
        """The plan of a render; None without volumes. Raises as `make_plan`."""
        if not self.volumes:
            return None
        return make_plan(self.volumes, self.lights, self.camera, settings, surfaces=self.surfaces)

    def workload(self, depth_samples: int, suns: int | None = None) -> Workload:
        """The work of a render. suns: as how many it computed the light, if it has ended."""
        boxes, channels = [box for box, _ in self.boxes], [channels for _, channels in self.boxes]
        lamps, worlds = len(self.lamps), len(self.environments)
        lights = (len(predicted_suns(merge_parallel(self.suns))) if suns is None else suns) + lamps + worlds
        others = {"surfaces": bool(self.opaque), "lamps": lamps, "worlds": worlds}
        return estimate_workload(boxes, self.camera, lights, depth_samples, max(channels), **others)

    @property
    def lights(self) -> list[Sun | Lamp | Environment]:
        """Everything that lights the volumes, but for what they emit."""
        return [*self.suns, *self.lamps, *self.environments]

    @functools.cached_property
    def surfaces(self) -> list[Surface]:
        """Made on first use by the rendering thread, since large meshes take a while."""
        return [mesh.surface() for mesh in self.opaque]


@utf8_names()
def read_frame(
    depsgraph: "bpy.types.Depsgraph",
    reader: VolumeReader | None = None,
    check: Callable[[], None] = lambda: None,
    goes_on: bool = False,
    go_to: GoTo | None = None,
    flows: bool = False,
) -> SceneDescription:
    """Read everything that a picture needs; bpy is not needed afterwards.

    An object that cannot be rendered is left out, with a warning that names it. A frame without a volume is an empty
    picture and one without light is black, with a warning that names the frame.

    reader: has read volumes of this scene that have not changed since. check: called before each object; an exception
    that it raises stops the reading. goes_on: whether a frame without a volume is a picture for whatever reason, as in
    animations; in a still it is one where volumes change in time. go_to: goes to frames at which the scene is looked at
    for motion blur, and back; None for a picture without it. flows: whether to read the velocities that carry what
    volumes hold until the next frame, in such a picture.

    Raises SceneError, with a remedy, where the scene cannot be rendered: for its camera, or in a still where no volume
    is left.
    """
    missing = unevaluated(depsgraph)
    for hidden, problem in missing:
        if not goes_on and not changes(hidden):
            raise problem
    (camera, _), (views, warnings) = read_camera(depsgraph), read_views(depsgraph)
    description = _describe(depsgraph, reader, check)
    description.views, description.in_one_file = views, in_one_file(depsgraph.scene.render)
    description.camera, description.warnings = camera, warnings + description.warnings
    for hidden, problem in missing:
        description.left_out.add(hidden.name)
        if shows_volume(hidden):
            description.unseen.append(str(problem))
        description.warnings += _refused(description, problem)
    if go_to is not None:
        _add_motion(description, depsgraph, reader or VolumeReader(), go_to, check)
    elif flows:
        _add_velocities(description, depsgraph, reader or VolumeReader(), check, blurred=False)
    panorama = camera.projection == "equirectangular"
    description.warnings += surface_warnings(description.opaque, panorama, composited(depsgraph.scene))
    if not description.volumes:
        if not (goes_on or description.empty or volumes_change(_objects(depsgraph))):
            require_volumes(description)
        _tell_empty(description, _objects(depsgraph))
    elif not _has_light(description):
        description.refused.append(NO_LIGHT)
        description.warnings.append(
            f"frame {description.frame} is black: {_why_dark(description, _objects(depsgraph))}"
        )
    return description


def _add_motion(
    description: SceneDescription,
    depsgraph: "bpy.types.Depsgraph",
    reader: VolumeReader,
    go_to: GoTo,
    check: Callable[[], None],
) -> None:
    """Add what moves while the shutter is open. Raises as `read_motion`."""
    flows = uses_motion_blur(depsgraph) and _add_velocities(description, depsgraph, reader, check)
    found = read_motion(depsgraph, [None, *wanted_views(depsgraph.scene.render)], go_to, check, flows)
    shutter, *shutters = found.shutters
    for (volume, _), (key, matrix) in zip(description.volumes, description.placed):
        if key in found.matrices:
            volume.motion = Motion(found.matrices[key], matrix)
        if key in found.fogs and volume.velocity is None:
            check()
            volume.velocity = found.fogs[key].velocity(matrix, found.frame)
    for mesh in description.opaque:
        mesh.matrices = found.matrices.get(mesh.key)
        vertices = found.vertices.get(mesh.key)
        mesh.vertices = vertices if vertices is not None and vertices.shape[1:] == mesh.mesh.places.shape else None
    description.camera = replace(description.camera, shutter=shutter)
    description.views = [
        replace(view, camera=replace(view.camera, shutter=own))
        for view, own in zip(description.views, shutters or [shutter])
    ]


def _add_velocities(
    description: SceneDescription,
    depsgraph: "bpy.types.Depsgraph",
    reader: VolumeReader,
    check: Callable[[], None],
    blurred: bool = True,
) -> bool:
    """Add the velocities of volumes; returns whether there are any. A volume whose cannot be read has a warning.

    blurred: as of `VolumeReader.velocity`.
    """
    found, rendered = {}, {key for key, _ in description.placed}
    for shown in visible_objects(depsgraph):
        if shown.key not in rendered or not carries(shown):
            continue
        check()
        try:
            found[shown.key] = reader.velocity(shown, depsgraph.scene, blurred)
        except SceneError as problem:
            description.warnings += [f"{problem}; it is rendered without its velocity"]
    for (volume, _), (key, _) in zip(description.volumes, description.placed):
        volume.velocity = found.get(key)
    return any(velocity is not None for velocity in found.values())


def read_scene(
    depsgraph: "bpy.types.Depsgraph",
    reader: VolumeReader | None = None,
    check: Callable[[], None] = lambda: None,
    go_to: GoTo | None = None,
) -> SceneDescription:
    """As `read_frame`, for what needs light.

    Raises SceneError, with the reasons, also where no light is left, and where no volume is, unless all are empty in
    this frame.
    """
    description = read_frame(depsgraph, reader, check, go_to=go_to)
    if not description.volumes and not description.empty:
        require_volumes(description)
    require_light(description)
    return description


@utf8_names()
def read_view(
    depsgraph: "bpy.types.Depsgraph", space: "bpy.types.SpaceView3D", reader: VolumeReader | None = None
) -> SceneDescription:
    """What a SpaceView3D's viewport shows of the scene, without a camera; see `read_frame`.

    The description may be empty. Without light, volumes are black as in Cycles.
    """
    description = _describe(depsgraph, reader, space=space)
    if description.volumes and not _has_light(description):
        description.refused.append(NO_LIGHT)
        description.warnings.append(NO_LIGHT)
    return description


def _objects(depsgraph: "bpy.types.Depsgraph") -> "Iterator[bpy.types.Object]":
    """The original objects that a render shows in some frame, with those that they instance."""
    return with_instanced(render_objects(depsgraph.scene.original.view_layers[depsgraph.view_layer.name]))


def _tell_empty(description: SceneDescription, objects: "Iterable[bpy.types.Object]") -> None:
    """Warn of a frame without a volume. Volumes that have a warning which names the frame need no other."""
    unseen = [reason for reason in description.unseen if reason not in description.empty]
    if not unseen and description.empty:
        return
    # Told once.
    description.warnings = [
        warning for warning in description.warnings if not any(warning.startswith(reason) for reason in unseen)
    ]
    hidden = sorted({f'"{shown.name}"' for shown in objects if shows_volume(shown)})
    reasons = unseen or ([f"volume {' and '.join(hidden)} shows nothing"] if hidden else [_no_volume(description)])
    description.warnings.append(f"frame {description.frame} is an empty picture: {'; '.join(reasons)}")


def _why_dark(description: SceneDescription, objects: "Iterable[bpy.types.Object]") -> str:
    """Why a frame has no light, naming lights that are black or hidden."""
    problems = [problem for problem in description.refused if problem not in (NO_LIGHT, *description.unseen)]
    problems += [f"{name} has no strength" for name in dict.fromkeys(light.name for light in description.lights)]
    lights = sorted({f'"{shown.name}"' for shown in objects if shown.type == "LIGHT"})
    told = [text.removesuffix(LEFT_OUT) for text in description.warnings if text.endswith(LEFT_OUT)]
    problems += [text for text in told if text not in problems and any(name in text for name in lights)]
    problems += [f"light {name} is hidden" for name in lights if not any(name in problem for problem in problems)]
    return "; ".join(problems) or NO_LIGHT


def _describe(
    depsgraph: "bpy.types.Depsgraph",
    reader: VolumeReader | None,
    check: Callable[[], None] = lambda: None,
    space: "bpy.types.SpaceView3D | None" = None,
) -> SceneDescription:
    scene, layer = depsgraph.scene, depsgraph.view_layer
    description = SceneDescription(
        crop=scene.render.use_crop_to_border,
        view_layer=depsgraph.view_layer.name,
        frame=scene.frame_current,
        warnings=[
            *ignored_settings(scene, SCENE),
            *ignored_settings(layer, VIEW_LAYER, f'view layer "{layer.name}"'),
        ],
    )
    if space is None:
        description.wanted = wanted(scene, layer)
        lone = lone_lights(scene.original, scene.original.view_layers[layer.name])
        names = [group.name for group in layer.lightgroups]
        description.groups = LightGroups([*names, *lone.values()], lone)
    reader, links = reader or VolumeReader(), LightLinks()
    for shown in visible_objects(depsgraph, space):
        check()
        try:
            _add(description, shown, reader, depsgraph.view_layer, links)
        except SceneError as problem:
            _refuse(description, shown, problem)
    _link(description, links)
    description.warnings += overlap_warnings(description.volumes)
    try:
        discs, description.environments, warnings = read_world(depsgraph, check)
    except SceneError as problem:
        discs, warnings = [], _refused(description, problem)
    description.environment = bool(discs or description.environments)
    if scene.world is not None:
        own = description.groups.lone.get(scene.world.name, "")
        description.groups.add([*discs, *description.environments], scene.world.lightgroup, own)
    description.suns += discs
    description.warnings += warnings
    if description.opaque:
        description.warnings += surface_light_warnings(depsgraph)
    return description


def _refuse(description: SceneDescription, shown: VisibleObject, problem: SceneError) -> None:
    """Leave an object out."""
    description.left_out.add(shown.name)
    if shows_volume(shown.object) and str(problem) not in description.unseen:
        description.unseen.append(str(problem))
    description.warnings += _refused(description, problem)


def _refused(description: SceneDescription, problem: SceneError) -> list[str]:
    """Record why something is left out; returns the warning, once for all instances."""
    if str(problem) in description.refused:
        return []
    description.refused.append(str(problem))
    return [f"{problem}{LEFT_OUT}"]


def _has_light(description: SceneDescription) -> bool:
    return (
        any(np.any(light.strength) for light in description.lights)
        or any(volume.emission is not None for volume, _ in description.volumes)
        or any(mesh.colour.emission.any() for mesh in description.opaque)
    )


def require_light(description: SceneDescription) -> None:
    """Raises SceneError, with the reasons, where volumes have no light."""
    if NO_LIGHT in description.refused:
        raise SceneError("; ".join(dict.fromkeys([NO_LIGHT, *description.refused])))


def require_volumes(description: SceneDescription) -> None:
    """Raises SceneError, with the reasons, where no volume is left."""
    if not description.volumes:
        reasons = "; ".join(description.unseen)
        raise SceneError(f"no volume is left to render: {reasons}" if reasons else _no_volume(description))


def _no_volume(description: SceneDescription) -> str:
    """Why nothing is rendered where no object shows a volume; names a World and meshes that have one."""
    told = [text.removesuffix(LEFT_OUT) for text in description.warnings]
    ends = WORLD_FOG, VOLUME_INSIDE, SOME_FACES, OWN_FOG
    return "; ".join([NO_VOLUME, *(text for text in told if text.endswith(ends))])


def require_all(description: SceneDescription) -> None:
    """Raises SceneError, with the reasons, where visible objects cannot be rendered, or no volume or no light is left.

    Volumes that are empty in this frame are as they should be.
    """
    if description.refused:
        raise SceneError("; ".join(description.refused))
    if not description.empty:
        require_volumes(description)


def _link(description: SceneDescription, links: LightLinks) -> None:
    """Leave out lights that light nothing which is rendered, by linking or by Cycles' ray visibility."""
    needless = links.link()
    unneeded = {id(light) for light in needless}
    description.suns = [sun for sun in description.suns if id(sun) not in unneeded]
    description.lamps = [lamp for lamp in description.lamps if id(lamp) not in unneeded]
    names = dict.fromkeys(light.name for light in needless)
    description.warnings += [f"{name} lights nothing that is rendered{LEFT_OUT}" for name in names]


def _add(
    description: SceneDescription,
    shown: VisibleObject,
    reader: VolumeReader,
    view_layer: "bpy.types.ViewLayer",
    links: LightLinks,
) -> None:
    kind = shown.object.type
    if shows_volume(shown.object):
        _add_volume(description, shown, reader, view_layer, links)
    elif kind == "LIGHT":
        if shown.data.type == "SUN":
            suns, warnings = read_suns(shown)
            description.suns += suns
            lights: list[Sun | Lamp] = [*suns]
        else:
            lamp, warnings = read_lamp(shown)
            lights = [lamp] if lamp else []
            description.lamps += [lamp] if lamp else []
        links.add_light(shown, lights)
        lone = description.groups.lone.get(shown.object.name, "")
        description.groups.add(lights, *_light_groups(shown), lone)
        description.warnings += warnings
    elif kind in SURFACES:
        surface, warnings = read_surface(shown, view_layer, reader.meshes)
        if surface:
            description.opaque.append(surface)
            links.add_surface(shown, surface.name)
            links.add_light(shown, [surface] if surface.colour.emission.any() else [])
            description.groups.add([surface], *_light_groups(shown))
        description.warnings += warnings


def _light_groups(shown: VisibleObject) -> tuple[str, str]:
    """The light group of an object, and of what instances it."""
    return shown.object.lightgroup, shown.source.lightgroup


def _add_volume(
    description: SceneDescription,
    shown: VisibleObject,
    reader: VolumeReader,
    view_layer: "bpy.types.ViewLayer",
    links: LightLinks,
) -> None:
    where, unseen = f'volume "{shown.name}"', hidden_from_camera(shown, view_layer)
    if not unseen:
        try:
            pairs, warnings = reader.read(shown)
            if is_holdout(shown, view_layer):
                black = np.zeros(3)
                pairs = [
                    (volume, replace(medium, albedo=black, emission=0.0, holdout=True)) for volume, medium in pairs
                ]
            description.volumes += pairs
            description.placed += [(shown.key, shown.matrix)] * len(pairs)
            description.groups.add([volume for volume, _ in pairs], *_light_groups(shown))
            material = first_material(shown.object)
            for volume, _ in pairs:
                links.add_volume(shown, volume.name)
                description.wanted.owners[volume.name] = Owner(shown.object.name, material.name if material else "")
            remember_density(shown, *max(pairs, key=lambda pair: pair[0].density.max()))
            box, channels = box_around(shown)
            description.boxes.append((box, max(channels, len(pairs))))
            description.warnings += [*warnings, *(f"{where} {ignored}" for ignored in ignored_visibility(shown))]
            description.warnings += [
                *ignored_settings(shown.object, VOLUME, where),
                *(ignored_settings(material, VOLUME_MATERIAL, f"{where}: its material") if material else []),
            ]
            return
        except EmptyVolume as nothing:
            unseen = f"{nothing} frame {description.frame}"
            description.empty.append(f"{where} {unseen}")
    description.left_out.add(shown.name)
    description.unseen.append(f"{where} {unseen}")
    description.warnings.append(f"{where} {unseen}{LEFT_OUT}")
