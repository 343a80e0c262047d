# SPDX-License-Identifier: GPL-3.0-or-later
"""A volume at the resolution of its density, for camera rays and single scattering."""

import functools
import threading
import weakref
from collections.abc import Sequence

import numpy as np

from ..numerics.interpolation import halved_means
from ..numerics.intersection import box_interval
from ..numerics.small_matmul import affine_inverse, inverse, product
from ..plan.resolution import refinement
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Volume
from ..scene.errors import SceneError
from ..scene.sparse_grid import SparseGrid
from .bounds import filled_bounds
from .dense_grid import DenseGrid, refined
from .occupancy import LEAST_CELLS, MOST_CELLS, Occupancy
from .sun_optical_depth import SunOpticalDepth

# Which corners of a box are the highest, along each axis.
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], bool)


class Voxels:
    """The active part of a volume's density and emission, wherever the volume lies. Instances share it.

    density, emission, scattering, occupancy: as of Grid. filled: bounds of the density alone, as of `filled_bounds`.
    low: first active voxel int (3,). times: factor of refinement. source: the volume, whose arrays it keeps alive.

    Safe to use on several threads. Raises SceneError if density and emission are 0 everywhere.
    """

    def __init__(self, volume: Volume):
        emission = volume.emission_channels()
        self.source, self.filled = volume, filled_bounds(volume.density)
        bounds = [box for box in (self.filled, *map(filled_bounds, emission)) if box is not None]
        if not bounds:
            raise SceneError(f"{volume.name}: the density grid is zero everywhere")
        self.low = low = np.min([first for first, _ in bounds], axis=0)
        high = np.max([end for _, end in bounds], axis=0)
        self.times = times = 1 if isinstance(volume.density, SparseGrid) else refinement(high - low)
        self.density = _cropped(volume.density, low, high, times)
        self.emission = [_cropped(channel, low, high, times) for channel in emission]
        self.scattering = [_cropped(channel, low, high, times) for channel in volume.scattering or ()]
        filled = np.logical_or.reduce([grid.cells() for grid in (self.density, *self.emission)])
        self.occupancy = Occupancy(filled, self.density.cell_peaks(), self.density.cell, self.density.cells_first)
        # Of all instances, as long as one of them holds them.
        self._sun_depths: weakref.WeakValueDictionary[tuple[bytes, int], SunOpticalDepth] = (
            weakref.WeakValueDictionary()
        )
        self._coarser: dict[int, DenseGrid | SparseGrid] = {}
        self._lock = threading.Lock()

    def sun_depths(
        self, directions: Sequence[np.ndarray], octaves: int = 0, cancel: CancelToken = NEVER
    ) -> list[SunOpticalDepth]:
        """Optical depth towards each sun; directions: (3,) towards it, d(index)/d(world unit).

        octaves: by which the voxels of its columns are larger than these. Raises Cancelled.
        """
        found = []
        with cancel.locked(self._lock):
            density = self._coarsened(octaves)
            for direction in directions:
                cancel.check()
                key = bytes(direction), octaves
                known = self._sun_depths.get(key) or SunOpticalDepth(density, direction / 2**octaves, cancel, octaves)
                self._sun_depths[key] = known
                found.append(known)
        return found

    def _coarsened(self, octaves: int) -> DenseGrid | SparseGrid:
        """The density in larger voxels."""
        if not octaves:
            return self.density
        if octaves not in self._coarser:
            finer = self._coarsened(octaves - 1)
            self._coarser[octaves] = (
                finer.halved() if isinstance(finer, SparseGrid) else DenseGrid(halved_means(finer.values))
            )
        return self._coarser[octaves]


class Grid:
    """The active part of a volume's density and emission, in its place.

    Voxels are those of the volume, or finer voxels if these are few. Indices count from the centre of the first active
    voxel; the support of the trilinear interpolant is the box from -1 to the number of voxels on each axis.

    density: DenseGrid or SparseGrid. emission: one grid per colour channel, or none. emission_power: as in Volume.
    scattering: density times albedo, one grid or one per colour channel, or none for a uniform albedo.
    occupancy: Occupancy of density and emission. shape: voxels. peak: largest density. linear: (3, 3) and offset: (3,),
    continuous indices from world positions. box: lowest and highest index (3,) of the support. voxel, longest: shortest
    and longest edge of a voxel in world units. voxels: that it shares with other instances of the volume.

    Safe to use on several threads. Raises SceneError if density and emission are 0 everywhere.
    """

    def __init__(self, volume: Volume, voxels: Voxels | None = None):
        """voxels: of another instance, None to make them."""
        self.voxels = voxels = voxels or Voxels(volume)
        self.density, self.emission, self.scattering = voxels.density, voxels.emission, voxels.scattering
        self.emission_power, self.occupancy = volume.emission_power, voxels.occupancy
        self.shape, self.peak, times = self.density.shape, self.density.peak, voxels.times
        self.box = np.full(3, -1.0), np.array(self.shape, np.float64)
        index_from_world = affine_inverse(volume.world_from_index)
        self.linear = times * index_from_world[:3, :3]
        self.offset = times * (index_from_world[:3, 3] - voxels.low + 1.0) - 1.0
        sizes = np.linalg.norm(volume.world_from_index[:3, :3], axis=0) / times
        self.voxel, self.longest = float(sizes.min()), float(sizes.max())
        self._sun_depths: list[SunOpticalDepth] = []

    def sun_depths(
        self, directions: Sequence[np.ndarray], octaves: int = 0, cancel: CancelToken = NEVER
    ) -> list[SunOpticalDepth]:
        """Optical depth towards each sun; directions: unit vectors (3,) in the world. octaves: as of Voxels.

        The depths of the last call are cached, and shared with other instances. Raises Cancelled.
        """
        found = self.voxels.sun_depths([self.linear @ direction for direction in directions], octaves, cancel)
        self._sun_depths = found
        return found

    def index(self, world: np.ndarray) -> np.ndarray:
        """Continuous indices float64 (N, 3) of world positions (N, 3)."""
        return product(world, self.linear.T) + self.offset

    def corners(self) -> np.ndarray:
        """World corners (8, 3) of the support."""
        return self._corners

    @functools.cached_property
    def _corners(self) -> np.ndarray:
        return self.corners_of(*self.box)

    def corners_of(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """World corners (8, 3) of a box between two indices (3,)."""
        return product(np.where(CORNERS, high, low) - self.offset, self._world_linear.T)

    @functools.cached_property
    def sphere(self) -> np.ndarray:
        """(4,), centre and radius in the world of a sphere around the support and a voxel around the whole grid."""
        low, high = self.box
        corners = self.corners_of(np.minimum(low, -1.0), np.maximum(high, self.shape))
        centre = corners.mean(axis=0)
        radius = np.sqrt(((corners - centre) ** 2).sum(axis=1).max())
        # More than rounding takes.
        return np.append(centre, (1.0 + 1e-6) * radius + 1e-9 * np.abs(centre).max())

    @functools.cached_property
    def _world_linear(self) -> np.ndarray:
        return inverse(self.linear)

    def support(self, detail: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Cells outside of which density and emission are 0, bool (x, y, z), and the world positions
        (x + 1, y + 1, z + 1, 3) of their corners. detail: fraction of the cells along an edge that are told apart.
        """
        cells, corners = self.occupancy.support(max(round(detail * MOST_CELLS), LEAST_CELLS))
        return cells, product(corners - self.offset, self._world_linear.T)

    def interval(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) at which world rays (N, 3) enter and leave the support; entry > exit on a miss."""
        return box_interval(self.index(origins), product(directions, self.linear.T), *self.box)

    def sample_density(self, index: np.ndarray) -> np.ndarray:
        """Density (N,) at continuous indices float32 (3, N)."""
        return self.density.sample(index)

    def scattering_of(self, channel: int) -> DenseGrid | SparseGrid:
        """Density times albedo in a colour channel; the density itself for a uniform albedo."""
        return self.scattering[channel if len(self.scattering) == 3 else 0] if self.scattering else self.density


def _cropped(values: np.ndarray | SparseGrid, low: np.ndarray, high: np.ndarray, times: int) -> DenseGrid | SparseGrid:
    """Voxels from low (3,) to before high (3,), those of an array refined `times` times."""
    if isinstance(values, SparseGrid):
        return values.crop(low, high)
    inside = values[tuple(map(slice, low, high))]
    return DenseGrid(refined(inside, times) if times > 1 else inside)
