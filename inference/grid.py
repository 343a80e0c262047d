"""A volume at the density's own resolution: what camera rays and exact shadows read."""

import numpy as np

from .cube import active_bounds
from .rays import box_interval
from .scene import Volume
from .transmittance import sun_optical_depth
from .trilinear import interpolate, locate, occupied_cells, pad_with_zeros, sample_padded

# Optical depth of a voxel above which shadows integrate the first voxel on its own, and
# in how many steps.
THIN_VOXEL = 0.25
LOCAL_STEPS = 3


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
        self.occupied = occupied_cells(self.density)
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
        """Density (N,) at continuous indices float32 (N, 3); empty cells cost one look."""
        base, fraction = locate(self.density, index)
        filled = np.flatnonzero(self.occupied.reshape(-1).take(base))
        density = np.zeros(len(index), np.float32)
        density[filled] = interpolate(self.density, base[filled], fraction[filled])
        return density

    def thickness(self, sigma_t: float) -> float:
        """Largest optical depth of one voxel."""
        return float(self.density.max()) * sigma_t * self.voxel

    def set_extinction(self, sigma_t: float):
        """Turn the suns' optical depths into transmittance for one extinction."""
        self.sigma_t = np.float32(sigma_t)
        self.sun_tr = [np.exp(depth * -self.sigma_t) for depth in self.sun_depths]
        # Where a voxel is thick, the way through the first one is integrated on its own.
        self.local_steps = 0 if self.thickness(sigma_t) < THIN_VOXEL else LOCAL_STEPS

    def sample_sun_tr(self, index: np.ndarray, sun: int, may_be_outside: bool) -> np.ndarray:
        """Transmittance (N,) from continuous indices float32 (N, 3) to a sun.

        Transmittance is interpolated, not optical depth: across a shadow's edge the
        exponential of a mean depth would be too dark. Points outside are moved towards the
        sun onto the support; where that misses it the transmittance is 1.
        """
        direction = self.sun_directions[sun]
        if may_be_outside:
            near, far = box_interval(index, direction[None], *self.box)
            meets = far > np.maximum(near, 0.0)
            index = index + np.where(meets, np.maximum(near, 0.0), 0.0)[:, None] * direction
            index = index.astype(np.float32)
        tau = np.zeros(len(index), np.float32)
        if self.local_steps:
            # To the next slice across the sun's main axis, by the midpoint rule.
            step = 1.0 / (np.abs(direction).max() * self.local_steps)
            move = (direction * step).astype(np.float32)
            index = index + np.float32(0.5) * move
            for _ in range(self.local_steps):
                tau += self.sample_density(index)
                index = index + move
            index -= np.float32(0.5) * move
            tau *= self.sigma_t * np.float32(step)
        # Beyond the support the field holds no cells: the rim, at most one voxel off, stands in.
        last = np.array(self.density.shape, np.float32) - 3
        tr = np.exp(-tau) * sample_padded(self.sun_tr[sun], np.clip(index, np.float32(-1.0), last))
        return np.where(meets, tr, np.float32(1.0)) if may_be_outside else tr
