"""A volume at the density's own resolution: what camera rays and exact shadows read."""

import numpy as np

from .cube import active_bounds
from .rays import box_interval
from .scene import Volume
from .transmittance import sun_optical_depth
from .trilinear import pad_with_zeros, sample_padded


class Grid:
    """The active part of a volume's density and its optical depth towards each sun.

    Indices count from the first active voxel's centre; the support of the trilinear
    interpolation is the box from -1 to the number of voxels on each axis. All optical
    depths are for an extinction of 1 per unit density and world unit.
    """

    def __init__(self, volume: Volume):
        low, high = active_bounds(volume.density)
        active = volume.density[tuple(slice(l, h) for l, h in zip(low, high))]
        self.density = pad_with_zeros(active)
        self.box = np.full(3, -1.0), np.array(active.shape, np.float64)
        index_from_world = np.linalg.inv(volume.world_from_index)
        self.linear = index_from_world[:3, :3]
        self.offset = index_from_world[:3, 3] - low
        self.voxel = float(np.linalg.norm(volume.world_from_index[:3, :3], axis=0).min())
        self.sun_directions, self.sun_depths = [], []

    def add_sun(self, direction: np.ndarray):
        """Prepare the optical depth towards a sun; direction: (3,) unit vector in the world."""
        index_direction = self.linear @ direction
        depth = sun_optical_depth(self.density, index_direction)
        self.sun_directions.append(index_direction)
        self.sun_depths.append(depth)

    def index(self, world: np.ndarray) -> np.ndarray:
        """World positions (N, 3) as continuous indices, float64."""
        return world @ self.linear.T + self.offset

    def interval(self, origins, directions):
        """Distances at which world rays enter and leave the grid's support."""
        return box_interval(self.index(origins), directions @ self.linear.T, *self.box)

    def sample_density(self, index: np.ndarray) -> np.ndarray:
        """Density at continuous indices float32 (N, 3)."""
        return sample_padded(self.density, index)

    def sample_sun_depth(self, index: np.ndarray, sun: int, may_be_outside: bool) -> np.ndarray:
        """Optical depth (N,) from continuous indices (N, 3) towards a sun.

        Points outside are moved towards the sun onto the support; where that misses it
        the depth is 0.
        """
        depth = self.sun_depths[sun]
        # The padded lattice's index 0 is voxel -1.
        last = np.array(depth.shape, np.float32) - 2
        if not may_be_outside:
            return sample_padded_inside(depth, index, last)
        near, far = box_interval(index, self.sun_directions[sun][None], *self.box)
        meets = far > np.maximum(near, 0.0)
        moved = index + np.maximum(near, 0.0)[:, None] * np.where(meets[:, None], self.sun_directions[sun], 0.0)
        result = sample_padded_inside(depth, moved.astype(np.float32), last)
        return np.where(meets, result, np.float32(0.0))


def sample_padded_inside(padded, index, last):
    """As `sample_padded`, clamped to the support: for fields that are not 0 outside."""
    return sample_padded(padded, np.clip(index, np.float32(-1.0), last - np.float32(1.0)))
