# SPDX-License-Identifier: GPL-3.0-or-later
"""Light paths traced backwards from camera rays until they leave all volumes.

Delta tracking (Woodcock et al. 1965; Novak et al., "Monte Carlo Methods for Volumetric Light Transport Simulation",
2018): a majorant in each of many cells keeps null collisions rare. The density at a collision is that of one of the
eight voxels around it, chosen with its weight in the interpolation, which is unbiased since collisions are linear in
the density. Where volumes overlap, the first collision in any of them counts.
"""

from collections.abc import Sequence
from ctypes import c_int32
from dataclasses import dataclass

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..kernels import structures
from ..kernels.library import call
from ..numerics.alike import alike
from ..numerics.box_tree import box_tree
from ..runtime.cancellation import Cancelled
from .marcher import describe_media
from .ray_steps import RayBatch

#: Ends of paths: none without a collision, out of all volumes, or given up after too many steps.
MISSED, LEFT, GIVEN_UP = range(3)
# Collisions of a path and steps of it, at most.
COLLISIONS, STEPS = 500, 20_000
# Fraction of the light at which a path ends.
NEGLIGIBLE = 1e-4
# Optical thickness of cells in which the density is bounded, and most cells of the occupancy that are joined per axis.
THICK, MOST_JOINED = 8.0, 16


@dataclass(frozen=True)
class ScatteringMedia:
    """V media in which paths scatter, in C colour channels of equal extinction.

    media: the suns of which do not matter. channels: their numbers.
    """

    media: Sequence[BoundMedium]
    channels: Sequence[int]

    @property
    def albedos(self) -> np.ndarray:
        """float64 (V, C), 1 where the albedo varies."""
        channels = list(self.channels)
        return np.array([np.ones(len(channels)) if m.varies else m.medium.albedo[channels] for m in self.media])

    @property
    def anisotropies(self) -> np.ndarray:
        """Mean cosines float64 (V,)."""
        return np.array([medium.medium.anisotropy for medium in self.media], np.float64)


@dataclass(frozen=True)
class Majorants:
    """Upper bounds of a density in cells.

    peaks: float32 (x, y, z). first: (3,), position of voxel 0 in the cells, in voxels. scale: cells per voxel.
    """

    peaks: np.ndarray
    first: np.ndarray
    scale: float

    @classmethod
    def of(cls, medium: BoundMedium) -> "Majorants":
        """Cells of about the optical thickness THICK where the medium is densest, or the occupancy's own cells."""
        occupancy = medium.grid.occupancy
        thickness = medium.voxel_thickness * occupancy.cell
        joined = int(np.clip(THICK / max(thickness, 1e-9), 1, MOST_JOINED))
        peaks = occupancy.bounds
        for axis in range(3):
            peaks = np.maximum.reduceat(peaks, np.arange(0, peaks.shape[axis], joined), axis=axis)
        first, scale = np.array(occupancy.first, np.float64), 1.0 / (joined * occupancy.cell)
        return cls(np.ascontiguousarray(peaks, np.float32), first, scale)

    def describe(self) -> structures.Shared:
        """For the kernel."""
        return structures.Occupancy(
            peaks=self.peaks, size=np.array(self.peaks.shape), first=self.first, scale=self.scale
        )


@dataclass(frozen=True)
class PathEnds:
    """Where P paths of each of R rays ended.

    kept: float32 (R, P, C), fraction of the light that collisions have kept. directions: float32 (R, P, 3), in which
    the paths left their last collisions. ends: uint8 (R, P), MISSED, LEFT or GIVEN_UP.
    """

    kept: np.ndarray
    directions: np.ndarray
    ends: np.ndarray


class PathTracer:
    """Traces paths through media. Safe to use on several threads.

    stop: once it is not 0, calls raise Cancelled soon.
    """

    def __init__(self, media: ScatteringMedia, stop: c_int32 | None = None):
        self.media, self.stop, known = media, stop, dict[tuple, Majorants]()
        # Instances share them.
        for medium in media.media:
            key = id(medium.grid.occupancy), alike(medium.voxel_thickness)
            if key not in known:
                known[key] = Majorants.of(medium)
        self.majorants = [known[id(m.grid.occupancy), alike(m.voxel_thickness)] for m in media.media]
        described = {id(majorants): majorants.describe() for majorants in known.values()}
        self._described = (
            describe_media(media.media, (), media.channels, False),
            structures.array_of([described[id(majorants)] for majorants in self.majorants]),
        )
        self._boxes, self._contents = box_tree(np.array([medium.grid.corners() for medium in media.media]))

    def trace(self, rays: RayBatch, numbers: np.ndarray, paths: int) -> PathEnds:
        """Paths from the first collisions of rays; a path collides with the probability of the ray's opacity.

        numbers: int64 (R,), seeds of the paths of each ray. paths: of each ray. Raises Cancelled.
        """
        shape, media = (len(numbers), paths), self.media
        light, leaving = np.zeros((*shape, len(media.channels)), np.float32), np.zeros((*shape, 3), np.float32)
        ends = np.zeros(shape, np.uint8)
        traced = call(
            "trace_paths",
            volumes=len(media.media),
            channels=len(media.channels),
            media=self._described[0],
            majorants=self._described[1],
            leaves=len(self._contents),
            boxes=self._boxes,
            contents=self._contents,
            anisotropies=media.anisotropies,
            albedos=media.albedos,
            rays=len(numbers),
            origins=np.ascontiguousarray(rays.origins, np.float64),
            directions=np.ascontiguousarray(rays.directions, np.float64),
            near_distance=np.ascontiguousarray(rays.near, np.float64),
            far_distance=np.ascontiguousarray(rays.far, np.float64),
            numbers=np.ascontiguousarray(numbers, np.int64),
            paths=paths,
            collisions=COLLISIONS,
            steps=STEPS,
            negligible=NEGLIGIBLE,
            stop=self.stop,
            light=light,
            leaving=leaving,
            ends=ends,
        )
        if traced < len(numbers):
            raise Cancelled
        return PathEnds(light, leaving, ends)
