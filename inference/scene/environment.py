# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that arrives from everywhere: an environment image."""

import functools
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..numerics.interpolation import pad_with_zeros, sample_padded
from ..numerics.small_matmul import product
from .description import MAX_IRRADIANCE, Sun
from .errors import SceneError
from .light import Families, Light

#: Largest deviation of a rotation from an orthonormal matrix.
ORTHONORMAL = 1e-4
#: Largest radiance, W/(m^2 sr), that single precision is safe with.
MAX_RADIANCE = MAX_IRRADIANCE
# A peak rises above PEAK times the mean radiance of the rest, fits in a cone of half-angle PEAK_ANGLE, and holds at
# least PEAK_FRACTION of all light; and at most MAX_PEAKS are taken out.
PEAK, PEAK_ANGLE, PEAK_FRACTION, MAX_PEAKS = 16.0, np.radians(10.0), 0.02, 4
# Root mean square angle above which a peak is more than a single direction.
POINT_ANGLE = np.radians(0.7)
# Directions of a peak's angular extent, as cells of this angle.
PEAK_CELL = np.radians(2.0)
LUMA = np.array([0.2126, 0.7152, 0.0722])


@functools.lru_cache(maxsize=8)
def _grid(rows: int) -> tuple[np.ndarray, np.ndarray]:
    columns = 2 * rows
    azimuth = (np.arange(columns) + 0.5) * (2.0 * np.pi / columns)
    elevation = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)
    flat = np.cos(elevation)[:, None]
    directions = np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), np.broadcast_to(np.sin(elevation)[:, None], (rows, columns))],
        axis=-1,
    )
    edges = np.sin(np.pi * (0.5 - np.arange(rows + 1) / rows))
    angles = np.broadcast_to(((edges[:-1] - edges[1:]) * (2.0 * np.pi / columns))[:, None], (rows, columns))
    return directions, angles


def pixel_directions(rows: int) -> np.ndarray:
    """Unit vectors float64 (rows, 2 rows, 3) of the directions from which the light of an image's pixels arrives."""
    return _grid(rows)[0]


def pixel_solid_angles(rows: int) -> np.ndarray:
    """Solid angles float64 (rows, 1) of the pixels of each row; all pixels together have 4 pi."""
    return _grid(rows)[1][:, :1]


def pixel_numbers(directions: np.ndarray, rows: int) -> np.ndarray:
    """Numbers int (...) of the pixels of an image of 2 rows x rows in which directions (..., 3) of any length lie."""
    x, y, z = np.moveaxis(directions, -1, 0)
    row = ((0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi) * rows).astype(int).clip(0, rows - 1)
    column = np.floor(np.arctan2(y, x) * (rows / np.pi)).astype(int) % (2 * rows)
    return row * (2 * rows) + column


class DirectionWeight(Protocol):
    """Factor of a light by position and by direction, of which there are K; hashable."""

    @property
    def directions(self) -> np.ndarray:
        """(K, 3), unit vectors towards the light that stand for equal shares of the sphere."""

    @property
    def mean(self) -> float:
        """Mean over directions and positions."""

    def towards(self, positions: np.ndarray) -> np.ndarray:
        """float32 (N, K), at world positions (N, 3)."""

    def __call__(self, positions: np.ndarray) -> np.ndarray:
        """Mean over the directions, float32 (N,), at world positions (N, 3)."""


@dataclass(frozen=True, eq=False)
class PlaceLattice:
    """Factor of a light by position: trilinear between the points of a lattice, and constant beyond them.

    low, high: (3,), opposite corners of the lattice in the world. values: float32 (n, n, n), n > 1.
    """

    low: np.ndarray
    high: np.ndarray
    values: np.ndarray

    @property
    def mean(self) -> float:
        """Mean over the lattice."""
        return float(self.values.mean())

    def __call__(self, positions: np.ndarray) -> np.ndarray:
        """float32 (N,), at world positions (N, 3)."""
        last = len(self.values) - 1
        index = np.clip((positions - self.low) / (self.high - self.low) * last, 0.0, last)
        return sample_padded(pad_with_zeros(self.values), index.T.astype(np.float32))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PlaceLattice) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[bytes, ...]:
        return self.low.tobytes(), self.high.tobytes(), self.values.tobytes()


@dataclass
class Environment(Light):
    """Light from all directions, infinitely far away.

    radiance: float32 (H, 2H, 3), W/(m^2 sr), in [0, 1e30], constant within a pixel. Pixel (r, c) is the radiance that
        arrives from (cos a cos e, sin a cos e, sin e), with a = 2 pi (c + 1/2) / (2H) and e = pi (1/2 - (r + 1/2) / H).
        A pixel's solid angle is 2 pi / (2H) times the difference of the sines of its upper and its lower edge.
    world_from_environment: (3, 3) orthonormal matrix that turns these directions into those of the world, or None for
        the identity.
    name: for messages.
    weight: factor of its light by position, and perhaps by direction, or None where it is the same everywhere.

    Raises SceneError for other shapes, for radiance out of range and for matrices that are not orthonormal.
    """

    radiance: np.ndarray
    world_from_environment: np.ndarray | None = None
    name: str = "environment"
    weight: PlaceLattice | DirectionWeight | None = None

    def __post_init__(self) -> None:
        self.radiance = np.ascontiguousarray(self.radiance, dtype=np.float32)
        shape = self.radiance.shape
        if len(shape) != 3 or shape[2] != 3 or shape[0] < 1 or shape[1] != 2 * shape[0]:
            raise SceneError(f"{self.name}: radiance must be an image (H, 2H, 3), not {shape}")
        low, high = float(self.radiance.min()), float(self.radiance.max())
        if not (np.isfinite(low) and np.isfinite(high)):
            raise SceneError(f"{self.name}: radiance holds NaN or infinite values")
        if low < 0.0 or high > MAX_RADIANCE:
            raise SceneError(f"{self.name}: radiance must not be negative or above {MAX_RADIANCE:g}")
        matrix = np.eye(3) if self.world_from_environment is None else self.world_from_environment
        matrix = np.asarray(matrix, dtype=np.float64)
        if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
            raise SceneError(f"{self.name}: world_from_environment must be a finite 3x3 matrix")
        if np.abs(matrix @ matrix.T - np.eye(3)).max() > ORTHONORMAL:
            raise SceneError(f"{self.name}: world_from_environment must be orthonormal")
        self.world_from_environment = matrix

    @functools.cached_property
    def even(self) -> bool:
        """Whether the same light comes from everywhere."""
        everywhere = self.weight is None or isinstance(self.weight, PlaceLattice)
        return everywhere and not np.ptp(self.radiance, axis=(0, 1)).any()

    def directions(self) -> np.ndarray:
        """Directions float64 (H, 2H, 3) in the world from which the light of the pixels arrives."""
        assert self.world_from_environment is not None
        return product(pixel_directions(len(self.radiance)), self.world_from_environment.T)

    def fluence(self) -> np.ndarray:
        """Fluence float64 (3,), W/m^2: radiance integrated over the sphere."""
        return (self.radiance.astype(np.float64).sum(axis=1) * pixel_solid_angles(len(self.radiance))).sum(axis=0)

    @property
    def strength(self) -> np.ndarray:
        """Its radiance."""
        return self.radiance

    @property
    def darkness(self) -> str:
        """As of Light."""
        return "" if self.radiance.any() else "it is black"

    def add_to(self, families: Families) -> None:
        """As of Light."""
        families.environments.append(self)

    def mean_fluence(self) -> float:
        """As of Sun."""
        rows, columns, _ = self.radiance.shape
        fluence = float(columns * self.radiance.mean(axis=(1, 2)) @ pixel_solid_angles(rows)[:, 0])
        return fluence if self.weight is None else self.weight.mean * fluence

    def fluence_at(self, points: np.ndarray) -> np.ndarray:
        """As of Light."""
        weight = np.ones(len(points)) if self.weight is None else self.weight(points)
        return weight[:, None] * self.fluence()

    def without_peaks(self) -> tuple["Environment", list[Sun]]:
        """The environment without its peaks, and these as suns, which together give as much light as before.

        Radiance above a multiple of the mean is taken out; the radiance below it stays.
        """
        light = product(self.radiance, LUMA)
        angles = np.broadcast_to(pixel_solid_angles(len(light)), light.shape)
        total = float((light * angles).sum())
        most, limit = float(light.max(initial=0.0)), np.inf
        for _ in range(16):
            limit = PEAK * float((np.minimum(light, limit) * angles).sum()) / (4.0 * np.pi)
            if not most > limit:
                return self, []
        excess = np.maximum(light - limit, 0.0) * angles
        if excess.sum() < PEAK_FRACTION * total:
            return self, []
        directions, remaining, suns = self.directions(), self.radiance.astype(np.float64), []
        pixels = np.flatnonzero(excess)
        towards, power = directions.reshape(-1, 3)[pixels], excess.reshape(-1)[pixels]
        for _ in range(MAX_PEAKS):
            near = product(towards, towards[power.argmax()]) > np.cos(PEAK_ANGLE)
            if power[near].sum() < PEAK_FRACTION * total:
                break
            own = pixels[near]
            flat = remaining.reshape(-1, 3)
            removed = flat[own] * (power[near] / (light * angles).reshape(-1)[own])[:, None]
            flat[own] -= removed
            irradiance = (removed * angles.reshape(-1)[own, None]).sum(axis=0)
            suns.append(_peak(towards[near], power[near], irradiance, f"sun of {self.name}"))
            power[near] = 0.0
        return Environment(np.maximum(remaining, 0.0), self.world_from_environment, self.name), suns


def _peak(directions: np.ndarray, power: np.ndarray, irradiance: np.ndarray, name: str) -> Sun:
    """The light of nearby directions (n, 3) as a single sun."""
    mean = (power[:, None] * directions).sum(axis=0)
    mean /= np.linalg.norm(mean)
    weights = power / power.sum()
    if np.arccos(min(np.sqrt((weights * product(directions, mean) ** 2).sum()), 1.0)) < POINT_ANGLE:
        return Sun(mean, irradiance, name)
    boxes, box = np.unique(np.floor(directions / PEAK_CELL).astype(int), axis=0, return_inverse=True)
    box = box.reshape(-1)
    box_weights = np.bincount(box, weights, len(boxes))
    means = np.stack([np.bincount(box, weights * axis, len(boxes)) for axis in directions.T], axis=1)
    return Sun(mean, irradiance, name, (means / np.linalg.norm(means, axis=1, keepdims=True), box_weights))
