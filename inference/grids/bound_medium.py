# SPDX-License-Identifier: GPL-3.0-or-later
"""A medium bound to its grid and to the extinction of colour channels, for ray marching."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..kernels import structures
from ..kernels.library import call
from ..numerics.small_matmul import affine_inverse
from ..scene.description import Medium, Velocity
from ..scene.sparse_grid import SparseGrid
from .dense_grid import DenseGrid
from .described import describe_grid
from .grid import CORNERS, Grid
from .sun_optical_depth import SunOpticalDepth


@dataclass(frozen=True)
class Flow:
    """Velocities that carry what a volume holds, as eyes see it.

    velocity: of the volume. grids: of its components. times: float64 (E,), since the frame, at which each eye sees.
    """

    velocity: Velocity
    grids: Sequence[DenseGrid | SparseGrid]
    times: np.ndarray

    @functools.cached_property
    def described(self) -> structures.Shared:
        """As compiled kernels read it."""
        index_from_world = affine_inverse(self.velocity.world_from_index)
        components = [describe_grid(grid) for grid in self.grids]
        described = structures.Flow(
            components=(structures.Grid * 3)(*components),
            linear=index_from_world[:3, :3],
            offset=index_from_world[:3, 3],
            turn=self.velocity.world_from_velocity,
        )
        described.referenced += components
        return described

    def velocities(self, places: np.ndarray, eyes: np.ndarray) -> np.ndarray:
        """Velocities float64 (N, 3), world units per unit of time, of what eyes, int (N,), see at places (N, 3)."""
        found = np.empty((3, len(places)))
        call(
            "flow_velocities",
            flow=self.described,
            points=len(places),
            places=np.ascontiguousarray(places.T),
            times=np.ascontiguousarray(self.times[eyes]),
            velocities=found,
        )
        return found.T

    def apparent(self, places: np.ndarray, eyes: np.ndarray) -> np.ndarray:
        """Velocities float64 (N, 3) at which what eyes see at places (N, 3) moves on, as of `velocities`.

        The velocity u changes from place to place, so that what is seen moves by u / (1 - t du/ds) along u: where the
        flow slows down, it piles up and hardly moves.
        """
        found = self.velocities(places, eyes)
        step = np.linalg.norm(self.velocity.world_from_index[:3, :3], axis=0).min()
        speed = np.linalg.norm(found, axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            along = found / np.maximum(speed, 1e-30)[:, None]
            there = np.einsum("ni,ni->n", self.velocities(places + step * along, eyes), along)
            slowed = 1.0 - self.times[eyes] * (there - speed) / step
        return found / np.nan_to_num(np.maximum(slowed, 1.0), nan=1.0)[:, None]

    @staticmethod
    def grids_of(velocity: Velocity) -> list[DenseGrid | SparseGrid]:
        """Its components, which instances share."""
        return [
            grid.crop((0, 0, 0), grid.shape) if isinstance(grid, SparseGrid) else DenseGrid(grid)
            for grid in velocity.components
        ]

    def support(self, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest index (3,) in a volume's grid at which any eye may see what it holds."""
        # Only where there is velocity does anything come from elsewhere.
        ends = np.where(CORNERS, np.array([c.shape for c in self.velocity.components]).max(axis=0), -1.0)
        matrix = self.velocity.world_from_index
        corners = grid.index(ends @ matrix[:3, :3].T + matrix[:3, 3])
        turn = grid.linear @ self.velocity.world_from_velocity
        values = np.array([[min(float(c.min()), 0.0), max(float(c.max()), 0.0)] for c in self.velocity.components])
        shifts = turn[:, :, None, None] * values[None, :, :, None] * [self.times.min(), self.times.max()]
        shifts = shifts.reshape(3, 3, 4)
        (low, high) = grid.box
        least = low + np.minimum(shifts.min(axis=2), 0.0).sum(axis=1)
        most = high + np.maximum(shifts.max(axis=2), 0.0).sum(axis=1)
        return (
            np.maximum(least, np.minimum(low, corners.min(axis=0))),
            np.minimum(most, np.maximum(high, corners.max(axis=0))),
        )


@dataclass(frozen=True)
class Movement:
    """How a volume moves in front of eyes.

    frames: float64 (E, 3, 4), places at the frame of places at the time at which each eye sees, in the world, of the
    volume as a whole. flow: what moves in it besides, or None.
    """

    frames: np.ndarray
    flow: Flow | None = None

    def frame_of(self, places: np.ndarray, eyes: np.ndarray) -> np.ndarray:
        """As `at_frame`, of the volume as a whole."""
        frame = self.frames[eyes]
        return np.einsum("nij,nj->ni", frame[:, :, :3], places) + frame[:, :, 3]

    def at_frame(self, places: np.ndarray, eyes: np.ndarray) -> np.ndarray:
        """Places float64 (N, 3) at the frame of what eyes, int (N,), see at places (N, 3)."""
        moved = self.frame_of(places, eyes)
        if self.flow is None:
            return moved
        # What is carried far out of the volume is seen nowhere.
        with np.errstate(over="ignore", invalid="ignore"):
            return np.nan_to_num(moved - self.flow.times[eyes, None] * self.flow.velocities(moved, eyes))


@dataclass(frozen=True)
class BoundMedium:
    """A volume as rays traverse it in colour channels of equal extinction.

    sigma_t: extinction coefficient per unit density and world unit. sun_depths: L optical depths, one per sun.
    motion: in front of eyes; None for a volume that stands still.
    """

    grid: Grid
    medium: Medium
    sigma_t: float
    sun_depths: list[SunOpticalDepth]
    motion: Movement | None = None

    @property
    def linear(self) -> np.ndarray:
        """(3, 3), linear part of continuous indices from world positions."""
        return self.grid.linear

    @property
    def offset(self) -> np.ndarray:
        """(3,), translation of continuous indices from world positions."""
        return self.grid.offset

    @functools.cached_property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest index (3,) at which rays may meet what the volume holds."""
        flow = None if self.motion is None else self.motion.flow
        return self.grid.box if flow is None else flow.support(self.grid)

    @property
    def sphere(self) -> np.ndarray:
        """(4,), centre and radius in the world around all that rays may meet, infinite for a volume that moves."""
        return self.grid.sphere if self.motion is None else np.array([0.0, 0.0, 0.0, np.inf])

    @property
    def flows(self) -> bool:
        """Whether velocities carry what the volume holds."""
        return self.motion is not None and self.motion.flow is not None

    @property
    def emits(self) -> bool:
        """Whether the volume emits light."""
        return bool(self.grid.emission) and self.medium.emission > 0.0

    @property
    def varies(self) -> bool:
        """Whether the albedo varies where the medium attenuates."""
        return bool(self.grid.scattering) and self.sigma_t > 0.0

    @property
    def matters(self) -> bool:
        """Whether the volume attenuates or may emit light in these channels."""
        return self.sigma_t > 0.0 or bool(self.grid.emission)

    @property
    def voxel_thickness(self) -> float:
        """Largest optical thickness of a voxel, along its longest edge."""
        return self.grid.peak * self.sigma_t * self.grid.longest


def scattering_channels(media: Sequence[BoundMedium], channels: Sequence[int]) -> list[int]:
    """Colour channels whose scattering differs: all of `channels` if an albedo varies in colour, else the first."""
    coloured = any(medium.varies and len(medium.grid.scattering) == 3 for medium in media)
    return list(channels) if coloured else list(channels[:1])
