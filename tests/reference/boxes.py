# SPDX-License-Identifier: GPL-3.0-or-later
"""Where rays meet boxes, and how many steps these want."""

import numpy as np

from inference.marching.ray_steps import STEPS_PER_EDGE, Boxes, RayBatch
from inference.numerics.intersection import box_interval


def crossed(boxes: Boxes, rays: RayBatch, least: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances (R,) between which each ray meets any box, infinite and in the wrong order on a miss, and its steps."""
    at = np.einsum("vij,rj->rvi", boxes.linear, rays.origins) + boxes.offset
    slopes = np.einsum("vij,rj->rvi", boxes.linear, rays.directions)
    enter, leave = box_interval(at, slopes, boxes.low, boxes.high)
    enter, leave = np.maximum(enter, rays.near[:, None]), np.minimum(leave, rays.far[:, None])
    hit = enter < leave
    voxels = np.maximum(np.linalg.norm(slopes, axis=2) * (rays.far - rays.near)[:, None], least)
    steps = np.ceil(voxels * np.maximum(STEPS_PER_EDGE / boxes.shape.max(axis=1), 1.0))
    return (
        np.where(hit, enter, np.inf).min(axis=1, initial=np.inf),
        np.where(hit, leave, -np.inf).max(axis=1, initial=-np.inf),
        np.where(hit, steps, least).max(axis=1, initial=least),
    )
