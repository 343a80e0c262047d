# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera of light maps: the scene's own, or one that frames the volumes of all frames."""

from collections.abc import Sequence
from dataclasses import replace

import bpy
import numpy as np

from ...inference.scene import Camera
from ..nodes.material import shows_volume
from ..objects.placement import placement_problem
from ..objects.visibility import hidden_from_camera, visible_objects
from ..volumes.reader import why_empty

# Free space around the volumes, of their size.
MARGIN = 0.02


def visible_corners(depsgraph: "bpy.types.Depsgraph") -> np.ndarray:
    """The corners (N, 3), in the world, of the bounding boxes of the volumes that a render shows in this frame."""
    corners = [np.zeros((0, 3))]
    for shown in visible_objects(depsgraph):
        unseen = not shows_volume(shown.object) or hidden_from_camera(shown, depsgraph.view_layer)
        if not unseen and not placement_problem(shown.matrix) and not why_empty(shown):
            corners.append(np.array(shown.object.bound_box, float) @ shown.matrix[:3, :3].T + shown.matrix[:3, 3])
    return np.concatenate(corners)


def framing(camera: Camera, corners: np.ndarray) -> Camera:
    """An orthographic camera that looks as another one does and sees all corners (N, 3)."""
    axes = camera.world_matrix[:3, :3]
    seen = corners @ axes
    low, high = seen.min(axis=0), seen.max(axis=0)
    matrix = np.eye(4)
    matrix[:3, :3] = axes
    extent = max(float((high - low)[:2].max()), 1e-6) * (1.0 + MARGIN)
    matrix[:3, 3] = axes @ [*(low[:2] + high[:2]) / 2.0, high[2] + extent]
    return Camera(matrix, projection="orthographic", ortho_scale=extent)


def sized(camera: Camera, edge: int) -> Camera:
    """The same camera with a square picture of so many pixels along its edges, as wide as before."""
    return replace(camera, resolution=(edge, edge), region=None)


def spread(frames: Sequence[int], count: int) -> list[int]:
    """At most so many of the frames, spread evenly from the first to the last."""
    if len(frames) <= count:
        return list(frames)
    return [frames[round(place)] for place in np.linspace(0, len(frames) - 1, count)]
