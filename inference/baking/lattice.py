# SPDX-License-Identifier: GPL-3.0-or-later
"""The voxels in which light is baked: as fine as the picture needs, and only those that a ray can see."""

from dataclasses import dataclass

import numpy as np

from ..grids.bounds import filled_bounds
from ..grids.grid import Grid
from ..grids.optical_depth_sweep import sun_optical_depth
from ..numerics.small_matmul import affine_inverse, inverse, product
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.camera import Camera
from ..scene.description import Volume
from ..scene.errors import SceneError
from ..scene.settings import Settings
from ..scene.sparse_grid import SparseGrid
from .directional_factor import BakedView

# Optical depth behind which nothing is seen.
UNSEEN_DEPTH = 20.0
# Cells along the longest edge of the grid on which visibility is computed.
VISIBILITY_CELLS = 64
# Baked voxels per pixel: two pixels on an edge of the volume keep their difference.
VOXELS_PER_PIXEL = 2.0
# Baked voxels along the longest edge of a volume of few pixels. Light that is baked beside it is not absorbed in it.
FEWEST_VOXELS = 32
# Bytes per baked voxel: emission, what is predicted of it, density and masks.
VOXEL_BYTES = 40

# Points of a lattice, as shares of its edges (9, 3), along whose rays visibility from a viewer is computed: those of
# DIRECTIONS are too far apart for the gaps of ragged clouds.
VIEWED = np.concatenate([np.full((1, 3), 0.5), 0.25 + 0.5 * np.array(list(np.ndindex(2, 2, 2)))])
#: Unit directions (26, 3) to the neighbours of a cell, and the weights (26,) of Lebedev's quadrature on them.
STEPS = np.array([step for step in np.ndindex(3, 3, 3) if step != (1, 1, 1)]) - 1
DIRECTIONS = STEPS / np.linalg.norm(STEPS, axis=1)[:, None]
WEIGHTS = np.array([1.0 / 21.0, 4.0 / 105.0, 9.0 / 280.0])[np.abs(STEPS).sum(axis=1) - 1]


@dataclass(frozen=True)
class BakeLattice:
    """Voxels of one volume in which light is baked, and one more beyond each face.

    density: float32 (nx, ny, nz). world_from_index: float64 (4, 4). coarsening: voxels of the volume along an edge of
    one of these.
    """

    density: np.ndarray
    world_from_index: np.ndarray
    coarsening: int

    def positions(self, voxels: np.ndarray) -> np.ndarray:
        """World positions (N, 3) of the centres of voxels int (N, 3)."""
        return product(np.asarray(voxels, np.float64), self.world_from_index[:3, :3].T) + self.world_from_index[:3, 3]

    def voxels(self, positions: np.ndarray) -> np.ndarray:
        """The nearest voxels int (N, 3) of world positions (N, 3)."""
        inverse = affine_inverse(self.world_from_index)
        index = np.rint(product(positions, inverse[:3, :3].T) + inverse[:3, 3]).astype(np.int64)
        return np.clip(index, 0, np.array(self.density.shape) - 1)

    @property
    def voxel(self) -> float:
        """Longest edge of a voxel in world units."""
        return float(np.linalg.norm(self.world_from_index[:3, :3], axis=0).max())


def make_lattice(volume: Volume, grid: Grid, camera: Camera | None, settings: Settings) -> BakeLattice:
    """The voxels of a volume around what is not empty, or larger ones.

    grid: of the volume. settings: of these `memory_limit`, `most_voxels`, and `small_voxels` of `optimizations`, with
    which voxels much smaller than a pixel of the camera are joined. Raises SceneError where the memory limit does not
    suffice.
    """
    bounds = [found for found in map(filled_bounds, (volume.density, *volume.emission_channels())) if found is not None]
    low, high = np.min([b[0] for b in bounds], axis=0), np.max([b[1] for b in bounds], axis=0)
    times = 1
    if camera is not None and "small_voxels" in settings.optimizations:
        longest = float(np.linalg.norm(volume.world_from_index[:3, :3], axis=0).max())
        times = joined_voxels(camera, grid.corners(), longest)
    if settings.most_voxels:
        times = max(times, int(-(-(high - low).max() // settings.most_voxels)))
    shape = -(-(high - low) // times) + 2
    needed = float(np.prod(shape.astype(float))) * VOXEL_BYTES
    if needed > settings.memory_limit:
        raise SceneError(
            f"{volume.name}: baking its light needs about {needed / 2**30:.1f} GiB and the memory limit is "
            f"{settings.memory_limit / 2**30:.1f} GiB; raise the limit, or resample the volume's grids"
        )
    frame = np.eye(4)
    frame[:3, :3] = volume.world_from_index[:3, :3] * times
    # A voxel more on each side, since light is continued beyond the density.
    first = low + 0.5 * (times - 1) - times
    frame[:3, 3] = volume.world_from_index[:3, :3] @ first + volume.world_from_index[:3, 3]
    if isinstance(volume.density, SparseGrid):
        density = volume.density.crop(low, high).dense()
    else:
        density = volume.density[tuple(map(slice, low, high))]
    return BakeLattice(np.pad(block_means(density, times), 1), frame, times)


def joined_voxels(camera: Camera, corners: np.ndarray, voxel: float) -> int:
    """Voxels along an edge of a baked one that the camera's pixels do not resolve, while the volume has enough of them.

    corners: (8, 3), of the volume in the world. voxel: longest edge of its voxels, world units.
    """
    # The longest edge of a box is at least its diagonal's length over the root of 3.
    diagonal = 2.0 * float(np.linalg.norm(corners - corners.mean(axis=0), axis=1).max())
    largest = min(_pixel_size(camera, corners) / VOXELS_PER_PIXEL, diagonal / (np.sqrt(3.0) * FEWEST_VOXELS))
    return max(int(largest / voxel), 1)


def _pixel_size(camera: Camera, corners: np.ndarray) -> float:
    """Smallest size in the world of a pixel of the camera, on a convex hull of corners (N, 3)."""
    width, height = camera.resolution
    shorter = min(camera.pixel_aspect, 1.0) / width
    if camera.projection == "orthographic":
        return camera.ortho_scale * shorter
    # No point of the hull is nearer than its nearest corner less its diameter.
    diameter = float(np.linalg.norm(corners.max(axis=0) - corners.min(axis=0)))
    middle = 0.5 * (corners.max(axis=0) + corners.min(axis=0))
    distance = max(float(np.linalg.norm(middle - camera.world_matrix[:3, 3])) - 0.5 * diameter, 0.0)
    if camera.projection == "perspective":
        return distance * 2.0 * np.tan(0.5 * camera.fov) * shorter
    spans = (
        abs(camera.longitude[1] - camera.longitude[0]) / width,
        abs(camera.latitude[1] - camera.latitude[0]) / height,
    )
    return distance * min(spans)


class Visibility:
    """Optical depths from within one volume to its outside, on coarse cells.

    depths: float32 (26, cx, cy, cz), towards DIRECTIONS. cell: voxels of the lattice along an edge of a cell.
    """

    def __init__(self, lattice: BakeLattice, sigma_t: float, cancel: CancelToken = NEVER):
        self.shape = np.array(lattice.density.shape)
        self.cell = int(-(-self.shape.max() // VISIBILITY_CELLS))
        self._extinction = block_means(lattice.density, self.cell) * np.float32(sigma_t)
        frame = lattice.world_from_index[:3, :3] * self.cell
        self._index_from_world, self._cancel = inverse(frame), cancel
        self.depths = np.stack([self._depths(direction) for direction in DIRECTIONS])
        # From the middle of a cell to its corners.
        edge = np.linalg.norm(frame, axis=0).max()
        self._within = np.float32(0.5 * np.sqrt(3.0) * edge) * self._extinction

    def _depths(self, direction: np.ndarray) -> np.ndarray:
        """Optical depths (cx, cy, cz) towards a unit direction (3,) in the world."""
        self._cancel.check()
        return sun_optical_depth(self._extinction, self._index_from_world @ direction)

    def seen(self) -> np.ndarray:
        """bool (nx, ny, nz): voxels that some straight line reaches from outside within UNSEEN_DEPTH."""
        return self._in_voxels(self.depths.min(axis=0) - self._within < UNSEEN_DEPTH)

    def towards(self, view: BakedView, lattice: BakeLattice) -> np.ndarray:
        """Transmittance float32 (nx, ny, nz) from voxels towards the viewer; without one, in the clearest direction."""
        cells = np.indices(self.depths.shape[1:]).reshape(3, -1)
        rays = view.directions(lattice.positions(cells.T * self.cell + 0.5 * (self.cell - 1)))
        if rays is None:
            return self._in_voxels(np.exp(-self.depths.min(axis=0)))
        viewed = view.directions(lattice.positions(VIEWED * (self.shape - 1.0)))
        assert viewed is not None
        towards = np.concatenate([DIRECTIONS, np.unique(-viewed, axis=0)])
        further = [self._depths(direction) for direction in towards[len(DIRECTIONS) :]]
        known = np.concatenate([self.depths, further])
        nearest = product(rays, -towards.T).argmax(axis=1)
        depths = known.reshape(len(towards), -1)[nearest, np.arange(len(nearest))]
        if view.position is not None:
            # Nothing behind a viewer within the volume hides anything.
            place = affine_inverse(lattice.world_from_index) @ [*view.position, 1.0]
            at = np.floor((place[:3] + 0.5) / self.cell).astype(int)
            if np.all((at >= 0) & (at < self.depths.shape[1:])):
                depths = np.maximum(depths - known[(nearest, *at)], np.float32(0.0))
        return self._in_voxels(np.exp(-depths).reshape(self.depths.shape[1:]))

    @property
    def most_extinction(self) -> float:
        """Largest extinction of a cell per world unit."""
        return float(self._extinction.max())

    def extinction(self, voxels: np.ndarray) -> np.ndarray:
        """Extinction per world unit, float32 (N,), of the cells around voxels int (N, 3)."""
        x, y, z = (voxels // self.cell).T
        return self._extinction[x, y, z]

    def openness(self, voxels: np.ndarray) -> np.ndarray:
        """Mean transmittance (N,) of all directions from voxels int (N, 3) to the outside."""
        mean: np.ndarray = np.einsum("d,dxyz->xyz", WEIGHTS, np.exp(-self.depths))
        return mean[tuple((voxels // self.cell).T)]

    def _in_voxels(self, cells: np.ndarray) -> np.ndarray:
        for axis, size in enumerate(self.shape):
            cells = cells.repeat(self.cell, axis).take(range(size), axis)
        return cells

    def transmittances(self, voxels: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Transmittance float32 (N, D) from voxels int (N, 3) towards unit directions (D, 3)."""
        x, y, z = (voxels // self.cell).T
        found = []
        for direction in directions:
            known = np.abs(DIRECTIONS - direction).max(axis=1) < 1e-6
            depths = self.depths[known.argmax()] if known.any() else self._depths(direction)
            found.append(np.exp(-depths[x, y, z]))
        return np.stack(found, axis=1)


def block_means(values: np.ndarray, size: int) -> np.ndarray:
    """Means of blocks of size^3 values; blocks at the end are filled up with zeros."""
    if size == 1:
        return values
    means = np.pad(values, [(0, -n % size) for n in values.shape]).astype(np.float32, copy=False)
    for axis in range(3):
        # Sums of slices: numpy is slow to reduce several short axes at once.
        slices = [means[(slice(None),) * axis + (slice(first, None, size),)] for first in range(size)]
        means = np.ascontiguousarray(sum(slices[1:], slices[0])) * np.float32(1.0 / size)
    return means
