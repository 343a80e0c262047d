# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depth from any point of a grid towards a lamp, which may be inside.

Around the lamp, space is divided into six pyramids, by the index axis along which a point is farthest from it. Each
stores optical depths from the lamp on slices across its axis, in columns along the lamp's rays, which start from one
point: the columns of a slice are those of the next, closer together. As for suns, one sweep goes through the planes of
voxel centres; each is interpolated once, cubically, at the columns, and adds to the slices before and after it.
"""

from dataclasses import dataclass

import numpy as np

from ..kernels import structures
from ..kernels.library import call
from ..numerics.small_matmul import inverse, product
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.emitters import LampSource
from ..scene.sparse_grid import SparseGrid
from .dense_grid import DenseGrid
from .described import describe_grid
from .sphere_depth import excess_depths

# Largest number of columns along each axis of a slice, and of slices of a pyramid.
MAX_COLUMNS, MAX_SLICES = 384, 384
# Cells that one call of the kernel sweeps.
CELLS_PER_CALL = 1 << 22
# Optical thickness of a voxel above which the last part of the way is integrated.
THIN_VOXEL = 0.35
# Distance in voxels to which the lamp is moved away from slices.
CLOSEST = 1e-6
# Optical depth of a sphere's radius from which on its light does not start at points.
THIN_SPHERE = 1e-3
# Directions to the corners, edges and faces of a cube, and radii at which the density of a sphere is read along them.
DIRECTIONS = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3, indexing="ij")).reshape(3, -1)[:, np.arange(27) != 13]
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=0)
RADII = (np.arange(8) + 0.5) / 8.0


@dataclass(frozen=True)
class _Pyramid:
    """Optical depths around one direction of an axis.

    axis: along which it extends. sign: of that direction. others: the other axes. planes: int (P,), indices of voxel
    centres along the axis, away from the lamp. every: planes from one slice to the next. starts: (slices,), distances
    of the slices from the lamp in voxels, ascending; the first is where the grid or the lamp is, where the depth is 0.
    first: (2,), slopes of the first columns. spacing: (2,), of their slopes. depths: float32 (slices, b, c), integrals
    of density over the distance along the axis.
    """

    axis: int
    sign: float
    others: list[int]
    planes: np.ndarray
    every: int
    starts: np.ndarray
    first: np.ndarray
    spacing: np.ndarray
    depths: np.ndarray

    @property
    def number(self) -> int:
        """Index among the six pyramids."""
        return 2 * self.axis + (self.sign < 0.0)

    @property
    def slices(self) -> np.ndarray:
        """int (P,), number of the slice on each plane, 0 where there is none."""
        numbers = np.arange(1, len(self.planes) + 1)
        stored = (numbers % self.every == 0) | (numbers == len(numbers))
        return np.where(stored, -(-numbers // self.every), 0)

    def ways(self, lamp: np.ndarray) -> np.ndarray:
        """Distances along the axis (P, 2) from each plane to the planes before and after it; lamp: (3,), index."""
        along = self.sign * (self.planes - lamp[self.axis])
        ends = np.diff(along, prepend=self.starts[0])
        return np.stack([ends, np.append(ends[1:], 0.0)], axis=1)

    def described(self) -> structures.Shared:
        """As compiled kernels read it."""
        return structures.Pyramid(
            depths=self.depths,
            starts=self.starts,
            slices=len(self.starts),
            size=np.array(self.depths.shape[1:]),
            first=self.first,
            spacing=self.spacing,
        )


class LampOpticalDepth:
    """Optical depth through one grid towards a lamp, for an extinction of 1 per unit density and world unit.

    For a lamp with a radius the depth is -ln of the mean transmittance to the side that a point sees; the density
    within the lamp counts as uniform. grid: DenseGrid or SparseGrid. linear: (3, 3) and offset: (3,), continuous
    indices from world positions. source: of the lamp's light, in the world. apart: voxels from one column to the next
    where they leave the grid. Raises Cancelled.
    """

    def __init__(
        self,
        grid: DenseGrid | SparseGrid,
        linear: np.ndarray,
        offset: np.ndarray,
        source: LampSource,
        apart: float = 1.0,
        cancel: CancelToken = NEVER,
    ):
        self.grid, self.world_from_index = grid, inverse(linear)
        self.lamp = linear @ source.position + offset
        self.source, self.centre = source, linear @ source.centre + offset
        self._around = self._density_around(linear) if source.radius > 0.0 else 0.0
        self.longest = float(np.linalg.norm(self.world_from_index, axis=0).max())
        self._apart = apart
        pyramids = [self._pyramid(axis, sign) for axis in range(3) for sign in (1.0, -1.0)]
        self.pyramids = [pyramid for pyramid in pyramids if pyramid is not None]
        for pyramid in self.pyramids:
            self._fill(pyramid, cancel)

    @property
    def inside(self) -> bool:
        """Whether the lamp is within the grid."""
        return bool(np.all((self.lamp > -1.0) & (self.lamp < np.array(self.grid.shape))))

    def _density_around(self, linear: np.ndarray) -> float:
        """Mean density along the radii of the lamp's sphere."""
        away = (linear @ DIRECTIONS)[:, :, None] * (self.source.radius * RADII)
        return float(self.grid.sample((self.centre[:, None, None] + away).reshape(3, -1).astype(np.float32)).mean())

    def _excess(self, sigma_t: float, forward: float) -> np.ndarray | None:
        """`excess_depths` of this lamp; None where its sphere is so thin that light may start at points."""
        thickness = self._around * self.source.radius * sigma_t
        if thickness <= THIN_SPHERE:
            return None
        apart = float(np.linalg.norm(self.source.position - self.source.centre)) / self.source.radius
        return excess_depths(thickness, self.source.soft_falloff, apart, forward)

    def _pyramid(self, axis: int, sign: float) -> _Pyramid | None:
        """A pyramid whose depths are 0, or None where it misses the grid."""
        low, high = np.full(3, -1.0) - self.lamp, np.array(self.grid.shape, np.float64) - self.lamp
        near, far = sorted((sign * low[axis], sign * high[axis]))
        if far <= CLOSEST:
            return None
        near, others = max(near, CLOSEST), [other for other in range(3) if other != axis]
        slopes = []
        for other in others:
            least = low[other] / (near if low[other] < 0.0 else far)
            most = high[other] / (near if high[other] > 0.0 else far)
            slopes.append((max(least, -1.0), min(most, 1.0)))
        if any(least >= most for least, most in slopes):
            return None
        first = np.array([least for least, _ in slopes])
        width = np.array([most - least for least, most in slopes])
        count = np.clip(np.ceil(width * far / self._apart).astype(int) + 1, 2, MAX_COLUMNS)
        spacing = width / (count - 1)
        begin, end = (int(np.ceil(distance + sign * self.lamp[axis] - CLOSEST)) for distance in (near, far))
        planes = int(sign) * np.arange(begin, end + 1)
        along = sign * (planes - self.lamp[axis])
        start = 0.0 if near == CLOSEST else near
        planes = planes[along > start + CLOSEST]
        every = -(-len(planes) // MAX_SLICES)
        ends = sign * (np.append(planes[every - 1 : -1 : every], planes[-1]) - self.lamp[axis])
        starts = np.append(start, ends)
        depths = np.zeros((len(starts), *count), np.float32)
        return _Pyramid(axis, sign, others, planes, every, starts, first, spacing, depths)

    def _fill(self, pyramid: _Pyramid, cancel: CancelToken) -> None:
        slices, ways = pyramid.slices, 0.5 * pyramid.ways(self.lamp)
        running = np.zeros(pyramid.depths.shape[1:], np.float32)
        # A first slice elsewhere than at the lamp lies where the density begins.
        inside = pyramid.starts[0] == 0.0
        b, c = (self.grid.shape[axis] for axis in pyramid.others)
        scratch = np.empty(5 * running.shape[1] + c + 6 + b * c, np.float32)
        cells = np.empty(running.shape[1], np.int32)
        planes_per_call = max(CELLS_PER_CALL // max(running.size, b * c), 1)
        for start in range(0, len(slices), planes_per_call):
            cancel.check()
            batch = slice(start, start + planes_per_call)
            call(
                "fill_lamp_columns",
                density=describe_grid(self.grid),
                pyramid=pyramid.described(),
                axis=pyramid.axis,
                lamp=self.lamp,
                inside=inside and not start,
                planes=len(slices[batch]),
                numbers=pyramid.planes[batch].astype(np.int64),
                slices=slices[batch].astype(np.int64),
                ways=np.ascontiguousarray(ways[batch]),
                running=running,
                scratch=scratch,
                cells=cells,
            )

    def described(self, sigma_t: float, forward: float = 0.0) -> structures.Shared:
        """As compiled kernels read it; sigma_t, forward: as for calls."""
        pyramids = [structures.Pyramid() for _ in range(6)]
        for pyramid in self.pyramids:
            pyramids[pyramid.number] = pyramid.described()
        columns = structures.LampColumns(
            density=describe_grid(self.grid),
            pyramids=(structures.Pyramid * 6)(*pyramids),
            lamp=self.lamp,
            world_from_index=self.world_from_index,
            integrated=self._thick(sigma_t),
            centre=self.centre,
            radius=self.source.radius,
            offset=self.source.position - self.source.centre,
            soft_falloff=self.source.soft_falloff,
            around=self._around,
            uneven=self._uneven(forward),
            excess=self._excess(sigma_t, forward),
        )
        columns.referenced += pyramids
        return columns

    def _uneven(self, forward: float) -> bool:
        """Whether the excess depth varies with the density along the ray."""
        return self.source.soft_falloff and forward > 0.0

    def _thick(self, sigma_t: float) -> bool:
        """Whether voxels are so thick that the last part of the way is integrated."""
        return bool(self.grid.peak * sigma_t * self.longest > THIN_VOXEL)

    def outwards(self, sigma_t: float) -> tuple[np.ndarray, np.ndarray]:
        """Optical depths (N,) from the lamp out of the grid, and the fractions (N,) of all directions they stand for.

        The fractions sum to less than 1 where rays from the lamp miss the grid.
        """
        depths, fractions = [np.zeros(0)], [np.zeros(0)]
        for pyramid in self.pyramids:
            u, v = (
                first + space * np.arange(n)
                for first, space, n in zip(pyramid.first, pyramid.spacing, pyramid.depths.shape[1:])
            )
            rays = np.zeros((3, len(u), len(v)))
            rays[pyramid.axis] = pyramid.sign
            rays[pyramid.others[0]], rays[pyramid.others[1]] = u[:, None], v
            length = np.linalg.norm(product(np.moveaxis(rays, 0, -1), self.world_from_index.T), axis=-1)
            depths.append((sigma_t * pyramid.depths[-1] * length).ravel())
            # Solid angles in the frame of the voxels; columns at an edge stand for half.
            angle = (rays**2).sum(axis=0) ** -1.5 * np.prod(pyramid.spacing) / (4.0 * np.pi)
            angle[[0, -1]] *= 0.5
            angle[:, [0, -1]] *= 0.5
            fractions.append(angle.ravel())
        return np.concatenate(depths), np.concatenate(fractions)

    def __call__(self, index: np.ndarray, sigma_t: float, forward: float = 0.0) -> np.ndarray:
        """Optical depth float32 (N,) at continuous indices float32 (3, N), inside or outside the grid.

        sigma_t: extinction per unit density and world unit, less the fraction `forward` that scatters straight on.
        """
        depth = np.empty(index.shape[1], np.float32)
        call(
            "lamp_depths",
            columns=self.described(sigma_t, forward),
            points=len(depth),
            index=np.ascontiguousarray(index, np.float32),
            sigma_t=sigma_t,
            out=depth,
        )
        return depth
