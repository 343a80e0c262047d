# SPDX-License-Identifier: GPL-3.0-or-later
"""Light paths traced backwards from camera rays until they leave all volumes.

Delta tracking (Woodcock et al. 1965; Novak et al., "Monte Carlo Methods for Volumetric Light Transport Simulation",
2018): a majorant in each of many cells keeps null collisions rare, and one of the eight voxels around a collision,
chosen with its weight in the interpolation, stands for the density there, which is unbiased since collisions are linear
in it. Where volumes overlap, a path collides where it does first in any of them.
"""

from collections.abc import Sequence
from ctypes import c_int32
from dataclasses import dataclass

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.dense_grid import DenseGrid
from ..kernels import structures
from ..kernels.field_structures import LightPaths
from ..kernels.library import Kernels
from ..numerics.random_walk import PLASTIC, PathRandom, scattering_cosine, turned
from ..numerics.small_matmul import product
from ..runtime.cancellation import Cancelled
from ..scene.sparse_grid import EDGE, SparseGrid
from .compiled_march import describe_medium
from .ray_steps import RayBatch

#: Ends of paths: none without a collision, out of all volumes, or given up after too many steps.
MISSED, LEFT, GIVEN_UP = range(3)
# Collisions of a path and steps of it, at most.
COLLISIONS, STEPS = 500, 20_000
# Share of the light at which a path ends.
NEGLIGIBLE = 1e-4
# Optical thickness of cells in which the density is bounded, and how many of the occupancy's are joined at most.
THICK, MOST_JOINED = 8.0, 16
# By what part of a voxel a path steps past the face of a cell.
PAST = 1e-5


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
        """Cells that are about as thick as THICK where the medium is densest, or as thin as there are."""
        occupancy = medium.grid.occupancy
        thickness = medium.voxel_thickness * occupancy.cell
        joined = int(np.clip(THICK / max(thickness, 1e-9), 1, MOST_JOINED))
        peaks = occupancy.bounds
        for axis in range(3):
            peaks = np.maximum.reduceat(peaks, np.arange(0, peaks.shape[axis], joined), axis=axis)
        first, scale = np.array(occupancy.first, np.float64), 1.0 / (joined * occupancy.cell)
        return cls(np.ascontiguousarray(peaks, np.float32), first, scale)

    def describe(self) -> structures.Occupancy:
        """For the kernel."""
        return structures.Occupancy(
            peaks=self.peaks, size=np.array(self.peaks.shape), first=self.first, scale=self.scale
        )


@dataclass(frozen=True)
class PathEnds:
    """Where P paths of each of R rays ended.

    kept: float32 (R, P, C), share of the light that collisions have kept. directions: float32 (R, P, 3), in which the
    paths left their last collisions. ends: uint8 (R, P), MISSED, LEFT or GIVEN_UP.
    """

    kept: np.ndarray
    directions: np.ndarray
    ends: np.ndarray


class PathTracer:
    """Traces paths through media. Safe to use on several threads.

    kernels: compiled ones, or None. stop: once it is not 0, calls raise Cancelled soon.
    """

    def __init__(self, media: ScatteringMedia, kernels: Kernels | None = None, stop: c_int32 | None = None):
        self.media, self.kernels, self.stop = media, kernels, stop
        self.majorants = [Majorants.of(medium) for medium in media.media]
        self._described = [describe_medium(medium, (), media.channels, False) for medium in media.media]

    def trace(self, rays: RayBatch, numbers: np.ndarray, paths: int) -> PathEnds:
        """Paths from the first collisions of rays, which are as many as the rays are opaque.

        numbers: int64 (R,), which decide the paths of each ray. paths: of each ray.
        """
        shape = len(numbers), paths
        kept, leaving = np.zeros((*shape, len(self.media.channels)), np.float32), np.zeros((*shape, 3), np.float32)
        ends = np.zeros(shape, np.uint8)
        if self.kernels is not None:
            self._trace_compiled(self.kernels, rays, numbers, (kept, leaving, ends))
        else:
            walk = _Walk(self.media, self.majorants, numbers, paths)
            walk.follow(rays, kept.reshape(ends.size, -1), leaving.reshape(ends.size, 3), ends.reshape(-1))
        return PathEnds(kept, leaving, ends)

    def _trace_compiled(
        self, kernels: Kernels, rays: RayBatch, numbers: np.ndarray, found: tuple[np.ndarray, np.ndarray, np.ndarray]
    ) -> None:
        """Fill arrays as of PathEnds."""
        kept, leaving, ends = found
        media = self.media
        data = LightPaths(
            volumes=len(media.media),
            channels=len(media.channels),
            media=structures.array_of(self._described),
            majorants=structures.array_of([majorants.describe() for majorants in self.majorants]),
            anisotropies=media.anisotropies,
            albedos=media.albedos,
            rays=len(numbers),
            origins=np.ascontiguousarray(rays.origins, np.float64),
            directions=np.ascontiguousarray(rays.directions, np.float64),
            near_distance=np.ascontiguousarray(rays.near, np.float64),
            far_distance=np.ascontiguousarray(rays.far, np.float64),
            numbers=np.ascontiguousarray(numbers, np.int64),
            paths=ends.shape[1],
            collisions=COLLISIONS,
            steps=STEPS,
            negligible=NEGLIGIBLE,
            stop=self.stop,
            light=kept,
            leaving=leaving,
            ends=ends,
        )
        if kernels.prepare("trace_paths", data) < len(numbers):
            raise Cancelled


class _Walk:
    """N paths that are followed together, some of each ray.

    numbers: int64 (R,), which decide the random numbers of each ray.
    """

    def __init__(self, media: ScatteringMedia, majorants: Sequence[Majorants], numbers: np.ndarray, paths: int):
        self.media, self.majorants = media, majorants
        self.ray, path = np.divmod(np.arange(len(numbers) * paths), paths)
        self.random = PathRandom(numbers[self.ray] * paths + path)
        of_rays, rays = PathRandom(-1 - numbers), np.arange(len(numbers))
        shift = np.stack([of_rays.draw(rays) for _ in PLASTIC], axis=1)
        first = shift[self.ray] + path[:, None] * PLASTIC
        # In which directions, of the phase function, the paths scatter first.
        self.first = first - np.floor(first)
        self.places, self.along = np.zeros((2, len(path), 3))
        self.left = np.full(len(path), STEPS)
        # Of the last collision: the volume, or -1, and the voxel.
        self.volume, self.voxel = np.full(len(path), -1), np.zeros((len(path), 3), np.int64)

    def follow(self, rays: RayBatch, kept: np.ndarray, leaving: np.ndarray, ends: np.ndarray) -> None:
        """Fill arrays (N, ...) as of PathEnds."""
        self.places[:], self.along[:] = rays.origins[self.ray], rays.directions[self.ray]
        self._collide(np.arange(len(self.ray)), rays.near[self.ray], rays.far[self.ray])
        some = np.flatnonzero(self.volume >= 0)
        kept[some], ends[some] = 1.0, GIVEN_UP
        albedos, anisotropies = self.media.albedos, self.media.anisotropies
        for number in range(COLLISIONS):
            share = albedos[self.volume[some]] * self._varying(some)
            kept[some] = (kept[some] * share).astype(np.float32)
            bright = kept[some].max(axis=1) > NEGLIGIBLE
            kept[some[~bright]], ends[some[~bright]] = 0.0, LEFT
            some = some[bright]
            if not len(some):
                return
            drawn = self.first[some] if number == 0 else self._two(some)
            cosine = scattering_cosine(anisotropies[self.volume[some]], drawn[:, 0])
            self.along[some] = turned(self.along[some], cosine, 2.0 * np.pi * drawn[:, 1])
            leaving[some] = self.along[some]
            self._collide(some, np.zeros(len(some)), np.full(len(some), np.inf))
            gone = self.volume[some] < 0
            ends[some[gone & (self.left[some] > 0)]] = LEFT
            some = some[~gone]

    def _two(self, some: np.ndarray) -> np.ndarray:
        """Two random numbers of each path, (N, 2)."""
        first = self.random.draw(some)
        return np.stack([first, self.random.draw(some)], axis=1)

    def _varying(self, some: np.ndarray) -> np.ndarray:
        """Albedo (N, C) of the voxels in which paths collide, 1 where it does not vary."""
        found = np.ones((len(some), len(self.media.channels)))
        for v, medium in enumerate(self.media.media):
            here = self.volume[some] == v
            if medium.varies and here.any():
                at = self.voxel[some[here]]
                density = _voxels(medium.grid.density, at).astype(np.float64)
                for c, channel in enumerate(self.media.channels):
                    found[here, c] = _voxels(medium.grid.scattering_of(channel), at) / density
        return found

    def _collide(self, some: np.ndarray, near: np.ndarray, far: np.ndarray) -> None:
        """Move paths to their next collisions."""
        self.volume[some] = -1
        nearest = far.copy()
        for v, medium in enumerate(self.media.media):
            distance, voxel = self._fly(medium, self.majorants[v], some, near, nearest)
            met = distance < nearest
            self.volume[some[met]], self.voxel[some[met]], nearest[met] = v, voxel[met], distance[met]
        met = self.volume[some] >= 0
        self.places[some[met]] += nearest[met, None] * self.along[some[met]]

    def _fly(
        self, medium: BoundMedium, cells: Majorants, some: np.ndarray, near: np.ndarray, far: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) of the first collisions in a volume, far where there are none, and their voxels (N, 3)."""
        shape = np.array(medium.grid.shape, np.float64)
        start, move = medium.grid.index(self.places[some]), product(self.along[some], medium.linear.T)
        moves = np.abs(move) > 1e-30
        inverse = np.where(moves, 1.0 / np.where(moves, move, 1.0), 0.0)
        low, high = np.full(3, -1.0), shape
        enter = np.where(moves, (np.where(move > 0.0, low, high) - start) * inverse, -np.inf).max(axis=1)
        leave = np.where(moves, (np.where(move > 0.0, high, low) - start) * inverse, np.inf).min(axis=1)
        missed = (~moves & ~((start > low) & (start < high))).any(axis=1)
        at, end = np.maximum(near, enter), np.where(missed, -np.inf, np.minimum(far, leave))
        found, voxel = far.copy(), np.zeros((len(some), 3), np.int64)
        past = PAST / np.abs(move).max(axis=1)
        going = np.flatnonzero(at < end)
        need = np.zeros(len(some))
        need[going] = -np.log(1.0 - self.random.draw(some[going]))
        size, edge = np.array(cells.peaks.shape), 1.0 / cells.scale
        while len(going := going[(at[going] < end[going]) & (self.left[some[going]] > 0)]):
            self.left[some[going]] -= 1
            s, m, t = start[going], move[going], at[going]
            cell = np.clip((s + t[:, None] * m + cells.first) * cells.scale, 0.0, size - 1).astype(np.int64)
            plane = (cell + (m > 0.0)) * edge - cells.first
            distance = np.where(moves[going], (plane - s) * inverse[going], np.inf)
            distance[distance <= t[:, None]] = np.inf
            face = np.minimum(np.minimum(distance.min(axis=1), end[going]) + past[going], end[going])
            bound = medium.sigma_t * cells.peaks[tuple(cell.T)].astype(np.float64)
            supply = (face - t) * bound
            meets = need[going] < supply
            on = going[~meets]
            need[on] -= supply[~meets]
            at[on] = face[~meets]
            hit = going[meets]
            at[hit] += need[hit] / bound[meets]
            voxel[hit] = self._voxel_around(start[hit] + at[hit, None] * move[hit], some[hit])
            density = medium.sigma_t * _voxels(medium.grid.density, voxel[hit]).astype(np.float64)
            real = self.random.draw(some[hit]) * bound[meets] < density
            found[hit[real]] = at[hit[real]]
            end[hit[real]] = -np.inf
            null = hit[~real]
            need[null] = -np.log(1.0 - self.random.draw(some[null]))
        return found, voxel

    def _voxel_around(self, index: np.ndarray, which: np.ndarray) -> np.ndarray:
        """One of the eight voxels int64 (N, 3) around continuous indices (N, 3), with its weight in interpolation."""
        bits = self.random.bits(which)
        parts = np.stack([bits >> np.uint64(21 * k) & np.uint64(0x1FFFFF) for k in range(3)], axis=1)
        return np.floor(index + parts.astype(np.float64) * 2.0**-21).astype(np.int64)


def _voxels(grid: DenseGrid | SparseGrid, index: np.ndarray) -> np.ndarray:
    """Values float32 (N,) of voxels int64 (N, 3), from -1 to the grid's shape."""
    if isinstance(grid, DenseGrid):
        at = np.clip(index + 1, 0, np.array(grid.padded.shape) - 1)
        return grid.padded[tuple(at.T)]
    at = np.clip(index + grid.first, 0, EDGE * np.array(grid.table.shape) - 1)
    block, inside = np.divmod(at, EDGE)
    return grid.values[(grid.table[tuple(block.T)], *inside.T)]
