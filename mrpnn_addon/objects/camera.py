# SPDX-License-Identifier: GPL-3.0-or-later
"""The active camera as a `Camera`."""

import math
from typing import Any, Literal

import bpy
import numpy as np

from ...inference.scene import Camera, Lens, SceneError
from .placement import placement_problem
from .views import View, eye_of, stereo_warnings, view_camera, wanted_views

PROJECTIONS: dict[str, Literal["perspective", "orthographic", "equirectangular"]] = {
    "PERSP": "perspective",
    "ORTHO": "orthographic",
    "PANO": "equirectangular",
}


def read_views(depsgraph: "bpy.types.Depsgraph") -> tuple[list[View], list[str]]:
    """The views that a scene renders, and warnings. One without a name where *Stereoscopy* is off. Raises as
    `read_camera`.
    """
    found, warnings = [], []
    for view in wanted_views(depsgraph.scene.render) or [None]:
        camera, noted = read_camera(depsgraph, view)
        found.append(View(view.name, view.file_suffix, camera) if view else View("", "", camera))
        warnings += [warning for warning in noted if warning not in warnings]
    return found, warnings


def read_camera(
    depsgraph: "bpy.types.Depsgraph",
    view: "bpy.types.SceneRenderView | None" = None,
    instead: "bpy.types.Object | None" = None,
) -> tuple[Camera, list[str]]:
    """The scene's active camera at the render resolution, and warnings.

    view: whose eye or camera it is; None for the active camera itself. instead: of the view's camera.

    The window comes from Blender's projection matrix, which includes lens, sensor fit, shift and resolution.

    Raises SceneError without a camera, where it is another object, for a panoramic camera that is not equirectangular,
    and for one of scale 0.
    """
    scene = depsgraph.scene
    if instead is None and scene.camera is None:
        raise SceneError("the scene has no active camera; add one (Add > Camera) and make it active")
    camera = (instead or view_camera(scene, view)).evaluated_get(depsgraph)
    lens: Any = camera.data
    if camera.type != "CAMERA":
        raise SceneError(
            f'the scene\'s camera is "{camera.name}", which is not a camera; choose one in the scene properties'
        )
    eye = eye_of(lens, scene, view)
    where = f'camera "{camera.name}"'
    panorama = _panorama(lens) if lens.type == "PANO" else None
    if lens.type not in PROJECTIONS or panorama not in (None, "EQUIRECTANGULAR"):
        owner, name = (panorama_settings(lens), "panorama_type") if panorama else (lens, "type")
        kind = owner.bl_rna.properties[name].enum_items[getattr(owner, name)].name
        raise SceneError(f"{where} is of type {kind}; only Perspective, Orthographic and Equirectangular are rendered")
    matrix = np.array(camera.matrix_world, dtype=np.float64)
    problem = placement_problem(matrix)
    if problem:
        raise SceneError(f"{where}: {problem}")
    if not np.linalg.norm(matrix[:3, :3], axis=0).all():
        raise SceneError(f"{where}: it has scale 0; set it to 1")
    render = scene.render
    width, height = (size * render.resolution_percentage // 100 for size in (render.resolution_x, render.resolution_y))
    if width < 1 or height < 1:
        raise SceneError(f"the render resolution is {width} x {height} pixels; raise it in the output properties")

    if lens.clip_start >= lens.clip_end:
        raise SceneError(f"{where}: its Clip Start is not below its Clip End, so it sees nothing")

    warnings = stereo_warnings(lens, scene, where)
    if panorama:
        return Camera(
            _orthonormal(matrix) @ eye.placement,
            projection="equirectangular",
            resolution=(width, height),
            longitude=_ends(lens, "longitude"),
            latitude=_ends(lens, "latitude"),
            clip=(lens.clip_start, lens.clip_end),
            region=_region(render, width, height),
            exposure=film_exposure(scene),
            eye=eye.spherical,
            lens=read_lens(camera, depsgraph),
        ), warnings
    across, down = render.pixel_aspect_x, render.pixel_aspect_y
    window = np.array(camera.calc_matrix_camera(depsgraph, x=width, y=height, scale_x=across, scale_y=down))
    perspective = lens.type == "PERSP"
    # Window coordinates are (P00 x + P02 z) / -z or P00 x + P03, from -1 to 1 across the image.
    half_width = 1.0 / window[0, 0]
    centre = window[:2, 2] if perspective else -window[:2, 3]
    # A lens' shift is in units of the side that its sensor fits.
    tallness = height * down / (width * across)
    fits_width = lens.sensor_fit == "HORIZONTAL" or lens.sensor_fit == "AUTO" and tallness <= 1.0
    shift = eye.shift * (1.0 if fits_width else tallness)
    return Camera(
        _orthonormal(matrix) @ eye.placement,
        projection=PROJECTIONS[lens.type],
        resolution=(width, height),
        fov=2.0 * math.atan(half_width),
        ortho_scale=2.0 * half_width,
        shift=(centre[0] / 2.0 + shift, centre[1] / 2.0 * tallness),
        pixel_aspect=down / across,
        clip=(lens.clip_start, lens.clip_end),
        region=_region(render, width, height),
        exposure=film_exposure(scene),
        lens=read_lens(camera, depsgraph),
    ), warnings


def read_lens(camera: "bpy.types.Object", depsgraph: "bpy.types.Depsgraph") -> Lens | None:
    """The thin lens of an evaluated camera, as in Cycles; None without *Depth of Field*."""
    lens: Any = camera.data
    dof = lens.dof
    if not dof.use_dof:
        return None
    matrix, focus = np.array(camera.matrix_world), dof.focus_distance
    if dof.focus_object is not None:
        target = dof.focus_object.evaluated_get(depsgraph)
        place = target.matrix_world
        if target.pose is not None and dof.focus_subtarget in target.pose.bones:
            place = place @ target.pose.bones[dof.focus_subtarget].matrix
        axis = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        focus = abs(float(axis @ (matrix[:3, 3] - np.array(place)[:3, 3])))
    diameter = (1.0 if lens.type == "ORTHO" else 1e-3 * lens.lens) / max(dof.aperture_fstop, 1e-5)
    # A camera that focuses on its own place sees nothing sharp, and rays need a direction.
    return Lens(
        radius=0.5 * diameter,
        focus=max(focus, 1e-6),
        blades=dof.aperture_blades,
        rotation=dof.aperture_rotation,
        ratio=dof.aperture_ratio,
    )


def film_exposure(scene: "bpy.types.Scene") -> float:
    """What Cycles multiplies radiance by: *Film > Exposure*. 1 while Cycles is disabled."""
    return getattr(getattr(scene, "cycles", None), "film_exposure", 1.0)


def panorama_settings(lens: "bpy.types.Camera") -> Any:
    """The data that holds a lens' panorama type; None where Cycles is disabled and keeps it."""
    # Before 4.3, panoramas are Cycles' own property.
    return lens if hasattr(lens, "panorama_type") else getattr(lens, "cycles", None)


def _panorama(lens: "bpy.types.Camera") -> str:
    return getattr(panorama_settings(lens), "panorama_type", lens.type)


def _ends(lens: "bpy.types.Camera", name: str) -> tuple[float, float]:
    settings = panorama_settings(lens)
    return getattr(settings, f"{name}_min"), getattr(settings, f"{name}_max")


def _orthonormal(matrix: np.ndarray) -> np.ndarray:
    """The matrix without scale: Blender ignores the scale of cameras."""
    matrix = matrix.copy()
    matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
    return matrix


def _region(render: "bpy.types.RenderSettings", width: int, height: int) -> tuple[int, int, int, int] | None:
    if not render.use_border:
        return None
    # Blender's border is a fraction from the lower left, rounded to whole pixels in single precision.
    x0, x1 = (int(np.float32(x) * np.float32(width)) for x in (render.border_min_x, render.border_max_x))
    y0, y1 = (height - int(np.float32(y) * np.float32(height)) for y in (render.border_max_y, render.border_min_y))
    if x0 >= x1 or y0 >= y1:
        raise SceneError("the render region holds no pixel; make it larger or turn it off")
    return x0, y0, x1, y1
