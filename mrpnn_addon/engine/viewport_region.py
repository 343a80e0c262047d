# SPDX-License-Identifier: GPL-3.0-or-later
"""The render region of a 3D viewport."""

from typing import Any

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d

# Left, bottom, right and top of a part, 0 to 1 from a region's lower left.
Part = tuple[float, float, float, float]
WHOLE: Part = (0.0, 0.0, 1.0, 1.0)


def part_pixels(part: Part, size: tuple[int, int]) -> tuple[int, int]:
    """Width and height in pixels of a part of a region of `size` pixels."""
    (left, bottom, right, top), (width, height) = part, size
    return round((right - left) * width), round((top - bottom) * height)


def pixel_size(scene: "bpy.types.Scene") -> int:
    """Edge in pixels of the screen of a pixel that Rendered shading renders, of *Pixel Size*, as in Cycles."""
    render: Any = scene.render
    if render.preview_pixel_size != "AUTO":
        return int(render.preview_pixel_size)
    system: Any = bpy.context.preferences.system
    return 2 if system.pixel_size > 1.5 else 1


def coarser(resolution: tuple[int, int], size: int) -> tuple[int, int]:
    """Width and height of a picture of some resolution whose pixels are `size` as large."""
    width, height = (max(round(pixels / size), 1) for pixels in resolution)
    return width, height


def render_region(context: "bpy.types.Context", scene: "bpy.types.Scene") -> Part | None:
    """The part of a viewport's region inside its render region, on whole pixels; None where it is empty.

    As in Cycles: in camera view the render's region within the camera's frame, otherwise the viewport's own.
    """
    view, render = context.region_data, scene.render
    space: Any = context.space_data
    part = WHOLE
    if view.view_perspective != "CAMERA":
        if space.use_render_border:
            part = (
                space.render_border_min_x,
                space.render_border_min_y,
                space.render_border_max_x,
                space.render_border_max_y,
            )
    elif render.use_border:
        frame = _camera_frame(context, scene)
        if frame is not None:
            (x0, y0), (x1, y1) = frame
            part = (
                x0 + render.border_min_x * (x1 - x0),
                y0 + render.border_min_y * (y1 - y0),
                x0 + render.border_max_x * (x1 - x0),
                y0 + render.border_max_y * (y1 - y0),
            )
    size = np.array((context.region.width, context.region.height) * 2)
    left, bottom, right, top = np.round(np.clip(part, 0.0, 1.0) * size) / size
    return (left, bottom, right, top) if left < right and bottom < top else None


def _camera_frame(context: "bpy.types.Context", scene: "bpy.types.Scene") -> tuple[np.ndarray, np.ndarray] | None:
    """Lower left and upper right corners of the camera's image, as fractions of the region; None without one."""
    space: Any = context.space_data
    camera: bpy.types.Object | None = space.camera if space.use_local_camera else scene.camera
    if camera is None or camera.type != "CAMERA":
        return None
    # Blender ignores the scale of a camera.
    matrix = camera.matrix_world.normalized()
    lens: Any = camera.data
    corners = [
        location_3d_to_region_2d(context.region, context.region_data, matrix @ corner)
        for corner in lens.view_frame(scene=scene)
    ]
    if None in corners:
        return None
    shares = np.array(corners) / (context.region.width, context.region.height)
    return shares.min(axis=0), shares.max(axis=0)
