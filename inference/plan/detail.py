# SPDX-License-Identifier: GPL-3.0-or-later
"""How finely light is resolved in volumes that cover few pixels."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..models.abilities import abilities
from ..scene.camera import Camera
from ..scene.camera_rays import pixel_size
from ..scene.description import Medium, Volume
from ..scene.settings import Settings
from ..scene.sparse_grid import SparseGrid
from .resolution import TRANSPORT_CELLS, refinement

#: Largest edges in pixels, and optical thicknesses, of cells of the coarse transport that are 2 and 4 times as large as
#: usual: the light of few cells errs wherever it is seen.
LARGER_CELLS = (1.25, 8.0), (0.5, 4.0)
#: The same where albedos vary, which larger cells mix.
LARGER_COLOURED_CELLS = ((0.25, 2.0),)
#: The same of larger voxels of shadows, which blur the surfaces of dense media; and octaves by which they are larger.
LARGER_VOXELS, MOST_COARSER_VOXELS = (0.5, 0.4), 2


def box_corners(volume: Volume) -> np.ndarray:
    """Corners (8, 3) of a volume's box in the world."""
    ends = [(-0.5, n - 0.5) for n in volume.density.shape]
    index = np.array(list(itertools.product(*ends)))
    return index @ volume.world_from_index[:3, :3].T + volume.world_from_index[:3, 3]


def smallest_pixel(camera: Camera, settings: Settings, corners: np.ndarray) -> float:
    """Width of a pixel, in world units, where the box around world corners (N, 3) is nearest; 0 from inside of it."""
    eye, width = camera.world_matrix[:3, 3], settings.detail_width or camera.resolution[0]
    nearest = np.linalg.norm(np.clip(eye, corners.min(axis=0), corners.max(axis=0)) - eye)
    return float(pixel_size(camera, np.array([nearest]))[0]) * camera.resolution[0] / width


def coarser_light(members: Sequence[tuple[Volume, Medium]], lamps: bool, camera: Camera, settings: Settings) -> int:
    """Octaves by which cells of the coarse transport are larger than usual in volumes that become one medium.

    lamps: whether any shine, whose light the transport itself may be.
    """
    if lamps or "level_of_detail" not in settings.optimizations or not abilities(settings.model).every_light:
        return 0
    corners = np.concatenate([box_corners(volume) for volume, _ in members])
    edge = max(_edges(members[0][0])) if len(members) == 1 else float(np.ptp(corners, axis=0).max())
    cell, pixel = edge / TRANSPORT_CELLS, smallest_pixel(camera, settings, corners)
    depth = cell * sum(_peak(*pair) for pair in members)
    kinds = LARGER_COLOURED_CELLS if any(volume.scattering is not None for volume, _ in members) else LARGER_CELLS
    return sum(
        cell * 2**n <= settings.tolerance * pixels * pixel and depth * 2**n <= most
        for n, (pixels, most) in enumerate(kinds, 1)
    )


def coarser_shadows(volume: Volume, medium: Medium, camera: Camera, settings: Settings) -> int:
    """Octaves by which voxels of a volume's shadows are larger than those of its grid."""
    if "level_of_detail" not in settings.optimizations:
        return 0
    shape, (pixels, most) = volume.density.shape, LARGER_VOXELS
    finer = 1 if isinstance(volume.density, SparseGrid) else refinement(shape)
    voxels = [edge / (n * finer) for edge, n in zip(_edges(volume), shape)]
    pixel = smallest_pixel(camera, settings, box_corners(volume))
    times = min(pixels * pixel / min(voxels), most / max(max(voxels) * _peak(volume, medium), 1e-30))
    return int(np.clip(np.floor(np.log2(max(times, 1.0))), 0, MOST_COARSER_VOXELS))


def without_detail(settings: Settings) -> Settings:
    """Settings for where no picture tells how many pixels a volume covers."""
    return replace(settings, optimizations=settings.optimizations - {"level_of_detail"})


def _peak(volume: Volume, medium: Medium) -> float:
    """Largest extinction coefficient of a volume."""
    return float(medium.sigma_t.max()) * volume.peak


def _edges(volume: Volume) -> list[float]:
    """Of a volume's box, in world units."""
    return (np.linalg.norm(volume.world_from_index[:3, :3], axis=0) * volume.density.shape).tolist()
