# SPDX-License-Identifier: GPL-3.0-or-later
"""Several overlapping volumes as one medium."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..numerics.small_matmul import inverse
from ..plan.resolution import LEVEL0_CELLS
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Medium, Volume
from ..scene.sparse_grid import SparseGrid
from .dense_grid import DenseGrid
from .grid import Grid
from .resampling import INNER, Placement, resample

# Albedos that differ by less are equal.
SAME_ALBEDO = 1e-6


def merge(
    grids: Sequence[Grid],
    media: Sequence[Medium],
    name: str,
    cancel: CancelToken = NEVER,
    edge: float | None = None,
) -> tuple[Volume, Medium]:
    """Volume and Medium with the extinction of several volumes, and their mean albedo and mean cosine.

    grids: Grid of each volume. Voxels are those of the finest grid, or the smallest multiple of them that leaves at
    most 256 along an edge; or their shortest edges are `edge`, in world units. The extinction is exact for grey media;
    for others each colour channel is proportional to the mean. Albedo and mean cosine are weighted by extinction and
    by scattering; where albedos differ or vary, the volume holds its scattering. Raises Cancelled.
    """
    finest = min(grids, key=lambda grid: grid.voxel)
    # Corners of all grids as indices of the finest.
    ends = np.concatenate([finest.index(grid.corners()) for grid in grids])
    low, high = np.floor(ends.min(axis=0)), np.ceil(ends.max(axis=0))
    together = float(np.ceil((high - low + 1.0).max() / LEVEL0_CELLS)) if edge is None else edge / finest.voxel
    low = np.floor(low / together).astype(int)
    shape = np.ceil((high + 1.0) / together).astype(int) - low
    world_from_index = np.eye(4)
    world_from_finest = inverse(finest.linear)
    # The centre of a voxel made of together^3 lies between theirs.
    first = low * together + 0.5 * (together - 1)
    world_from_index[:3, :3] = world_from_finest * together
    world_from_index[:3, 3] = world_from_finest @ (first - finest.offset)

    sigma_t = np.array([medium.sigma_t for medium in media])
    grey = sigma_t.mean(axis=1) / sigma_t.mean(axis=1).max()
    density, totals = np.zeros(shape, np.float32), []
    for grid, factor in zip(grids, grey):
        reached, values = _resampled_part(grid, grid.density, world_from_index, shape, cancel)
        totals.append(float(values.sum(dtype=np.float64)))
        density[reached] += np.float32(factor) * values
    amounts = np.array(totals)[:, None]
    extinction = (amounts * sigma_t).sum(axis=0)
    scattering = amounts * sigma_t * [medium.albedo for medium in media]
    albedo = np.divide(scattering.sum(axis=0), extinction, out=np.zeros(3), where=extinction > 0.0)
    weights = scattering.sum(axis=1) / max(scattering.sum(), 1e-30)
    cosine = float(weights @ [medium.anisotropy for medium in media])
    medium = Medium(extinction / float((amounts[:, 0] * grey).sum()), np.clip(albedo, 0.0, 1.0), cosine)
    albedos = np.array([medium.albedo for medium in media])
    if np.ptp(albedos, axis=0).max() <= SAME_ALBEDO and not any(grid.scattering for grid in grids):
        return Volume(density, world_from_index, name), medium
    channels = [0]
    if np.ptp(albedos, axis=1).max() > 0.0 or any(len(grid.scattering) == 3 for grid in grids):
        channels = [0, 1, 2]
    scattering = [np.zeros(shape, np.float32) for _ in channels]
    for grid, factor, albedo in zip(grids, grey, albedos):
        known: dict[int, tuple[tuple[slice, ...], np.ndarray]] = {}
        for c, channel in zip(channels, scattering):
            source = grid.scattering_of(c)
            if id(source) not in known:
                known = {id(source): _resampled_part(grid, source, world_from_index, shape, cancel)}
            reached, values = known[id(source)]
            channel[reached] += np.float32(factor * (1.0 if grid.scattering else albedo[c])) * values
    scattering = [np.minimum(channel, density) for channel in scattering]
    return Volume(density, world_from_index, name, scattering=tuple(scattering)), medium


def join(
    grids: Sequence[Grid], media: Sequence[Medium], name: str, edge: float, cancel: CancelToken = NEVER
) -> tuple[Volume, Medium]:
    """One Volume and Medium in place of several that differ in density, albedo, strength and emission alone.

    As `merge`, with their emission. Raises Cancelled.
    """
    volume, medium = merge(grids, media, name, cancel, edge)
    emission = None
    if any(grid.emission for grid in grids):
        emission = np.zeros((*volume.density.shape, 3), np.float32)
        for grid, own in zip(grids, media):
            for c, channel in enumerate(grid.emission):
                placed = volume.world_from_index, np.array(volume.density.shape)
                reached, values = _resampled_part(grid, channel, *placed, cancel, grid.emission_power)
                emission[..., c][reached] += np.float32(own.emission) * values
    volume = Volume(volume.density, volume.world_from_index, name, emission, scattering=volume.scattering)
    return volume, replace(medium, anisotropy=media[0].anisotropy, phase=media[0].phase)


def resampled(
    grid: Grid,
    values: DenseGrid | SparseGrid,
    world_from_index: np.ndarray,
    shape: np.ndarray,
    cancel: CancelToken = NEVER,
    power: int = 1,
) -> np.ndarray:
    """Values of a Grid at the voxels of another: float32 of `shape`.

    values: the grid's density, or a channel of its emission. world_from_index: (4, 4) transform of the other grid.
    power: of the values. Takes the interpolant at voxel centres, or the mean of 2 x 2 x 2 points per voxel where those
    are larger than the volume's own. Raises Cancelled.
    """
    out = np.zeros(shape, np.float32)
    reached, found = _resampled_part(grid, values, world_from_index, shape, cancel, power)
    out[reached] = found
    return out


def _resampled_part(
    grid: Grid,
    values: DenseGrid | SparseGrid,
    world_from_index: np.ndarray,
    shape: np.ndarray,
    cancel: CancelToken,
    power: int = 1,
) -> tuple[tuple[slice, ...], np.ndarray]:
    """As `resampled`: the voxels that the grid's support reaches, and values at these."""
    linear = grid.linear @ world_from_index[:3, :3]
    offset = grid.linear @ world_from_index[:3, 3] + grid.offset
    # Voxels of the other grid that the support can reach.
    back = (grid.corners() - world_from_index[:3, 3]) @ inverse(world_from_index[:3, :3]).T
    low = np.clip(np.floor(back.min(axis=0)).astype(int), 0, shape)
    high = np.clip(np.ceil(back.max(axis=0)).astype(int) + 1, 0, shape)
    # Finer voxels than the volume's own hold nothing more.
    longest = np.linalg.norm(linear, axis=0).max() / grid.voxels.times
    points = np.zeros((1, 3)) if longest < 1.5 else INNER @ linear.T
    out = np.zeros(np.maximum(high - low, 0), np.float32)
    resample(values, power, grid.occupancy, Placement(linear, offset, points).beside(low), out, cancel)
    return tuple(map(slice, low, high)), out
