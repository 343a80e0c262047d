# SPDX-License-Identifier: GPL-3.0-or-later
"""The working cube: the smallest cube around the active part of a volume, edge length 1.

Positions in its frame lie in [-1/2, 1/2]^3. Networks see the medium's optical thickness as sigma_hat = sigma_t * edge,
extinction per unit density times the edge of the cube, dimensionless.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..kernels import structures
from ..kernels.library import call
from ..numerics.small_matmul import affine_inverse, product
from ..plan.resolution import LEVEL0_CELLS
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Volume
from ..scene.sparse_grid import SparseGrid
from .bounds import active_bounds
from .dense_grid import DenseGrid
from .described import describe_blocks
from .occupancy import Occupancy
from .resampling import Placement, inner_points, resample

# Axes of a transform count as perpendicular below this cosine.
PERPENDICULAR = 1e-4
# Distance in voxels below which places in them count as the same.
SAME_PLACE = 1e-6
# Planes between two polls of cancellation.
PLANES = 4


@dataclass
class Cube:
    """Where the working cube lies in the world.

    rotation: float64 (3, 3), columns are the cube's axes in the world. centre: float64 (3,), world. edge: world units.
    low, high: int (3,), first and one past the last active voxel on each axis. finest: level of the density pyramid
    that networks read in place of finer ones.
    """

    rotation: np.ndarray
    centre: np.ndarray
    edge: float
    low: np.ndarray
    high: np.ndarray
    finest: int = 0

    @property
    def key(self) -> bytes:
        """Equal for cubes that lie at the same place of the world."""
        return b"".join((self.rotation.tobytes(), self.centre.tobytes(), np.float64(self.edge).tobytes()))

    def in_voxels(self, volume: Volume) -> bytes:
        """Equal for instances whose cubes lie alike in their voxels, to SAME_PLACE of one, with the same `finest`."""
        index_from_world = affine_inverse(volume.world_from_index)
        axes = index_from_world[:3, :3] @ self.rotation * self.edge
        centre = index_from_world[:3, :3] @ self.centre + index_from_world[:3, 3]
        # Adding 0 turns -0 into 0.
        return (np.round(np.column_stack([axes, centre]) / SAME_PLACE) + 0.0).tobytes() + bytes([self.finest])

    def positions(self, world: np.ndarray) -> np.ndarray:
        """World positions (..., 3) in the cube's frame."""
        return product(world - self.centre, self.rotation) / self.edge

    def world(self, positions: np.ndarray) -> np.ndarray:
        """World positions (..., 3) of those in the cube's frame."""
        return product(positions * self.edge, self.rotation.T) + self.centre

    def directions(self, world: np.ndarray) -> np.ndarray:
        """World unit vectors (..., 3) in the cube's frame."""
        return product(world, self.rotation)


def fit_cube(volume: Volume, bounds: tuple[np.ndarray, np.ndarray] | None = None) -> Cube:
    """Smallest cube around the support of the active voxels' trilinear interpolant.

    bounds: of `active_bounds` where they are known.

    The cube follows the axes of the grid if these are perpendicular in the world, and those of the world if the
    transform shears. Raises SceneError if the density is 0 everywhere.
    """
    low, high = active_bounds(volume.density) if bounds is None else bounds
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


def extent(volume: Volume, cube: Cube) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates (3,), in the cube's frame, of points at which the density is above 0."""
    ends = zip(cube.low - 1.0, cube.high * 1.0)
    corners = np.array(np.meshgrid(*ends, indexing="ij")).reshape(3, -1)
    matrix = volume.world_from_index
    points = cube.positions((matrix[:3, :3] @ corners + matrix[:3, 3:]).T)
    return points.min(axis=0), points.max(axis=0)


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


def mean_density(volume: Volume, cube: Cube, cancel: CancelToken = NEVER, out: np.ndarray | None = None) -> np.ndarray:
    """Mean density in each cell of the cube: float32 (n, n, n).

    Exact means of the trilinear interpolant where grid and cube share their axes; for sheared transforms the mean of
    2 x 2 x 2 points per cell of level 0. out: zeros (n, n, n) to fill, or None for level 0. Raises Cancelled.
    """
    cells = np.zeros((LEVEL0_CELLS,) * 3, np.float32) if out is None else out
    n = len(cells)
    index_from_world = affine_inverse(volume.world_from_index)
    index_from_cube = index_from_world[:3, :3] @ cube.rotation * cube.edge
    origin = index_from_world[:3, :3] @ cube.centre + index_from_world[:3, 3] - cube.low
    scale = np.diag(index_from_cube)
    if np.abs(index_from_cube - np.diag(scale)).max() > PERPENDICULAR * np.abs(scale).max():
        linear = index_from_cube / n
        centre = origin + cube.low + linear @ np.full(3, 0.5 - n / 2)
        grid = volume.density if isinstance(volume.density, SparseGrid) else DenseGrid(volume.density)
        occupancy = Occupancy(grid.cells(), grid.cell_peaks(), grid.cell, grid.cells_first)
        resample(
            grid, 1, occupancy, Placement(linear, centre, inner_points(2 * LEVEL0_CELLS // n) @ linear.T), cells, cancel
        )
        return cells
    edges = np.linspace(-0.5, 0.5, n + 1)
    weights = [_cell_weights(edges * scale[axis] + origin[axis], cube.high[axis] - cube.low[axis]) for axis in range(3)]
    firsts, bands = zip(*map(_banded, weights))
    _mean_cells(volume.density, cube, (firsts, bands), cells, cancel)
    return cells


def _mean_cells(
    density: np.ndarray | SparseGrid,
    cube: Cube,
    bands: tuple[Sequence[np.ndarray], Sequence[np.ndarray]],
    cells: np.ndarray,
    cancel: CancelToken,
) -> None:
    """Fill cells with the means of a density; bands: of `_banded`, along each axis."""
    if isinstance(density, SparseGrid):
        grid = describe_blocks(density)
    else:
        grid = structures.Grid(values=np.ascontiguousarray(density, np.float32), shape=np.array(density.shape))
    firsts, weights = bands
    widths, n, voxels = [band.shape[1] for band in weights], len(cells), cube.high - cube.low
    planes = np.full(widths[0], -1, np.int64)
    scratch = np.empty(widths[0] * n * n + voxels[1] * (voxels[2] + n), np.float32)
    for start in range(0, n, PLANES):
        cancel.check()
        call(
            "mean_cells",
            density=grid,
            low=cube.low,
            voxels=voxels,
            cells=n,
            widths=np.array(widths),
            firsts=tuple(firsts),
            weights=tuple(weights),
            begin=start,
            end=start + PLANES,
            out=cells.ctypes.data,
            strides=np.array(cells.strides) // cells.itemsize,
            held=planes,
            scratch=scratch,
        )


def _banded(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First voxel int (cells,) of each row of weights (cells, voxels) that is not 0, and float32 (cells, width)."""
    count = weights.shape[1]
    met = weights != 0.0
    first = met.argmax(axis=1)
    width = max(int((count - met[:, ::-1].argmax(axis=1) - first)[met.any(axis=1)].max(initial=1)), 1)
    first = np.minimum(first, count - width)
    return first, np.take_along_axis(weights, first[:, None] + np.arange(width), 1)
