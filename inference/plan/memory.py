# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimated peak memory of a render, on top of its input."""

from collections.abc import Sequence

import numpy as np

from ..numerics.small_matmul import inverse
from ..scene.description import Sun, Volume
from ..scene.lamps import Lamp
from ..scene.sparse_grid import SparseGrid
from .resolution import LEVEL0_CELLS, Coarser, refinement
from .sun_columns import column_bytes

# Columns and slices, along an edge, of the optical depths towards a lamp, at most.
LAMP_EDGE = 384
# Bytes of the lookup lattices and the coarse transport of the first volume, whatever its resolution.
FIELD_BYTES = 42 * LEVEL0_CELLS**3
# Bytes of what every further volume keeps of these, and of each light in it. Instances share them.
FURTHER_BYTES, LIGHT_BYTES = 8 * LEVEL0_CELLS**3, LEVEL0_CELLS**3
# Bytes of the lattices of environments' light in one volume, while they are solved for.
ENVIRONMENT_BYTES = 8 * LEVEL0_CELLS**3
# Bytes of those of each sky that the environments have in places, until these are joined.
SKY_BYTES = 3 * LEVEL0_CELLS**3
# Bytes per voxel of the grid itself, and of the optical depth towards each sun.
VOXEL_BYTES, VOXEL_SUN_BYTES = 16, 5
# Bytes per voxel of overlapping volumes merged into one medium.
MERGED_BYTES = 12
# Bytes per voxel of emission.
VOXEL_EMISSION_BYTES = 24
# Bytes per voxel of an albedo that varies, in each of its channels.
VOXEL_ALBEDO_BYTES = 8
# Bytes per block of a sparse grid's largest slab, and per block of the whole grid.
SLAB_BYTES, CELLS_BYTES = 3 * 4 * 512, 3 * 8
# Bytes per pixel of the framebuffer, per camera ray of a tile, and per depth sample of such a ray.
IMAGE_BYTES, RAY_BYTES, SAMPLE_BYTES = 76, 200, 50
# Bytes per depth sample and sun: the ray features (`marching.ray_features.COLUMNS`), twice; and per volume around it.
RAY_FEATURE_BYTES, HELD_BYTES = 2 * 4 * 7, 2 * 8


def grids_bytes(volumes: Sequence[tuple[Volume, bool]], suns: Sequence[Sun], coarser: Sequence[int]) -> int:
    """Bytes of the grids of volumes and of their optical depths towards the suns.

    volumes: each with whether it emits light. coarser: octaves by which voxels of its shadows are larger. Instances
    share their grids, and their depths where suns shine along the same direction in their voxels.
    """
    grids = {volume.voxels_key: _voxel_bytes(volume, emits) for volume, emits in volumes}
    depths: dict[tuple, int] = {}
    for (volume, _), octaves in zip(volumes, coarser):
        index_from_world = inverse(volume.world_from_index[:3, :3])
        for direction in [index_from_world @ sun.direction for sun in suns]:
            key = volume.voxels_key, direction.tobytes(), octaves
            if key not in depths:
                depths[key] = _depth_bytes(volume, direction) >> 3 * octaves
    return sum(grids.values()) + sum(depths.values())


def _voxel_bytes(volume: Volume, emits: bool) -> int:
    """Bytes of a volume's grid."""
    if not isinstance(volume.density, SparseGrid):
        voxel = VOXEL_BYTES + VOXEL_EMISSION_BYTES * emits + VOXEL_ALBEDO_BYTES * len(volume.scattering or ())
        return volume.density.size * refinement(volume.density.shape) ** 3 * voxel
    # One row of blocks as an array, and the cells that rays skip.
    blocks = volume.density.table.shape
    return SLAB_BYTES * blocks[1] * blocks[2] + CELLS_BYTES * volume.density.table.size


def _depth_bytes(volume: Volume, direction: np.ndarray) -> int:
    """Bytes of a volume's optical depths towards a sun; direction: (3,), in voxels per world unit."""
    if isinstance(volume.density, SparseGrid):
        return column_bytes(volume.density, direction)
    return volume.density.size * refinement(volume.density.shape) ** 3 * VOXEL_SUN_BYTES


def field_bytes(
    groups: Sequence[Sequence[Volume]], coarser: Sequence[Coarser], lights: int, from_everywhere: bool
) -> int:
    """Bytes of what networks read in groups of volumes.

    coarser: of each group. lights: how many there are besides light from everywhere.
    """
    shapes = {
        (group[0].voxels_key if len(group) == 1 else id(group), octaves.density)
        for group, octaves in zip(groups, coarser)
    }
    # Groups of several volumes are not compared.
    places = {}
    for group, octaves in zip(groups, coarser):
        alone = group[0].voxels_key, group[0].world_from_index[:3, :3].tobytes()
        places[alone if len(group) == 1 else id(group)] = octaves.transport
    environments = from_everywhere * ENVIRONMENT_BYTES * len(shapes)
    held = sorted((LIGHT_BYTES >> 3 * octaves for octaves in places.values()), reverse=True)
    fields = sorted(FURTHER_BYTES >> density for _, density in shapes)
    further = sum(fields[:-1]) + sum(held[1:]) * max(lights, 1)
    first = FIELD_BYTES >> 2 * min((octaves.density for octaves in coarser), default=0)
    return first + environments + further


def merged_bytes(volumes: Sequence[Volume], corners: np.ndarray) -> int:
    """Bytes of overlapping volumes that `merge` makes one of; corners: (V, 8, 3), of their boxes in the world."""
    voxels = [volume.world_from_index[:3, :3] / _refined(volume) for volume in volumes]
    finest = min(voxels, key=lambda voxel: float(np.linalg.norm(voxel, axis=0).min()))
    edges = np.ptp(corners.reshape(-1, 3) @ inverse(finest).T, axis=0) + 2.0
    return int(MERGED_BYTES * np.ceil(edges / max(edges.max() / LEVEL0_CELLS, 1.0)).prod())


def _refined(volume: Volume) -> int:
    """Factor by which the grid of a volume is refined along each axis."""
    return 1 if isinstance(volume.density, SparseGrid) else refinement(volume.density.shape)


def lamp_bytes(volume: Volume, lamps: list[Lamp]) -> int:
    """Bytes of the optical depths in a volume towards lamps, at most."""
    edge = min(max(volume.density.shape) * _refined(volume), LAMP_EDGE)
    # Three of six pyramids of a lamp in the middle are a cube of columns; those of several emitters have fewer. The
    # mean of their depths at voxels is another cube.
    return len(lamps) * 4 * 4 * edge**3


def ray_bytes(depth_samples: int, overlapping: int, suns: int) -> int:
    """Bytes of a camera ray while it is rendered; overlapping: volumes that it is in at once, at most."""
    return RAY_BYTES + (SAMPLE_BYTES + HELD_BYTES * overlapping + RAY_FEATURE_BYTES * suns) * depth_samples
