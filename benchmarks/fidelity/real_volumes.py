# SPDX-License-Identifier: GPL-3.0-or-later
"""Real volumes as the path tracer takes them: cubic voxels, the largest density 1."""

import functools
import itertools
import pathlib

import numpy as np

from ..support.data import volume_file
from ..support.extension import extension
from .views import ANISOTROPIES, GREY, LIGHTS, View, ViewSpec, traced_view

#: File, grid, and whether its second axis points up. The plume is an extra.
FILES = {
    "openvdb-smoke": ("openvdb_smoke.vdb", "density", True),
    "smoke-wind": ("blender_smoke_wind.vdb", "density", False),
    "plume": ("plume/pbrt_plume_0065.vdb", "density", True),
    "dragon": ("dragon_rotated.vdb", "density", True),
    "torus": ("torus_max100.vdb", "voxel_fog_density", False),
}
SIGMA_HATS = (50.0, 100.0, 400.0)


@functools.lru_cache(1)
def real_density(name: str) -> np.ndarray:
    """float32 (n, n, n): the active voxels in the middle of a cube, a voxel of zeros around their longest side."""
    file, grid_name, y_up = FILES[name]
    openvdb = extension().mrpnn_addon.vdb.openvdb_module.load_openvdb()
    grid = openvdb.read(str(volume_file(file)), grid_name)
    low, high = grid.evalActiveVoxelBoundingBox()
    active = np.zeros(np.subtract(high, low) + 1, np.float32)
    grid.copyToArray(active, ijk=low)
    if y_up:
        active = active.swapaxes(1, 2)
    cells = max(active.shape) + 2
    density = np.zeros((cells,) * 3, np.float32)
    corner = [(cells - size) // 2 for size in active.shape]
    density[tuple(slice(first, first + size) for first, size in zip(corner, active.shape))] = active
    return np.maximum(density, 0.0) / density.max()


def real_views(size: int, samples: int, folder: pathlib.Path) -> tuple[list[View], list[pathlib.Path]]:
    """Every volume at every optical thickness, at the strongest and no anisotropy, in every light.

    size: pixels per edge; samples: paths per pixel in each half; folder: of references. Gives the views and the files
    of volumes that are absent, whose views are left out.
    """
    present = [volume for volume, (file, *_) in FILES.items() if volume_file(file).exists()]
    absent = [volume_file(file) for volume, (file, *_) in FILES.items() if volume not in present]
    facts = itertools.product(present, SIGMA_HATS, (ANISOTROPIES[0], ANISOTROPIES[-1]), LIGHTS)
    specs = [ViewSpec(volume, light, sigma_hat, GREY, g, size, samples) for volume, sigma_hat, g, light in facts]
    views = [
        traced_view(
            f"{spec.volume}-{spec.sigma_hat:g}-{spec.light}-g{spec.anisotropy:g}",
            spec,
            functools.partial(real_density, spec.volume),
            folder,
        )
        for spec in specs
    ]
    return views, absent
