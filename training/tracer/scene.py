# SPDX-License-Identifier: GPL-3.0-or-later
"""What the path tracer is asked for: a lit density, path vertices or a camera, and how many paths.

Positions are in cube units, [-1/2, 1/2]^3; extinction is per cube edge where the density is 1.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .density_grid import prepare

#: Collisions after which a path is dropped. In a solid block of optical depth 1000 and albedo 1 a limit of 4096 loses
#: up to 5 % of the light; this one loses nothing that shows, for a fifth more time.
MAX_COLLISIONS = 65536


class Sampling(NamedTuple):
    """How many paths per point or pixel, the random seed, and the collisions after which a path is dropped."""

    paths: int
    seed: int
    max_collisions: int = MAX_COLLISIONS


class Scene:
    """A density lit by distant suns of irradiance 1."""

    def __init__(self, density, suns):
        """
        density: (N, N, N), or what `density_grid.prepare` made of it (prepare once for many scenes).
        suns: (S, 3) or (3,), directions towards the suns.

        Raises ValueError on shapes that do not fit, and on densities that are negative or not finite.
        """
        self.grid = prepare(density)
        self.suns = unit_vectors(suns, "suns")


class Vertices:
    """First vertices of camera paths, each in a medium of its own."""

    def __init__(self, positions, directions, sigma, anisotropy, albedos):
        """
        positions: (P, 3) in the cube; directions: (P, 3) of the camera rays, away from the camera.
        sigma: extinction per cube edge; anisotropy: mean cosine; (P,) or scalar. albedos: (P, A) or (A,).

        Raises ValueError on shapes that do not fit and on points outside the cube.
        """
        self.positions = np.ascontiguousarray(positions, dtype=np.float32).reshape(-1, 3)
        count = len(self.positions)
        if count and np.abs(self.positions).max() > 0.5:
            raise ValueError("positions must lie in the cube [-0.5, 0.5]^3")
        self.directions = unit_vectors(directions, "directions")
        if len(self.directions) != count:
            raise ValueError(f"{count} positions but {len(self.directions)} directions")
        self.sigma = per_point(sigma, (count,), "sigma")
        self.anisotropy = per_point(anisotropy, (count,), "anisotropy")
        albedos = np.atleast_1d(np.asarray(albedos, np.float32))
        self.albedos = per_point(albedos, (count, albedos.shape[-1]), "albedos")


@dataclass(frozen=True)
class PinholeCamera:
    """A perspective image. position, look_at: cube units; fov: degrees across.

    resolution: pixels across; rows: pixels down, as many without.
    """

    position: tuple
    look_at: tuple
    up: tuple
    fov: float
    resolution: int
    rows: int | None = None

    def rays(self) -> np.ndarray:
        """Unit directions float32 (H, W, 3) through pixel centres, rows from the top, columns along forward x up."""
        forward = np.asarray(self.look_at, np.float64) - np.asarray(self.position, np.float64)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, np.asarray(self.up, np.float64))
        right /= np.linalg.norm(right)
        above = np.cross(right, forward)
        pixel = 2 * np.tan(np.radians(self.fov) / 2) / self.resolution
        across, down = (
            (np.arange(count) + 0.5 - count / 2) * pixel for count in (self.resolution, self.rows or self.resolution)
        )
        rays = forward + across[None, :, None] * right - down[:, None, None] * above
        return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype(np.float32)


def per_point(values, shape, name: str) -> np.ndarray:
    """`values` as float32 of `shape`, repeated where it is smaller. Raises ValueError where it does not fit."""
    values = np.asarray(values, np.float32)
    try:
        values = np.broadcast_to(values, shape)
    except ValueError:
        raise ValueError(f"{name} must have shape {shape}, not {values.shape}") from None
    return np.ascontiguousarray(values)


def unit_vectors(values, name: str) -> np.ndarray:
    """Vectors (N, 3) or (3,) as unit vectors float32 (N, 3). Raises ValueError where one is zero."""
    values = np.atleast_2d(np.asarray(values, np.float64))
    length = np.linalg.norm(values, axis=1, keepdims=True)
    if values.shape[1] != 3 or not np.all(length > 0):
        raise ValueError(f"{name} must be vectors of three numbers, none of them zero")
    return np.ascontiguousarray(values / length, dtype=np.float32)
