"""Several overlapping volumes as one medium."""


import numpy as np

from ..plan.resolution import LEVEL0_CELLS
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Medium, Volume

# Points at which density is evaluated at a time.
POINTS_PER_BATCH = 1 << 20


def merge(grids, media: list[Medium], name: str, cancel: CancelToken = NEVER) -> tuple[Volume, Medium]:
    """One Volume and Medium with the extinction of all of them, and their mean albedo and mean cosine.

    grids: a Grid of each. Voxels are those of the grid with the finest, or as many of
    them together as leave at most 256 along an edge; their extinction is exact in grey media and, in each colour, in
    proportion to that. The means are weighted with what scatters.
    """
    finest = min(grids, key=lambda grid: grid.voxel)
    # All grids' corners as indices of the finest's voxels.
    ends = np.concatenate([finest.index(grid.corners()) for grid in grids])
    low, high = np.floor(ends.min(axis=0)), np.ceil(ends.max(axis=0))
    together = int(np.ceil((high - low + 1.0).max() / LEVEL0_CELLS))
    low = np.floor(low / together).astype(int)
    shape = np.ceil((high + 1.0) / together).astype(int) - low
    world_from_index = np.eye(4)
    turn = np.linalg.inv(finest.linear)
    # The middle of a voxel that `together`^3 make lies between them.
    first = low * together + 0.5 * (together - 1)
    world_from_index[:3, :3], world_from_index[:3, 3] = turn * together, turn @ (first - finest.offset)

    sigma_t = np.array([medium.sigma_t for medium in media])
    grey = sigma_t.mean(axis=1) / sigma_t.mean(axis=1).max()
    density, amounts = np.zeros(shape, np.float32), []
    for grid, factor in zip(grids, grey):
        values = resampled(grid, grid.sample_density, world_from_index, shape, cancel)
        amounts.append(float(values.sum(dtype=np.float64)))
        density += np.float32(factor) * values
    amounts = np.array(amounts)[:, None]
    extinction = (amounts * sigma_t).sum(axis=0)
    scattering = amounts * sigma_t * [medium.albedo for medium in media]
    albedo = np.divide(scattering.sum(axis=0), extinction, out=np.zeros(3), where=extinction > 0.0)
    weights = scattering.sum(axis=1) / max(scattering.sum(), 1e-30)
    cosine = float(weights @ [medium.anisotropy for medium in media])
    medium = Medium(extinction / float((amounts[:, 0] * grey).sum()), np.clip(albedo, 0.0, 1.0), cosine)
    return Volume(density, world_from_index, name), medium


def resampled(grid, sample, world_from_index, shape, cancel: CancelToken = NEVER) -> np.ndarray:
    """Values of a Grid in the voxels of another: float32 `shape`. sample: its method that gives them.

    The interpolant at their centres, or where they are the larger at 2x2x2 places in each.
    """
    values = np.zeros(shape, np.float32)
    index_from_other = grid.linear @ world_from_index[:3, :3]
    offset = grid.linear @ world_from_index[:3, 3] + grid.offset
    # Voxels of the other that the grid's support can reach.
    back = (grid.corners() - world_from_index[:3, 3]) @ np.linalg.inv(world_from_index[:3, :3]).T
    low = np.clip(np.floor(back.min(axis=0)).astype(int), 0, shape)
    high = np.clip(np.ceil(back.max(axis=0)).astype(int) + 1, 0, shape)
    size = np.linalg.norm(index_from_other, axis=0).max()
    places = np.array([0.0]) if size < 1.5 else np.array([-0.25, 0.25])
    inner = np.stack(np.meshgrid(places, places, places, indexing="ij"), axis=-1).reshape(-1, 3)
    axes = [np.arange(l, h) for l, h in zip(low, high)]
    rows = max(POINTS_PER_BATCH // max(len(axes[1]) * len(axes[2]), 1), 1)
    for start in range(0, len(axes[0]), rows):
        cancel.check()
        slab = np.stack(np.meshgrid(axes[0][start:start + rows], *axes[1:], indexing="ij"), axis=-1)
        centre = slab.reshape(-1, 3) @ index_from_other.T + offset
        found = np.zeros(len(centre), np.float32)
        for place in inner @ index_from_other.T:
            index = (centre + place).T.astype(np.float32)
            filled = np.flatnonzero(grid.occupancy.near(index))
            found[filled] += sample(index[:, filled]) / len(inner)
        x = slice(low[0] + start, low[0] + start + len(slab))
        values[x, low[1]:high[1], low[2]:high[2]] = found.reshape(slab.shape[:3])
    return values
