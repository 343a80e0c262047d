# SPDX-License-Identifier: GPL-3.0-or-later
"""March rays through volumes whose contents are broken in every way, for compilers' checks to watch.

python -m tests.support.fuzz_march LIBRARY SECONDS [SEED]
"""

import ctypes
import sys
import time

import numpy as np

from inference.grids.sparse_columns import SparseColumns
from inference.kernels.library import Kernels
from inference.marching.compiled_march import CompiledMarch
from inference.marching.ray_steps import RayBatch
from inference.scene.sparse_grid import SparseGrid
from tests.support.marches import MarchScene, Recipe, random_scene

STRANGE = np.array([np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-45, -0.0, 2.0**31, -(2.0**31), 2.0**63, 0.5])


def random_recipe(random: np.random.Generator) -> Recipe:
    """A scene of any kind."""
    volumes = int(random.integers(1, 4))
    return Recipe(
        volumes=volumes,
        suns=int(random.integers(1, 4)),
        voxels=tuple(random.integers(1, 24, 3).tolist()),
        thickness=float(10.0 ** random.uniform(-3.0, 8.0)),
        sparse=random.random() < 0.5,
        shear=float(random.choice([0.0, 0.5])),
        shadows=random.random() < 0.3,
        groups=[[0, 1], [2]] if volumes == 3 and random.random() < 0.5 else None,
        features=random.random() < 0.7,
        emission=int(random.choice([0, 1, 4])),
        projection=str(random.choice(["perspective", "orthographic", "inside"])),
        depth_samples=int(random.integers(1, 40)),
        optimizations=frozenset(random.choice(["faint_rays", "empty_space", "behind_opaque"], 2).tolist()),
        kind=str(random.choice(["lumps", "solid", "voxels", "magnitudes"])),
    )


def spoil(random: np.random.Generator, values: np.ndarray) -> None:
    """Replace some of the values, in place."""
    flat = values.reshape(-1)
    places = random.integers(0, len(flat), max(len(flat) // 20, 1))
    if values.dtype.kind == "f":
        with np.errstate(over="ignore"):
            flat[places] = random.choice(STRANGE, len(places)).astype(values.dtype)
    else:
        flat[places] = random.integers(np.iinfo(values.dtype).min, np.iinfo(values.dtype).max, len(places))


def contents(scene: MarchScene) -> list[np.ndarray]:
    """Every array of a scene that a volume, a light or a surface fills."""
    found = []
    for medium in scene.media:
        grids = [medium.grid.density, *medium.grid.emission]
        found += [grid.values if isinstance(grid, SparseGrid) else grid.padded for grid in grids]
        found += [grid.table for grid in grids if isinstance(grid, SparseGrid)]
        for depth in medium.sun_depths:
            columns = depth.columns
            found.append(columns.offsets)
            found += [columns.tiles, columns.table] if isinstance(columns, SparseColumns) else [columns.depths]
    found += [shadow_map.heights for shadow_map in scene.options.shadow_maps or []]
    for fluence in scene.options.fluence or []:
        found += fluence.lights if fluence is not None else []
    return found


def spoiled_rays(random: np.random.Generator, rays: RayBatch) -> RayBatch:
    """Rays from anywhere to anywhere."""
    arrays = [values.copy() for values in (rays.origins, rays.directions, rays.near, rays.far)]
    for values in arrays:
        if random.random() < 0.4:
            spoil(random, values)
    return RayBatch(*arrays)


def fuzz(library: str, seconds: float, seed: int) -> int:
    """March as many scenes as fit in the time; returns how many."""
    kernels, end, count = Kernels(library), time.monotonic() + seconds, 0
    while time.monotonic() < end:
        random = np.random.default_rng(seed + count)
        scene = random_scene(seed + count, random_recipe(random), 8)
        march = CompiledMarch(kernels, scene.media, scene.options, scene.channels, ctypes.c_int32(0))
        for array in contents(scene):
            if random.random() < 0.6:
                spoil(random, array)
        march(scene.rays)
        with np.errstate(all="ignore"):
            rays = spoiled_rays(random, scene.rays)
            finite = np.flatnonzero(
                np.isfinite(rays.near)
                & np.isfinite(rays.far)
                & (np.abs(rays.far - rays.near) < 1e3)
                & (np.abs(rays.directions).max(axis=1) < 1e3)
            )
            march(rays.take(finite))
            march.march_steps(rays, np.full(len(rays.near), 64))
        count += 1
    return count


if __name__ == "__main__":
    print(fuzz(sys.argv[1], float(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 0), "scenes")
