"""Real volumes of ../shared/volumes as the path tracer takes them: cubic voxels, the largest density 1."""

import functools
import itertools
import pathlib

import numpy as np

from ..support.extension import extension
from .views import ANISOTROPIES, GREY, LIGHTS, SHARED, traced_view

FOLDER = SHARED.parent / "volumes"
#: File, grid, and whether its second axis points up.
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
    grid = openvdb.read(str(FOLDER / file), grid_name)
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


def real_views(size: int, samples: int, cache: pathlib.Path) -> list:
    """Every volume at every density, at the strongest and no anisotropy, in every light; none where the folder is absent."""
    if not FOLDER.exists():
        return []
    facts = itertools.product(FILES, SIGMA_HATS, (ANISOTROPIES[0], ANISOTROPIES[-1]), LIGHTS)
    return [
        traced_view(
            f"{volume}-{sigma_hat:g}-{light}-g{anisotropy:g}", volume, functools.partial(real_density, volume), light,
            sigma_hat, GREY, anisotropy, size, samples, cache,
        )
        for volume, sigma_hat, anisotropy, light in facts
    ]
