# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes at lower resolution, where a render would need more memory than it may use."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..numerics.interpolation import halved_means
from ..scene.description import Medium, Volume, Voxels
from ..scene.errors import SceneError
from ..scene.sparse_grid import SparseGrid
from .resolution import FINE_EDGE

Volumes = list[tuple[Volume, Medium]]


def fitting_volumes(
    volumes: Volumes, needed: Callable[[Volumes], int], limit: int, adapts: bool
) -> tuple[Volumes, list[str]]:
    """Volumes of a render that needs at most `limit` bytes, and sentences about those that lost resolution.

    needed: bytes that a render of some volumes needs. adapts: whether volumes may lose resolution: the largest grid
    is halved first, for all of its instances. Raises SceneError where that is not enough.
    """
    found, amount = volumes, needed(volumes)
    times, remaining = np.ones(len(volumes), int), amount
    why = f"the render needs about {amount / 2**30:.1f} GiB and the memory limit is {limit / 2**30:.1f} GiB"
    while remaining > limit:
        sizes = [_size(volume) for volume, _ in found]
        if not adapts or not max(sizes, default=0):
            raise SceneError(
                f"{why}; raise the limit, or use fewer volumes or smaller grids, fewer depth samples or a smaller image"
            )
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
    """The means of 2 x 2 x 2 voxels of a volume, which keep density, emission and scattered light."""
    density, power = _halved(volume.density), volume.emission_power

    def alike(values: Voxels) -> Voxels:
        """On the voxels of the density; sparse grids share its blocks."""
        means = _halved(values)
        return density.with_values(means.values) if isinstance(density, SparseGrid) else means

    channels = [_power(alike(_power(channel, power)), 1.0 / power) for channel in volume.emission_channels()]
    return replace(
        volume,
        density=density,
        world_from_index=_placed(volume),
        emission=np.stack(channels, axis=3) if isinstance(volume.emission, np.ndarray) else tuple(channels) or None,
        scattering=None if volume.scattering is None else tuple(map(alike, volume.scattering)),
    )


def _size(volume: Volume) -> int:
    """Voxels of a volume that can be halved, else 0: small grids are refined anyway."""
    if max(volume.density.shape) < 2 * FINE_EDGE:
        return 0
    return int(volume.density.values.size if isinstance(volume.density, SparseGrid) else volume.density.size)


def _placed(volume: Volume) -> np.ndarray:
    """World from indices of voxels twice as large."""
    larger = np.diag([2.0, 2.0, 2.0, 1.0])
    larger[:3, 3] = 0.5
    return volume.world_from_index @ larger


def _halved(values: Voxels) -> Any:
    return values.halved() if isinstance(values, SparseGrid) else halved_means(values)


def _power(values: Voxels, power: float) -> Any:
    """A power of each value, with its sign."""
    numbers = values.values if isinstance(values, SparseGrid) else values
    raised = np.sign(numbers) * np.abs(numbers) ** power
    return values.with_values(raised) if isinstance(values, SparseGrid) else raised
