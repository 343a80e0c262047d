# SPDX-License-Identifier: GPL-3.0-or-later
"""How finely light is resolved in volumes that cover few pixels."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..models.abilities import abilities
from ..scene.camera import Camera
from ..scene.camera_rays import pixel_size, windows_around
from ..scene.description import Medium, Volume
from ..scene.settings import Settings
from ..scene.sparse_grid import SparseGrid
from .resolution import LEVEL0_CELLS, TRANSPORT_CELLS, Coarser, refinement

#: Largest edges in pixels, and optical thicknesses where matter is, of cells of the coarse transport that are 2 and 4
#: times as large as usual: the light of few cells errs wherever it is seen.
LARGER_CELLS = (1.25, 0.6), (0.5, 0.3)
#: The same where albedos vary, which larger cells mix.
LARGER_COLOURED_CELLS = ((0.25, 0.3),)
#: Largest optical thickness, at the largest density, of cells of level 1 of the density pyramid, up to which networks
#: read none finer in scenes of several groups.
THIN_CELL = 0.8
#: Largest edge in pixels of cells of the usual size, in scenes of several groups, up to which light that varies slowly
#: is told once per ray. A group alone takes little time where its cells are so small.
SLOW_CELLS = 2.0
#: The same of larger voxels of shadows, which blur the surfaces of dense media; and octaves by which they are larger.
LARGER_VOXELS, MOST_COARSER_VOXELS = (0.5, 0.4), 2
# Volumes with their media.
Members = Sequence[tuple[Volume, Medium]]
# Whether each corner of a box is at the end of each axis.
_ENDS = np.array(list(itertools.product([False, True], repeat=3)))


def box_corners(volumes: Sequence[Volume]) -> np.ndarray:
    """Corners (V, 8, 3) of volumes' boxes in the world."""
    matrices, shapes = _placed(volumes)
    index = np.where(_ENDS, shapes[:, None] - 0.5, -0.5)
    return index @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3]


def smallest_pixels(camera: Camera, settings: Settings, corners: np.ndarray) -> np.ndarray:
    """Width (N,) of a pixel, in world units, where boxes around world corners (N, K, 3) are nearest; 0 from inside."""
    eye, width = camera.world_matrix[:3, 3], settings.detail_width or camera.resolution[0]
    nearest = np.linalg.norm(np.clip(eye, corners.min(axis=1), corners.max(axis=1)) - eye, axis=1)
    return pixel_size(camera, nearest) * camera.resolution[0] / width


def coarser_light(groups: Sequence[Members], lamps: bool, camera: Camera, settings: Settings) -> list[int]:
    """Octaves (G,) by which cells of the coarse transport are larger than usual, in groups that are one medium each.

    lamps: whether any shine, whose light the transport itself may be.
    """
    if lamps or "level_of_detail" not in settings.optimizations or not abilities(settings.model).every_light:
        return [0] * len(groups)
    if not groups:
        return []
    starts = np.cumsum([0, *map(len, groups)])[:-1]
    cells, pixels = _cells(groups, camera, settings)
    filled = [medium.sigma_t.max() * volume.filled for members in groups for volume, medium in members]
    depths = cells * np.add.reduceat(filled, starts)
    varies = np.array([any(volume.scattering is not None for volume, _ in members) for members in groups])
    octaves = np.zeros(len(groups), int)
    for kinds, groups_of_kind in ((LARGER_CELLS, ~varies), (LARGER_COLOURED_CELLS, varies)):
        for n, (most, depth) in enumerate(kinds, 1):
            limits = settings.tolerance * most * pixels, settings.tolerance * depth
            small = (cells * 2**n <= limits[0]) & (depths * 2**n <= limits[1])
            octaves += small & groups_of_kind
    return octaves.tolist()


def coarser_groups(groups: Sequence[Members], lamps: bool, camera: Camera, settings: Settings) -> list[Coarser]:
    """How finely each group (G,) is resolved; lamps: as for `coarser_light`.

    The finest level of the density takes most of a group's memory: where there are several, thin ones do without.
    """
    octaves, density = coarser_light(groups, lamps, camera, settings), [0] * len(groups)
    detail = "level_of_detail" in settings.optimizations and abilities(settings.model).every_light
    if detail and not lamps and len(groups) > 1:
        starts = np.cumsum([0, *map(len, groups)])[:-1]
        peaks = np.add.reduceat([_peak(*pair) for members in groups for pair in members], starts)
        cells = _cells(groups, camera, settings)[0] * TRANSPORT_CELLS / (LEVEL0_CELLS >> 1)
        density = (peaks * cells <= settings.tolerance * THIN_CELL).astype(int).tolist()
    return [Coarser(transport=n, density=m) for n, m in zip(octaves, density)]


def seen_groups(groups: Sequence[Members], camera: Camera, settings: Settings) -> list[bool]:
    """Whether the picture may show a volume of each group (G,): what the others scatter reaches no pixel.

    With a lens or a shutter, all count as seen.
    """
    if not groups or camera.lens or camera.shutter or "level_of_detail" not in settings.optimizations:
        return [True] * len(groups)
    windows = windows_around(camera, box_corners([volume for members in groups for volume, _ in members]))
    seen = (windows[:, 2:] > windows[:, :2]).all(axis=1)
    found: list[bool] = np.logical_or.reduceat(seen, np.cumsum([0, *map(len, groups)])[:-1]).tolist()
    return found


def once_per_ray(groups: Sequence[Members], coarser: Sequence[int], camera: Camera, settings: Settings) -> list[bool]:
    """Whether light that varies slowly is told once per ray in each group, instead of at each depth sample.

    coarser: of `coarser_light`.
    """
    if len(groups) < 2 or "level_of_detail" not in settings.optimizations:
        return [octaves > 0 for octaves in coarser]
    cells, pixels = _cells(groups, camera, settings)
    return (cells <= settings.tolerance * SLOW_CELLS * pixels).tolist()


def _cells(groups: Sequence[Members], camera: Camera, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Edges (G,) of cells of the coarse transport of usual size, and of the smallest pixels, in world units."""
    volumes, starts = [volume for members in groups for volume, _ in members], np.cumsum([0, *map(len, groups)])[:-1]
    boxes = box_corners(volumes)
    low, high = np.minimum.reduceat(boxes.min(axis=1), starts), np.maximum.reduceat(boxes.max(axis=1), starts)
    alone = np.array([len(members) == 1 for members in groups])
    edges = np.where(alone, _edges(volumes).max(axis=1)[starts], (high - low).max(axis=1))
    return edges / TRANSPORT_CELLS, smallest_pixels(camera, settings, np.stack([low, high], axis=1))


def coarser_shadows(volumes: Members, camera: Camera, settings: Settings) -> list[int]:
    """Octaves (V,) by which voxels of volumes' shadows are larger than those of their grids."""
    if "level_of_detail" not in settings.optimizations or not volumes:
        return [0] * len(volumes)
    placed, (most, depth) = [volume for volume, _ in volumes], LARGER_VOXELS
    finer = [1 if isinstance(volume.density, SparseGrid) else refinement(volume.density.shape) for volume in placed]
    voxels = _edges(placed) / (_placed(placed)[1] * np.array(finer)[:, None])
    peaks = np.array([_peak(*pair) for pair in volumes])
    pixels = smallest_pixels(camera, settings, box_corners(placed))
    times = np.minimum(most * pixels / voxels.min(axis=1), depth / np.maximum(voxels.max(axis=1) * peaks, 1e-30))
    return np.clip(np.floor(np.log2(np.maximum(times, 1.0))), 0, MOST_COARSER_VOXELS).astype(int).tolist()


def without_detail(settings: Settings) -> Settings:
    """Settings for where no picture tells how many pixels a volume covers."""
    return replace(settings, optimizations=settings.optimizations - {"level_of_detail"})


def _peak(volume: Volume, medium: Medium) -> float:
    """Largest extinction coefficient of a volume."""
    return float(medium.sigma_t.max()) * volume.peak


def _placed(volumes: Sequence[Volume]) -> tuple[np.ndarray, np.ndarray]:
    """World from indices (V, 4, 4) and voxels (V, 3) of volumes."""
    matrices = np.array([volume.world_from_index for volume in volumes]).reshape(-1, 4, 4)
    return matrices, np.array([volume.density.shape for volume in volumes], np.float64).reshape(-1, 3)


def _edges(volumes: Sequence[Volume]) -> np.ndarray:
    """Of volumes' boxes (V, 3), in world units."""
    matrices, shapes = _placed(volumes)
    return np.linalg.norm(matrices[:, :3, :3], axis=1) * shapes
