# SPDX-License-Identifier: GPL-3.0-or-later
"""The Gradient, Wave, Magic, Checker, Brick and White Noise Textures, at points (n, 3)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .hashing import uniform, uniform_colour
from .noise import Fractal

TURN = 2.0 * np.pi


def gradient(points: np.ndarray, kind: str) -> np.ndarray:
    """(n, 1) in [0, 1]: the Gradient Texture of one kind."""
    x, y = points[:, :1], points[:, 1:2]
    inside = np.maximum(0.999999 - np.linalg.norm(points, axis=1, keepdims=True), 0.0)
    eased = np.clip(x, 0.0, 1.0)
    value = {
        "LINEAR": lambda: x,
        "QUADRATIC": lambda: np.maximum(x, 0.0) ** 2,
        "EASING": lambda: 3.0 * eased**2 - 2.0 * eased**3,
        "DIAGONAL": lambda: (x + y) * 0.5,
        "RADIAL": lambda: np.arctan2(y, x) / TURN + 0.5,
        "SPHERICAL": lambda: inside,
        "QUADRATIC_SPHERE": lambda: inside**2,
    }[kind]()
    return np.clip(value, 0.0, 1.0)


def _off_integers(points: np.ndarray) -> np.ndarray:
    """Points moved a little, so that coordinates that are whole numbers lie on one side of a step."""
    return (points + 1e-6) * 0.999999


@dataclass
class Wave:
    """Settings of the Wave Texture, as Blender's node has them; numbers or (n, 1). direction: of bands or of rings."""

    rings: bool
    direction: str
    profile: str
    distortion: np.ndarray | float
    detail: np.ndarray | float
    detail_scale: np.ndarray | float
    roughness: np.ndarray | float
    phase: np.ndarray | float

    def at(self, points: np.ndarray) -> np.ndarray:
        """(n, 1) in [0, 1]."""
        points = _off_integers(points)
        if self.rings:
            # Around an axis, or a point.
            kept = [axis != self.direction for axis in "XYZ"]
            place = 20.0 * np.linalg.norm(points * kept, axis=1, keepdims=True)
        elif self.direction == "DIAGONAL":
            place = 10.0 * points.sum(axis=1, keepdims=True)
        else:
            axis = "XYZ".index(self.direction)
            place = 20.0 * points[:, axis : axis + 1]
        place = place + self.phase
        if np.any(self.distortion):
            noise = Fractal("FBM", self.detail, self.roughness).at(points * self.detail_scale)
            place = place + self.distortion * (2.0 * noise - 1.0)
        turns = place / TURN
        if self.profile == "SIN":
            return 0.5 + 0.5 * np.sin(place - 0.5 * np.pi)
        if self.profile == "SAW":
            return turns - np.floor(turns)
        return 2.0 * np.abs(turns - np.floor(turns + 0.5))


# Steps of the Magic Texture from its second on: what changes, its function, and the signs of x, y and z within.
MAGIC: list[tuple[int, Callable[[np.ndarray], np.ndarray], tuple[int, int, int]]] = [
    (1, lambda t: -np.cos(t), (1, -1, 1)),
    (0, np.cos, (1, -1, -1)),
    (2, np.sin, (-1, -1, -1)),
    (0, lambda t: -np.cos(t), (-1, 1, -1)),
    (1, lambda t: -np.sin(t), (-1, 1, 1)),
    (1, lambda t: -np.cos(t), (-1, 1, 1)),
    (0, np.cos, (1, 1, 1)),
    (2, np.sin, (1, 1, -1)),
    (0, lambda t: -np.cos(t), (-1, -1, 1)),
    (1, lambda t: -np.sin(t), (1, -1, 1)),
]


def magic(points: np.ndarray, depth: int, distortion: np.ndarray) -> np.ndarray:
    """(n, 3), the Magic Texture's colour; its factor is the mean."""
    x, y, z = (5.0 * np.fmod(points, TURN)).T[..., None]
    v = [np.sin(x + y + z), np.cos(-x + y - z), -np.cos(-x - y + z)]
    if depth > 0:
        v = [part * distortion for part in v]
    for changed, function, signs in MAGIC[:depth]:
        v[changed] = distortion * function(sum(sign * part for sign, part in zip(signs, v)))
    parts = np.concatenate(v, axis=1)
    return 0.5 - np.where(distortion != 0.0, parts / np.where(distortion != 0.0, 2.0 * distortion, 1.0), parts)


def checker(points: np.ndarray) -> np.ndarray:
    """(n, 1), 1 in cells of the first colour, else 0."""
    return (np.floor(_off_integers(points)).sum(axis=1, keepdims=True) % 2.0 != 0.0) * 1.0


@dataclass
class Brick:
    """Settings of the Brick Texture, as Blender's node has them; numbers, or (n, 1) where sockets have them."""

    offset: float
    offset_frequency: int
    squash: float
    squash_frequency: int
    mortar_size: np.ndarray | float
    mortar_smooth: np.ndarray | float
    bias: np.ndarray | float
    width: np.ndarray | float
    height: np.ndarray | float

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 1) shares of the second brick colour, and of mortar."""
        x, y = points[:, :1], points[:, 1:2]
        row = np.floor(y / self.height)
        width: np.ndarray | float = self.width
        shift: np.ndarray | float = 0.0
        if self.offset_frequency and self.squash_frequency:
            width = width * np.where(row % self.squash_frequency == 0.0, self.squash, 1.0)
            shift = np.where(row % self.offset_frequency == 0.0, width * self.offset, 0.0)
        brick = np.floor((x + shift) / width)
        x, y = x + shift - width * brick, y - self.height * row
        number = (row.astype(np.int64) << 16) + (brick.astype(np.int64) & 0xFFFF)
        tint = np.clip(_integer_noise(number) + self.bias, 0.0, 1.0)
        near = np.minimum(np.minimum(x, y), np.minimum(width - x, self.height - y))
        depth = 1.0 - near / np.where(self.mortar_size != 0.0, self.mortar_size, 1.0)
        share = np.clip(depth / np.where(self.mortar_smooth > 0.0, self.mortar_smooth, 1.0), 0.0, 1.0)
        share = np.where(self.mortar_smooth > 0.0, share * share * (3.0 - 2.0 * share), 1.0)
        return tint, np.where(near < self.mortar_size, share, 0.0)


def _integer_noise(number: np.ndarray) -> np.ndarray:
    """Perlin's integer noise in [0, 1], in 32 bits."""
    n = (number + 1013) & 0x7FFFFFFF
    n = (n >> 13) ^ n
    m = (n * ((n * n * 60493 + 19990303) & 0xFFFFFFFF) + 1376312589) & 0x7FFFFFFF
    return 0.5 * m / 1073741824.0


def white_noise(points: np.ndarray, coloured: bool) -> np.ndarray:
    """(n, 1), or (n, 3) of a colour, in [0, 1], at points (n, d), d of 1 to 4: another where any bit differs."""
    numbers = points.T
    return uniform_colour(*numbers) if coloured else uniform(*numbers)[:, None]
