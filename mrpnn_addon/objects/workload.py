# SPDX-License-Identifier: GPL-3.0-or-later
"""How much work a render has, estimated from boxes around its volumes; imports no bpy."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...inference.marching.ray_steps import MIN_VOXELS, STEP_GROWTH, STEP_THICKNESS, STEPS_PER_EDGE
from ...inference.numerics.intersection import box_interval
from ...inference.numerics.small_matmul import affine_inverse
from ...inference.scene import Camera
from ...inference.scene.camera_rays import image_rays, windows_around

# Fine steps per one that optical thickness asks for: cutting halves, and looks at blocks before it cuts them.
FINE_STEPS = 2.5
# Mean density along a ray, as a share of the peak.
FILLED = 0.1
# Sample rays along each image axis.
RAYS = 48


@dataclass
class Box:
    """Bounding box of one volume.

    name: of its object. matrix: (4, 4), box to world. low, high: (3,), its corners. voxel: edge of a voxel, world
    units. thickness: largest optical thickness of a voxel. cells: voxels along the longest edge. filled: share of
    voxels that are not 0; None before the volume is read. refined: voxels along an edge of one that the file has, which
    the renderer refines.
    """

    name: str
    matrix: np.ndarray
    low: np.ndarray
    high: np.ndarray
    voxel: float
    thickness: float
    cells: float
    filled: float | None = None
    refined: int = 1


@dataclass
class Workload:
    """Work of a render, estimated from bounding boxes.

    names: of the volumes. window: pixels around their boxes. pixels: those in the boxes. steps: coarse ray march steps.
    fine: those that cutting adds. opacity: mean square root of the pixels' opacity, estimated. thickness: optical
    thickness of a voxel. volumes, lights, samples: their numbers. groups: of volumes that overlap. channels: colour
    channels marched separately. filled: share of voxels that are not 0; None where some volume has not been read.
    lamps, worlds: how many of the lights are lamps, and the World. surfaces: whether there are any. cells: voxels along
    the longest edge of each box. sky: seconds in which Cycles renders the World.
    """

    names: frozenset[str] = frozenset()
    window: int = 0
    pixels: float = 0.0
    steps: float = 0.0
    fine: float = 0.0
    opacity: float = 1.0
    thickness: float = 0.0
    volumes: int = 0
    groups: int = 0
    lights: int = 0
    samples: int = 1
    channels: int = 1
    filled: float | None = None
    lamps: int = 0
    worlds: int = 0
    surfaces: bool = False
    cells: tuple[float, ...] = ()
    sky: float = 0.0


def estimate_workload(
    boxes: list[Box],
    camera: Camera,
    lights: int,
    samples: int,
    channels: int = 1,
    **others: Any,
) -> Workload:
    """The work of a render; boxes may overlap. others: further fields of the Workload."""
    covered = pixels_around(boxes, camera)
    found = Workload(
        frozenset(box.name for box in boxes),
        int(covered.sum()),
        volumes=len(boxes),
        groups=count_groups(boxes),
        lights=lights,
        samples=samples,
        channels=channels,
        cells=tuple(box.cells for box in boxes),
        **others,
    )
    if not found.window:
        return found
    x0, y0 = camera.window[:2]
    across, down = (np.flatnonzero(covered.any(axis=axis)) for axis in (0, 1))
    left, right, top, bottom = across[0] + x0, across[-1] + 1 + x0, down[0] + y0, down[-1] + 1 + y0
    columns, rows = min(right - left, RAYS), min(bottom - top, RAYS)
    x, y = np.meshgrid(
        left + (np.arange(columns) + 0.5) * (right - left) / columns,
        top + (np.arange(rows) + 0.5) * (bottom - top) / rows,
    )
    origins, directions, cosine = image_rays(camera, x.ravel(), y.ravel())
    near, far, thickness = _intervals(boxes, origins, directions, camera.clip[0] / cosine, camera.clip[1] / cosine)
    hit = near < far
    share = (right - left) * (bottom - top) / len(hit)
    found.pixels = min(float(hit.sum()) * share, float(found.window))
    filled = [box.filled for box in boxes if box.filled is not None]
    found.filled = float(np.mean(filled)) if len(filled) == len(boxes) else None
    found.thickness = sum(box.thickness for box in boxes)
    steps_per_voxel = max(1.0, STEPS_PER_EDGE / max(max(box.cells for box in boxes), 1.0))
    voxels = np.maximum((far - near)[hit] / min(box.voxel for box in boxes), MIN_VOXELS)
    found.steps = float(np.ceil(voxels * steps_per_voxel).sum()) * share
    if found.thickness / steps_per_voxel > STEP_THICKNESS:
        # Steps of a thickness that grows with the optical depth in front.
        fine = STEP_GROWTH / STEP_THICKNESS * -np.expm1(-FILLED * thickness[hit] / STEP_GROWTH)
        found.fine = FINE_STEPS * float(fine.sum()) * share
    if hit.any():
        found.opacity = float(np.sqrt(-np.expm1(-FILLED * thickness[hit])).mean())
    return found


def pixels_around(boxes: list[Box], camera: Camera) -> np.ndarray:
    """bool (H, W): pixels of the camera's window that may show a box, and their neighbours."""
    x0, y0, x1, y1 = camera.window
    covered = np.zeros((y1 - y0, x1 - x0), bool)
    for left, top, right, bottom in windows_around(camera, np.array([corners(box) for box in boxes]).reshape(-1, 8, 3)):
        covered[top - y0 : bottom - y0, left - x0 : right - x0] = True
    return covered


def count_groups(boxes: list[Box]) -> int:
    """How many groups of boxes there are that overlap, in the world's axes."""
    around = np.stack([corners(box) for box in boxes]) if boxes else np.empty((0, 8, 3))
    low, high = around.min(axis=1), around.max(axis=1)
    joined = np.all((low[:, None] < high) & (low < high[:, None]), axis=2)
    # Each product doubles the number of boxes that a chain may have.
    for _ in range(len(boxes).bit_length()):
        joined = joined.astype(np.float32) @ joined > 0.0
    return len(np.unique(joined, axis=0))


def corners(box: Box) -> np.ndarray:
    """(8, 3), in world space."""
    ends = np.array(np.meshgrid(*zip(box.low, box.high), indexing="ij")).reshape(3, -1)
    return (box.matrix[:3, :3] @ ends + box.matrix[:3, 3:]).T


def _intervals(
    boxes: list[Box], origins: np.ndarray, directions: np.ndarray, clip_near: np.ndarray, clip_far: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances (N,) where rays enter the first box and leave the last, and optical thickness (N,) at peak density."""
    near, far = np.full(len(origins), np.inf), np.full(len(origins), -np.inf)
    thickness = np.zeros(len(origins))
    for box in boxes:
        if not np.linalg.det(box.matrix):
            continue
        inverse = affine_inverse(box.matrix)
        start = origins @ inverse[:3, :3].T + inverse[:3, 3]
        first, last = box_interval(start, directions @ inverse[:3, :3].T, box.low, box.high)
        first, last = np.maximum(first, clip_near), np.minimum(last, clip_far)
        met = first < last
        near[met], far[met] = np.minimum(near, first)[met], np.maximum(far, last)[met]
        thickness[met] += box.thickness * (last - first)[met] / box.voxel
    return near, far, thickness
