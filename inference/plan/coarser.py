# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes at lower resolution, where a render would need more memory than it may use."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..scene.description import Medium, Volume
from ..scene.errors import SceneError
from ..scene.sparse_grid import SparseGrid
from .resolution import FINE_EDGE

Volumes = list[tuple[Volume, Medium]]


def fitting_volumes(
    volumes: Volumes, needed: Callable[[Volumes], int], limit: int, adapts: bool
) -> tuple[Volumes, list[str]]:
    """Volumes of a render that needs at most `limit` bytes, and sentences about those that lost resolution.

    needed: bytes that a render of some volumes needs. adapts: whether volumes may lose resolution: the largest dense
    grid is halved first, for all of its instances. Raises SceneError where that is not enough.
    """
    found, amount = volumes, needed(volumes)
    times, remaining = np.ones(len(volumes), int), amount
    why = f"the render needs about {amount / 2**30:.1f} GiB and the limit is {limit / 2**30:.1f} GiB"
    while remaining > limit:
        sizes = [_size(volume) for volume, _ in found]
        if not adapts or not max(sizes, default=0):
            raise SceneError(f"{why}; raise the limit, or use fewer depth samples, a smaller image or smaller grids")
        largest = found[int(np.argmax(sizes))][0]
        coarse = halved(largest)
        alike = np.array([volume.voxels_key == largest.voxels_key for volume, _ in found])
        found = [
            (coarse.instance(_placed(volume), volume.name), medium) if same else (volume, medium)
            for (volume, medium), same in zip(found, alike)
        ]
        times[alike] *= 2
        remaining = needed(found)
    names = {volume.voxels_key: (volume.name, n) for (volume, _), n in zip(volumes, times.tolist()) if n > 1}
    return found, [
        f"{name}: rendered at 1/{n} of its resolution, because {why}; raise the limit to see all detail"
        for name, n in names.values()
    ]


def halved(volume: Volume) -> Volume:
    """The means of 2 x 2 x 2 voxels of a dense volume, which keep density, emission and scattered light."""
    emission = None
    if isinstance(volume.emission, np.ndarray):
        power = volume.emission_power
        means = [_means(np.sign(e) * np.abs(e) ** power) for e in np.moveaxis(volume.emission, 3, 0)]
        emission = np.stack([np.sign(mean) * np.abs(mean) ** (1.0 / power) for mean in means], axis=3)
    scattering = None if volume.scattering is None else tuple(map(_means, volume.scattering))
    return replace(
        volume,
        density=_means(volume.density),
        world_from_index=_placed(volume),
        emission=emission,
        scattering=scattering,
    )


def _size(volume: Volume) -> int:
    """Voxels of a volume that can be halved, else 0: small grids are refined anyway."""
    coarse = not isinstance(volume.density, SparseGrid) and max(volume.density.shape) >= 2 * FINE_EDGE
    return int(np.prod(volume.density.shape)) if coarse else 0


def _placed(volume: Volume) -> np.ndarray:
    """World from indices of voxels twice as large."""
    larger = np.diag([2.0, 2.0, 2.0, 1.0])
    larger[:3, 3] = 0.5
    return volume.world_from_index @ larger


def _means(values: np.ndarray | SparseGrid) -> np.ndarray:
    """Means of 2 x 2 x 2 values; there are zeros behind the last."""
    assert not isinstance(values, SparseGrid)
    for axis in range(3):
        along = np.moveaxis(values, axis, 0)
        means = 0.5 * along[::2]
        means[: len(along) // 2] += 0.5 * along[1::2]
        values = np.moveaxis(means, 0, axis)
    return np.ascontiguousarray(values, np.float32)
