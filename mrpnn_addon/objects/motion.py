# SPDX-License-Identifier: GPL-3.0-or-later
"""*Motion Blur*: when the shutter is open, and where cameras are then."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import bpy
import numpy as np

from ...inference.scene import Camera, SceneError, Shutter
from .camera import read_camera
from .views import view_camera

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


def read_shutters(
    depsgraph: "bpy.types.Depsgraph",
    views: "Sequence[bpy.types.SceneRenderView | None]",
    go_to: GoTo,
    check: Callable[[], None],
) -> list[Shutter | None]:
    """The shutters in which the cameras of views move; None for those that stand still. views: as for `read_camera`.

    The scene is back in its frame at the end, also after errors. check: called at each time; what it raises ends the
    reading. Raises as `read_camera`.
    """
    scene = depsgraph.scene
    # At another time, a marker may bind another one.
    cameras = [view_camera(scene, view).original for view in views]
    steps = [motion_steps(camera) for camera in cameras] if uses_motion_blur(depsgraph) else []
    if not any(steps):
        return [None] * len(views)
    times, kept = np.linspace(*shutter_interval(scene), max(steps)), (scene.frame_current, scene.frame_subframe)
    seen: list[list[Camera]] = []
    try:
        for time in times:
            check()
            go_to(math.floor(time), time - math.floor(time))
            seen.append([read_camera(depsgraph, view, camera)[0] for view, camera in zip(views, cameras)])
    finally:
        go_to(*kept)
    curve = shutter_curve(scene.render)
    # Those that have fewer steps are seen at every other time, every fourth, or fewer.
    return [
        _shutter([then[n] for then in seen[:: (len(times) - 1) // (count - 1)]], curve) if count else None
        for n, count in enumerate(steps)
    ]


def _shutter(cameras: Sequence[Camera], curve: tuple[float, ...]) -> Shutter | None:
    """The shutter of a camera at evenly spaced times."""
    matrices, fovs = [camera.world_matrix for camera in cameras], tuple(camera.fov for camera in cameras)
    moves = not all(np.allclose(matrix, matrices[0], STILL, STILL) for matrix in matrices)
    zooms = cameras[0].projection == "perspective" and np.ptp(fovs) > STILL
    return Shutter(np.array(matrices) if moves else (), fovs if zooms else (), curve) if moves or zooms else None


def shutter_interval(scene: "bpy.types.Scene") -> tuple[float, float]:
    """Frames at which the shutter opens and closes."""
    render: Any = scene.render
    # Cycles' own where the scene has none.
    position = getattr(render, "motion_blur_position", None) or scene.cycles.motion_blur_position
    opens = {"START": 0.0, "CENTER": -0.5, "END": -1.0}[position]
    frame, length = scene.frame_current + scene.frame_subframe, render.motion_blur_shutter
    return frame + opens * length, frame + (opens + 1.0) * length


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
