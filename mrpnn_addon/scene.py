"""The evaluated scene as plain descriptions that `inference.render` takes."""

from dataclasses import dataclass, field
from typing import List, Tuple

from ..inference.scene import Camera, Medium, SceneError, Sun, Volume
from .camera import read_camera
from .lights import read_sun, world_warnings
from .visibility import require_evaluated, shown_objects
from .volumes import outside_sequence, read_volume

SURFACES = {'MESH', 'CURVE', 'SURFACE', 'META', 'FONT', 'CURVES', 'POINTCLOUD'}


@dataclass
class SceneDescription:
    """volumes, suns, camera: arguments of `inference.render`.
    crop: whether the image has the region's size, or the full frame's with nothing around it.
    view_layer: its name.
    frame: the scene's frame number.
    warnings: what is left out or approximated, naming each object.
    """

    volumes: List[Tuple[Volume, Medium]] = field(default_factory=list)
    suns: List[Sun] = field(default_factory=list)
    camera: Camera = None
    crop: bool = True
    view_layer: str = "ViewLayer"
    frame: int = 0
    warnings: List[str] = field(default_factory=list)


def read_scene(depsgraph) -> SceneDescription:
    """Read everything that a render needs; bpy is not needed afterwards.

    Raises SceneError, saying what to add or change, where the scene cannot be rendered.
    """
    require_evaluated(depsgraph)
    scene = depsgraph.scene
    camera, warnings = read_camera(depsgraph)
    description = SceneDescription(
        camera=camera, crop=scene.render.use_crop_to_border,
        view_layer=depsgraph.view_layer.name, frame=scene.frame_current, warnings=warnings,
    )
    for shown in shown_objects(depsgraph):
        _add(description, shown)
    description.warnings += world_warnings(scene.world)
    if not description.volumes:
        raise SceneError("the scene shows no Volume object; add one (Add > Volume > Import OpenVDB)")
    if not description.suns:
        raise SceneError("the scene shows no sun; add one (Add > Light > Sun)")
    return description


def _add(description: SceneDescription, shown) -> None:
    kind = shown.object.type
    if kind == 'VOLUME':
        if not shown.object.visible_camera:
            description.warnings.append(f"Volume object \"{shown.name}\" is hidden from the camera and left out")
            return
        if outside_sequence(shown.object):
            description.warnings.append(
                f"Volume object \"{shown.name}\" has no file for frame {description.frame} and is left out")
            return
        volume, medium, warnings = read_volume(shown)
        description.volumes.append((volume, medium))
        description.warnings += warnings
    elif kind == 'LIGHT' and shown.object.data.type == 'SUN':
        # Cycles' ray visibility of a lamp: without it the sun lights surfaces only.
        if not shown.object.visible_volume_scatter:
            description.warnings.append(f"sun \"{shown.name}\" is hidden from volume scattering and left out")
            return
        sun, warnings = read_sun(shown)
        description.suns.append(sun)
        description.warnings += warnings
    elif kind == 'LIGHT':
        lamp = shown.object.data.type.lower()
        description.warnings.append(f"light \"{shown.name}\" is a {lamp} light and not rendered; only suns are")
    elif kind in SURFACES:
        description.warnings.append(f"{kind.lower()} object \"{shown.name}\" is a surface and not rendered")
