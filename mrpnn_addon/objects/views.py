# SPDX-License-Identifier: GPL-3.0-or-later
"""The views of stereoscopic and multi-view scenes: where each eye of a camera is, and which camera each view has."""

import math
import os
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...inference.scene import Camera
from ...inference.scene.camera import SphericalEye

#: The eyes of *Stereo 3D*, and the side on which they are.
SIDES = {"left": -1.0, "right": 1.0}


@dataclass(frozen=True)
class View:
    """name: Blender's, such as "left"; "" where a scene has but one. suffix: of its files and pictures, such as "_L".
    camera: seen by it.
    """

    name: str
    suffix: str
    camera: Camera


def wanted_views(render: "bpy.types.RenderSettings") -> "list[bpy.types.SceneRenderView]":
    """The views that a scene renders; none where *Stereoscopy* is off."""
    if not render.use_multiview:
        return []
    return [view for view in render.views if view.use and (not _is_stereo(render) or view.name in SIDES)]


def view_path(path: str, suffix: str) -> str:
    """The path of a view's file, as Blender names it: the suffix before the extension."""
    start, extension = os.path.splitext(path)
    return f"{start}{suffix}{extension}"


def view_paths(path: str, render: "bpy.types.RenderSettings") -> list[str]:
    """The files of a picture, for `view_path`; pictures other than OpenEXR have one for each view."""
    if in_one_file(render) and path.lower().endswith(".exr"):
        return [path]
    return [view_path(path, view.file_suffix) for view in wanted_views(render)] or [path]


def in_one_file(render: "bpy.types.RenderSettings") -> bool:
    """Whether an OpenEXR file holds all views: *Views Format* is *Multi-View*."""
    return render.use_multiview and render.image_settings.views_format == "MULTIVIEW"


def view_camera(scene: "bpy.types.Scene", view: "bpy.types.SceneRenderView | None") -> "bpy.types.Object":
    """The camera of a view: with *Multi-View* the one named as the active camera, with the view's suffix."""
    camera = scene.camera
    if view is None or _is_stereo(scene.render):
        return camera
    endings = [one.camera_suffix for one in scene.render.views if camera.name.endswith(one.camera_suffix)]
    if not endings:
        return camera
    stem = camera.name.removesuffix(max(endings, key=len))
    return scene.objects.get(stem + view.camera_suffix) or camera


@dataclass(frozen=True)
class Eye:
    """placement: float64 (4, 4), the eye to the camera without scale. shift: to add to the lens' horizontal shift, in
    units of its sensor. spherical: how rays of a panorama start; the eye is then where the camera is.
    """

    placement: np.ndarray
    shift: float = 0.0
    spherical: SphericalEye | None = None


def eye_of(lens: Any, scene: "bpy.types.Scene", view: "bpy.types.SceneRenderView | None") -> Eye:
    """A view's eye of a camera with the data `lens`.

    Off-axis eyes look in parallel through windows that meet at the convergence plane; eyes that toe in turn to its
    middle, about their pivot.
    """
    placement = np.eye(4)
    if view is None or not _is_stereo(scene.render):
        return Eye(placement)
    stereo, side = lens.stereo, SIDES[view.name]
    distance, apart = stereo.convergence_distance, stereo.interocular_distance
    if stereo.use_spherical_stereo and lens.type == "PANO":
        merge = (stereo.pole_merge_angle_from, stereo.pole_merge_angle_to) if stereo.use_pole_merge else None
        converges = stereo.convergence_mode != "PARALLEL"
        return Eye(placement, 0.0, SphericalEye(side * apart / 2.0, distance if converges else math.inf, merge))
    # The pivot is an eye that stays where the camera is, or the middle.
    share = {"CENTER": 0.5, view.name.upper(): 0.0}.get(stereo.pivot, 1.0)
    offset, shift = np.array([side * share * apart, 0.0, 0.0]), 0.0
    if stereo.convergence_mode == "OFFAXIS":
        shift = -side * share * apart / lens.sensor_width * lens.lens / distance
    elif stereo.convergence_mode == "TOE":
        angle = side * share * 2.0 * math.atan(0.5 * apart / distance)
        placement[:3, :3] = _turned(angle)
        if share == 1.0:
            offset = _turned(0.5 * angle) @ offset
    placement[:3, 3] = offset
    return Eye(placement, shift)


def stereo_warnings(lens: Any, scene: "bpy.types.Scene", where: str) -> list[str]:
    """Warnings about settings of a camera's stereoscopy that have no effect."""
    if not (wanted_views(scene.render) and _is_stereo(scene.render) and lens.stereo.use_spherical_stereo):
        return []
    if lens.type == "PERSP":
        return [f"{where}: Spherical Stereo is rendered for panoramas only; choose another type, or turn it off"]
    return []


def _is_stereo(render: "bpy.types.RenderSettings") -> bool:
    return render.views_format == "STEREO_3D"


def _turned(angle: float) -> np.ndarray:
    """float64 (3, 3): to the left, about the camera's vertical axis."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
