# SPDX-License-Identifier: GPL-3.0-or-later
"""*Motion Blur*: when the shutter is open, and where cameras, volumes and surfaces are then."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...inference.scene import Camera, SceneError, Shutter
from ..nodes.material import SURFACES, shows_volume
from .camera import read_camera
from .deformation import Deformation
from .mesh_triangles import Mesh, read_mesh
from .views import view_camera
from .visibility import visible_objects

#: Goes to a frame and a subframe from 0 to 1, and evaluates the scene there.
GoTo = Callable[[int, float], None]
# Values of a shutter curve: as many as Cycles reads.
CURVE = 256
# Changes of transforms below this fraction of their size are rounding.
STILL = 1e-6


def uses_motion_blur(depsgraph: "bpy.types.Depsgraph") -> bool:
    """Whether a view layer is rendered with motion blur."""
    render: Any = depsgraph.scene.render
    layer = depsgraph.view_layer
    return render.use_motion_blur and getattr(layer, "use_motion_blur", True) and render.motion_blur_shutter > 0.0


@dataclass(frozen=True)
class FrameMotion:
    """What moves while the shutter is open.

    shutters: of the cameras of views; None where nothing moves. matrices: (S, 4, 4) of the volumes and surfaces that
    move, by the keys of `VisibleObject`. vertices: float32 (S, V, 3), in object space, of the surfaces that change
    their shape. fogs: of the volumes that do. frame: when the frame is, from 0 where the shutter opens to 1 where it
    closes.
    """

    shutters: list[Shutter | None]
    matrices: dict[tuple, np.ndarray]
    vertices: dict[tuple, np.ndarray]
    fogs: dict[tuple, Deformation]
    frame: float = 0.0


def read_motion(
    depsgraph: "bpy.types.Depsgraph",
    views: "Sequence[bpy.types.SceneRenderView | None]",
    go_to: GoTo,
    check: Callable[[], None],
    flows: bool = False,
) -> FrameMotion:
    """What moves in a frame. views: as for `read_camera`. flows: whether velocities carry what any volume holds.

    The scene is back in its frame at the end, also after errors. check: called at each time; what it raises ends the
    reading. Raises as `read_camera`.
    """
    scene = depsgraph.scene
    if not uses_motion_blur(depsgraph):
        return FrameMotion([None] * len(views), {}, {}, {})
    # At another time, a marker may bind another one.
    cameras = [view_camera(scene, view).original for view in views]
    steps, counts = [motion_steps(camera) for camera in cameras], {}
    shapes: dict[tuple, list[np.ndarray]] = {}
    fogs: dict[tuple, Mesh | None] = {}
    for shown in visible_objects(depsgraph):
        count = motion_steps(shown.object) if motion_steps(shown.host) else 0
        if count and (shows_volume(shown.object) or shown.object.type in SURFACES):
            counts[shown.key] = count
            if shown.object.type in SURFACES and _may_deform(shown.object):
                shapes[shown.key] = []
                if shows_volume(shown.object):
                    fogs[shown.key] = None
    most, kept = max([*steps, *counts.values()], default=0), (scene.frame_current, scene.frame_subframe)
    times = np.linspace(*shutter_interval(scene), most) if most else ()
    seen: list[list[Camera]] = []
    places: dict[tuple, list[np.ndarray]] = {key: [] for key, count in counts.items() if count}
    try:
        for time in times:
            check()
            go_to(math.floor(time), time - math.floor(time))
            seen.append([read_camera(depsgraph, view, camera)[0] for view, camera in zip(views, cameras)])
            for shown in visible_objects(depsgraph):
                if shown.key in places:
                    places[shown.key].append(shown.matrix)
                if shown.key in shapes:
                    mesh = read_mesh(shown.object)
                    shapes[shown.key].append(mesh.places)
                    if shown.key in fogs:
                        fogs[shown.key] = mesh
    finally:
        if most:
            go_to(*kept)
    # Those that have fewer steps are seen at every other time, every fourth, or fewer.
    every = {count: (most - 1) // (count - 1) for count in (*steps, *counts.values()) if count}
    moving, deformed, changing = {}, {}, {}
    for key, matrices in places.items():
        steps_seen = matrices[:: every[counts[key]]]
        # What is not there all the time stands still, as in Cycles.
        if len(matrices) == most and not all(np.allclose(matrix, steps_seen[0], STILL, STILL) for matrix in steps_seen):
            moving[key] = np.array(steps_seen)
    for key, vertices in shapes.items():
        steps_seen = vertices[:: every[counts[key]]]
        # Vertices that come and go stand still, as in Cycles.
        if len(vertices) == most and len({len(one) for one in steps_seen}) == 1:
            shape = np.array(steps_seen)
            if not shape.size or np.ptp(shape, axis=0).max() <= STILL * np.abs(shape).max():
                continue
            mesh_of_fog = fogs.get(key)
            if mesh_of_fog is not None and not (len(mesh_of_fog.numbers()) and np.isfinite(shape).all()):
                continue
            if mesh_of_fog is not None:
                changing[key] = Deformation(mesh_of_fog, shape)
            else:
                deformed[key], moving[key] = shape, np.array(places[key][:: every[counts[key]]])
    curve = shutter_curve(scene.render)
    shutters = [
        _shutter([then[n] for then in seen[:: every[count]]] if count else [], curve) for n, count in enumerate(steps)
    ]
    blurred = [shutter or (Shutter(curve=curve) if moving or changing or flows else None) for shutter in shutters]
    opens, closes = shutter_interval(scene)
    frame = (scene.frame_current + scene.frame_subframe - opens) / (closes - opens)
    return FrameMotion(blurred, moving, deformed, changing, frame)


def _may_deform(shown: "bpy.types.Object") -> bool:
    """Whether the shape of an object may change in time, and Cycles looks for that."""
    settings: Any = getattr(shown.original, "cycles", None)
    keys = getattr(shown.original.data, "shape_keys", None)
    animated = keys or shown.original.modifiers or getattr(shown.original.data, "animation_data", None)
    return bool(animated) and getattr(settings, "use_deform_motion", True)


def _shutter(cameras: Sequence[Camera], curve: tuple[float, ...]) -> Shutter | None:
    """The shutter of a camera at evenly spaced times; None where it stands still."""
    matrices, fovs = [camera.world_matrix for camera in cameras], tuple(camera.fov for camera in cameras)
    moves = not all(np.allclose(matrix, matrices[0], STILL, STILL) for matrix in matrices)
    zooms = bool(fovs) and cameras[0].projection == "perspective" and np.ptp(fovs) > STILL
    return Shutter(np.array(matrices) if moves else (), fovs if zooms else (), curve) if moves or zooms else None


def shutter_interval(scene: "bpy.types.Scene") -> tuple[float, float]:
    """Frames at which the shutter opens and closes."""
    render: Any = scene.render
    opens = {"START": 0.0, "CENTER": -0.5, "END": -1.0}[_position(render, scene)]
    frame, length = scene.frame_current + scene.frame_subframe, render.motion_blur_shutter
    return frame + opens * length, frame + (opens + 1.0) * length


def velocity_times(scene: "bpy.types.Scene", scale: float, per_second: bool) -> tuple[float, float]:
    """Times since the frame at which the shutter opens and closes, as Cycles multiplies velocities with them.

    Where velocities are not per second, the length of the shutter does not count, except that one which closes at the
    frame then opens late: as in Cycles.
    """
    render: Any = scene.render
    length, rate = render.motion_blur_shutter, render.fps / render.fps_base
    opens = {"START": 0.0, "CENTER": -0.5, "END": 1.0 - length}[_position(render, scene)]
    factor = scale * (length / rate if per_second else 1.0)
    return factor * opens, factor * (opens + 1.0)


def until_next_frame(scene: "bpy.types.Scene", scale: float, per_second: bool) -> tuple[float, float]:
    """Times since the frame of this one and of the next, as velocities are multiplied with them."""
    render: Any = scene.render
    return 0.0, scale * (render.fps_base / render.fps if per_second else 1.0)


def _position(render: Any, scene: Any) -> str:
    """Where the shutter lies about the frame; Cycles' own setting where the scene has none."""
    return getattr(render, "motion_blur_position", None) or scene.cycles.motion_blur_position


def shutter_curve(render: "bpy.types.RenderSettings") -> tuple[float, ...]:
    """The shutter curve, as of Shutter. Raises SceneError where it lets no light through."""
    mapping: Any = render.motion_blur_shutter_curve
    mapping.initialize()
    values = tuple(max(mapping.evaluate(mapping.curves[0], n / (CURVE - 1.0)), 0.0) for n in range(CURVE))
    if not max(values) > 0.0:
        raise SceneError("Motion Blur > Shutter Curve lets no light through; raise it, or switch motion blur off")
    return values if min(values) < max(values) else ()


def motion_steps(shown: "bpy.types.Object") -> int:
    """Times at which Cycles looks where an object is; 0 where its own *Motion Blur* is off."""
    settings: Any = getattr(shown.original, "cycles", None)
    if not getattr(settings, "use_motion_blur", True):
        return 0
    return 2 ** max(getattr(settings, "motion_steps", 1), 1) + 1
