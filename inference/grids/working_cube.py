# SPDX-License-Identifier: GPL-3.0-or-later
"""The working cube: the smallest cube around the active part of a volume, edge length 1.

Positions in its frame lie in [-1/2, 1/2]^3. Networks see the medium's optical thickness as sigma_hat = sigma_t * edge,
extinction per unit density times the edge of the cube, dimensionless.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..plan.resolution import LEVEL0_CELLS
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Volume
from ..scene.sparse_grid import SparseGrid
from .bounds import active_bounds
from .dense_grid import DenseGrid
from .occupancy import Occupancy

# Axes of a transform count as perpendicular below this cosine.
PERPENDICULAR = 1e-4
# Voxels of an axis that are averaged at a time, and planes of voxels between two polls of cancellation.
SLAB, PLANES = 16, 4
# Rows of cells of a plane that are resampled between two polls of cancellation.
ROWS = 64


@dataclass
class Cube:
    """Where the working cube lies in the world.

    rotation: float64 (3, 3), columns are the cube's axes in the world. centre: float64 (3,), world. edge: world units.
    low, high: int (3,), first and one past the last active voxel on each axis.
    """

    rotation: np.ndarray
    centre: np.ndarray
    edge: float
    low: np.ndarray
    high: np.ndarray

    def positions(self, world: np.ndarray) -> np.ndarray:
        """World positions (..., 3) in the cube's frame."""
        return (world - self.centre) @ self.rotation / self.edge

    def directions(self, world: np.ndarray) -> np.ndarray:
        """World unit vectors (..., 3) in the cube's frame."""
        return world @ self.rotation


def fit_cube(volume: Volume) -> Cube:
    """Smallest cube around the support of the active voxels' trilinear interpolant.

    The cube follows the axes of the grid if these are perpendicular in the world, and those of the world if the
    transform shears. Raises SceneError if the density is 0 everywhere.
    """
    low, high = active_bounds(volume.density)
    axes = volume.world_from_index[:3, :3]
    sizes = np.linalg.norm(axes, axis=0)
    rotation = axes / sizes
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > PERPENDICULAR:
        rotation = np.eye(3)
    elif np.linalg.det(rotation) < 0.0:
        rotation[:, 0] *= -1.0
    # The influence of a voxel ends one voxel beyond its centre.
    corners = np.array(np.meshgrid(*zip(low - 1.0, high * 1.0), indexing="ij")).reshape(3, -1)
    world = axes @ corners + volume.world_from_index[:3, 3:]
    local = rotation.T @ world
    middle = 0.5 * (local.min(axis=1) + local.max(axis=1))
    edge = float((local.max(axis=1) - local.min(axis=1)).max())
    return Cube(rotation, rotation @ middle, edge, low, high)


def _hat_integral(x: np.ndarray) -> np.ndarray:
    """Integral of the unit hat function from -infinity to x."""
    x = np.clip(x, -1.0, 1.0)
    return np.where(x < 0.0, 0.5 * (1.0 + x) ** 2, 1.0 - 0.5 * (1.0 - x) ** 2)


def _cell_weights(edges: np.ndarray, voxels: int) -> np.ndarray:
    """(cells, voxels): weights of the mean over each cell of the linear interpolant between voxel centres."""
    distance = edges[:, None] - np.arange(voxels)[None]
    integral = _hat_integral(distance)
    width = np.diff(edges)[:, None]
    return ((integral[1:] - integral[:-1]) / width).astype(np.float32)


def level0_density(volume: Volume, cube: Cube, cancel: CancelToken = NEVER) -> np.ndarray:
    """Mean density in each cell of the cube: float32 (256, 256, 256).

    Exact means of the trilinear interpolant where grid and cube share their axes; for sheared transforms the mean of
    2 x 2 x 2 points per cell. Raises Cancelled.
    """
    index_from_world = np.linalg.inv(volume.world_from_index)
    index_from_cube = index_from_world[:3, :3] @ cube.rotation * cube.edge
    origin = index_from_world[:3, :3] @ cube.centre + index_from_world[:3, 3] - cube.low
    scale = np.diag(index_from_cube)
    if np.abs(index_from_cube - np.diag(scale)).max() > PERPENDICULAR * np.abs(scale).max():
        return _resample_sheared(volume.density, index_from_cube, origin + cube.low, cancel)
    edges = np.linspace(-0.5, 0.5, LEVEL0_CELLS + 1)
    weights = [_cell_weights(edges * scale[axis] + origin[axis], cube.high[axis] - cube.low[axis]) for axis in range(3)]
    cells = np.zeros((LEVEL0_CELLS,) * 3, np.float32)
    for low, slab in _slabs(volume.density, cube):
        cancel.check()
        x, y, z = (part[:, start : start + n] for part, start, n in zip(weights, low - cube.low, slab.shape))
        _add_weighted(cells, x, _weighted(y, _weighted(z, slab, 2), 1), 0)
    return np.maximum(cells, 0.0)


def _slabs(density: np.ndarray | SparseGrid, cube: Cube) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield boxes of voxels that cover every value other than 0, with the first voxel (3,) of each."""
    if isinstance(density, SparseGrid):
        for low, slab in density.crop(cube.low, cube.high).slabs():
            yield low + cube.low, slab
        return
    inside = tuple(map(slice, cube.low, cube.high))
    for start in range(cube.low[0], cube.high[0], PLANES):
        yield np.array([start, *cube.low[1:]]), density[(slice(start, min(start + PLANES, cube.high[0])), *inside[1:])]


def _weighted(weights: np.ndarray, values: np.ndarray, axis: int) -> np.ndarray:
    """Sums along one axis of values (x, y, z) with weights (cells, voxels)."""
    shape = list(values.shape)
    shape[axis] = len(weights)
    sums = np.zeros(shape, np.float32)
    _add_weighted(sums, weights, values, axis)
    return sums


def _add_weighted(sums: np.ndarray, weights: np.ndarray, values: np.ndarray, axis: int) -> None:
    """Add to `sums` the sums along one axis of values (x, y, z) with weights (cells, voxels), most of which are 0."""
    for start in range(0, values.shape[axis], SLAB):
        few = (slice(None),) * axis + (slice(start, start + SLAB),)
        part = weights[:, few[-1]]
        met = np.flatnonzero(part.any(axis=1))
        if len(met):
            cells = slice(met[0], met[-1] + 1)
            into, some, part = sums[(*few[:-1], cells)], values[few], part[cells]
            # One small product per plane: see `small_matmul`.
            if axis == 2:
                into += np.matmul(some, part.T)
            elif axis == 1:
                into += np.matmul(part, some)
            else:
                into += np.matmul(part, some.transpose(1, 0, 2)).transpose(1, 0, 2)


def _resample_sheared(
    density: np.ndarray | SparseGrid, index_from_cube: np.ndarray, origin: np.ndarray, cancel: CancelToken
) -> np.ndarray:
    grid = density if isinstance(density, SparseGrid) else DenseGrid(density)
    occupancy = Occupancy(grid.cells(), grid.cell_peaks(), grid.CELL, grid.cells_first)
    cells = np.zeros((LEVEL0_CELLS,) * 3, np.float32)
    inner = (np.arange(2 * LEVEL0_CELLS) + 0.5) / (2 * LEVEL0_CELLS) - 0.5
    for i, j in np.ndindex(LEVEL0_CELLS, LEVEL0_CELLS // ROWS):
        cancel.check()
        rows = slice(j * ROWS, (j + 1) * ROWS)
        axes = inner[2 * i : 2 * i + 2], inner[2 * rows.start : 2 * rows.stop], inner
        points = np.stack(np.meshgrid(*axes, indexing="ij"))
        index = (index_from_cube @ points.reshape(3, -1) + origin[:, None]).astype(np.float32)
        near, fine = np.flatnonzero(occupancy.near(index)), np.zeros(index.shape[1], np.float32)
        fine[near] = grid.sample(index[:, near])
        cells[i, rows] = fine.reshape(2, ROWS, 2, LEVEL0_CELLS, 2).mean(axis=(0, 2, 4))
    return cells
