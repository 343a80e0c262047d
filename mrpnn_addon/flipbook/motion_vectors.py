# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion vectors: where in a tile the smoke of each pixel is in the next one. Imports no bpy."""

from collections.abc import Sequence

import numpy as np

from ...inference.grids.bound_medium import Flow
from ...inference.grids.grid import Grid
from ...inference.numerics.small_matmul import inverse
from ...inference.scene import Camera, Medium, Volume
from ...inference.scene.camera_rays import camera_rays, seen_at

# Added to the density of all voxels, so that those around a place count alike where all of them are empty.
LEAST_DENSITY = 1e-20


def motion_vectors(
    camera: Camera, distance: np.ndarray, volumes: Sequence[tuple[Volume, Medium]], frames: int
) -> np.ndarray | None:
    """Pixels to the right and up, float32 (H, W, 2), that smoke moves in some frames; None without any velocity.

    distance: float32 (H, W), along each ray, of the smoke that the pixel stands for; infinite where there is none.
    volumes: whose velocities last until the next frame. The velocities of volumes that overlap count by extinction.
    """
    if all(volume.velocity is None for volume, _ in volumes):
        return None
    shown = np.isfinite(distance.ravel())
    origins, directions, *_ = (values[shown] for values in camera_rays(camera))
    places = origins + directions * distance.ravel()[shown, None].astype(np.float64)
    moved, extinction = np.zeros_like(places), np.full(len(places), 1e-30)
    for volume, medium in volumes:
        grid = Grid(volume)
        weight = float(medium.sigma_t.mean()) * grid.sample_density(grid.index(places).T.astype(np.float32))
        extinction += weight
        if volume.velocity is not None:
            start, end = volume.velocity.times
            moved += weight[:, None] * _velocities(volume, grid, places) * ((end - start) * frames)
    moved /= extinction[:, None]
    steps = np.nan_to_num(seen_at(camera, places + moved) - seen_at(camera, places))
    found = np.zeros((distance.size, 2), np.float32)
    # Rows run downwards.
    found[shown] = np.stack([steps[0], -steps[1]], axis=1)
    return found.reshape(*distance.shape, 2)


def _velocities(volume: Volume, grid: Grid, places: np.ndarray) -> np.ndarray:
    """Velocities (N, 3) in the world of what a volume holds at places (N, 3).

    Voxels around a place count by density. Those of empty voxels mean nothing: Blender holds other ones when it has
    simulated a frame than when it has read the frame from the domain's cache.
    """
    assert volume.velocity is not None
    flow = Flow(volume.velocity, Flow.grids_of(volume.velocity), np.zeros(1))
    world_from_index = volume.velocity.world_from_index
    index = (places - world_from_index[:3, 3]) @ inverse(world_from_index[:3, :3]).T
    first = np.floor(index)
    found, amount = np.zeros_like(places), np.zeros((len(places), 1))
    for corner in np.ndindex(2, 2, 2):
        at = (first + corner) @ world_from_index[:3, :3].T + world_from_index[:3, 3]
        share = np.abs(1.0 - np.array(corner) - (index - first)).prod(axis=1)
        density = grid.sample_density(grid.index(at).T.astype(np.float32))
        weight = (share * (density + LEAST_DENSITY))[:, None]
        found += weight * flow.velocities(at, np.zeros(len(at), int))
        amount += weight
    return found / amount
