"""A volume at the density's own resolution: what camera rays and exact shadows read."""

import copy

import numpy as np

from .cube import filled_bounds
from .dense_grid import DenseGrid, refined, refinement
from .occupancy import Occupancy
from .products import product
from .rays import box_interval
from .scene import SceneError, Volume
from .sparse_grid import SparseGrid
from .sun_depth import SunDepth


class Grid:
    """The active part of a volume's density and emission, and its optical depth towards each sun.

    Voxels are the volume's, or finer ones where these are few. Indices count from the centre of the first of them that is
    active; the support of the trilinear interpolation is the box from -1 to the number of voxels on each axis. All
    optical depths are for an extinction of 1 per unit density and world unit.
    """

    def __init__(self, volume: Volume):
        emission = volume.emission_channels()
        bounds = [found for found in map(filled_bounds, (volume.density, *emission)) if found is not None]
        if not bounds:
            raise SceneError(f"{volume.name}: the density grid is zero everywhere")
        low = np.min([first for first, _ in bounds], axis=0)
        high = np.max([end for _, end in bounds], axis=0)
        times = 1 if isinstance(volume.density, SparseGrid) else refinement(high - low)
        self.density = _part(volume.density, low, high, times)
        # One grid a colour channel, or none.
        self.emission = [_part(channel, low, high, times) for channel in emission]
        self.emission_power = volume.emission_power
        filled = np.logical_or.reduce([grid.cells() for grid in (self.density, *self.emission)])
        self.occupancy = Occupancy(filled, self.density.CELL, self.density.cells_first)
        self.shape, self.peak = self.density.shape, self.density.peak
        self.box = np.full(3, -1.0), np.array(self.shape, np.float64)
        index_from_world = np.linalg.inv(volume.world_from_index)
        self.linear = times * index_from_world[:3, :3]
        self.offset = times * (index_from_world[:3, 3] - low + 1.0) - 1.0
        sizes = np.linalg.norm(volume.world_from_index[:3, :3], axis=0) / times
        self.voxel, self.longest = float(sizes.min()), float(sizes.max())
        self.sun_directions, self.sun_depths = [], []

    def add_sun(self, direction: np.ndarray, check=lambda: None, known=None):
        """Prepare the optical depth towards a sun; direction: (3,) unit vector in the world.

        check: asked often. known: optical depths that are there already, by the bytes of their direction in
        index space.
        """
        index_direction = self.linear @ direction
        depth = (known or {}).get(bytes(index_direction)) or SunDepth(self.density, index_direction, check)
        self.sun_directions.append(index_direction)
        self.sun_depths.append(depth)

    def of_suns(self, numbers) -> "Grid":
        """The same for some of its suns."""
        some = copy.copy(self)
        some.sun_directions = [self.sun_directions[n] for n in numbers]
        some.sun_depths = [self.sun_depths[n] for n in numbers]
        return some

    def index(self, world: np.ndarray) -> np.ndarray:
        """World positions (N, 3) as continuous indices, float64."""
        return product(world, self.linear.T) + self.offset

    def corners(self) -> np.ndarray:
        """(8, 3) of the support in the world."""
        low, high = self.box
        ends = np.array([[(low, high)[b][axis] for axis, b in enumerate((x, y, z))]
                         for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        return (ends - self.offset) @ np.linalg.inv(self.linear).T

    def interval(self, origins, directions):
        """Distances at which world rays enter and leave the grid's support."""
        return box_interval(self.index(origins), product(directions, self.linear.T), *self.box)

    def sample_density(self, index: np.ndarray) -> np.ndarray:
        """Density (N,) at continuous indices float32 (3, N)."""
        return self.density.sample(index)

    def sample_emission(self, channel: int, index: np.ndarray) -> np.ndarray:
        """Emission (N,) of a colour channel at continuous indices float32 (3, N)."""
        values = self.emission[channel].sample(index)
        return values if self.emission_power == 1 else values * np.abs(values) ** (self.emission_power - 1)

    def thickness(self, sigma_t: float) -> float:
        """Largest optical depth of one voxel, along its longest edge."""
        return self.peak * sigma_t * self.longest

    def set_extinction(self, sigma_t: float):
        """Choose the extinction per unit density of what follows."""
        self.sigma_t = sigma_t

    def sun_depth(self, index: np.ndarray, sun: int, may_be_outside: bool, hidden=np.float32(0.0)) -> np.ndarray:
        """Optical depth (N,) from continuous indices float32 (3, N) to a sun; hidden: as SunDepth has it.

        Points outside are moved towards the sun onto the support; where that misses it the depth is 0.
        """
        if may_be_outside:
            direction = self.sun_directions[sun]
            near, far = box_interval(index.T, direction[None], *self.box)
            meets = far > np.maximum(near, 0.0)
            index = index + np.where(meets, np.maximum(near, 0.0), 0.0) * direction[:, None]
            index = index.astype(np.float32)
        depth = self.sun_depths[sun](index, self.sigma_t, hidden)
        return np.where(meets, depth, np.float32(0.0)) if may_be_outside else depth


def _part(values, low, high, times: int):
    """DenseGrid or SparseGrid of voxels from low (3,) to before high (3,); of an array on finer ones if times > 1."""
    if isinstance(values, SparseGrid):
        return values.crop(low, high)
    inside = values[tuple(map(slice, low, high))]
    return DenseGrid(refined(inside, times) if times > 1 else inside)
