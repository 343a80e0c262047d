# SPDX-License-Identifier: GPL-3.0-or-later
"""The stencil of appendix A.2 of the paper: 192 points around x at which the medium is described.

160 low-frequency points live in a frame that follows the camera ray: z along omega, the sun in the half-plane x > 0,
y = 0. 32 high-frequency points lie on the ray to the sun. The points are computed once (`training/data/stencil.py`) and
stored in the weights file.
"""

import functools
import hashlib
from dataclasses import dataclass, field

import numpy as np

from ..numerics.small_matmul import lengths, product

# Points and mip level of each layer: eight low-frequency layers, then four high-frequency layers.
LAYER_POINTS = (8, 8, 16, 16, 16, 32, 32, 32, 8, 8, 8, 8)
LAYER_MIPS = (0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3)
LOW_LAYERS = 8
LOW_POINTS = sum(LAYER_POINTS[:LOW_LAYERS])
POINTS = sum(LAYER_POINTS)
# A sparse stencil keeps every SPARSE-th point of each layer.
SPARSE = 4
MIPS = 8


@dataclass(frozen=True)
class Stencil:
    """Points of the stencil, in units of the working cube's edge.

    low: float32 (160, 3), offsets in the frame of `frames`. high: float32 (32,), distances towards the sun.
    every: 1, or SPARSE for a stencil that keeps only every fourth point of each layer. finest: mip level that is
    read in place of finer ones. mips: int (192 / every,), mip level of each point.

    Raises ValueError for other numbers of points.
    """

    low: np.ndarray
    high: np.ndarray
    every: int = 1
    finest: int = 0
    mips: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        low = LOW_POINTS // self.every
        if self.low.shape != (low, 3) or self.high.shape != (POINTS // self.every - low,):
            raise ValueError(f"stencil of {self.low.shape} and {self.high.shape} points is not A.2's")
        object.__setattr__(self, "low", np.ascontiguousarray(self.low, np.float32))
        object.__setattr__(self, "high", np.ascontiguousarray(self.high, np.float32))
        mips = np.repeat(LAYER_MIPS, LAYER_POINTS)[:: self.every]
        object.__setattr__(self, "mips", np.maximum(mips, self.finest))

    @classmethod
    def read(cls, values: np.ndarray, every: int = 1) -> "Stencil":
        """From the floats that `written` gives. Raises ValueError for another number of floats."""
        low = 3 * (LOW_POINTS // every)
        return cls(values[:low].reshape(-1, 3), values[low:], every)

    def written(self) -> np.ndarray:
        """The points as weights files store them: float32 (640,), or (160,) of a sparse stencil."""
        return np.concatenate([self.low.ravel(), self.high])

    def sparse(self) -> "Stencil":
        """Every fourth point of each layer."""
        return Stencil(self.low[::SPARSE], self.high[::SPARSE], SPARSE)

    @property
    def digest(self) -> str:
        """SHA-256 of the points' float32 bytes."""
        return hashlib.sha256(self.low.tobytes() + self.high.tobytes()).hexdigest()

    @functools.cached_property
    def reaches(self) -> list[float]:
        """Largest distance from x of a point of each mip level, in cube edges."""
        distances = np.concatenate([np.linalg.norm(self.low, axis=1), self.high])
        return [float(distances[self.mips == mip].max(initial=0.0)) for mip in range(MIPS)]


def frames(omega: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) from the stencil's frame to the cube's.

    omega: (N, 3) unit camera-ray directions. sun: unit vector towards the sun, (3,), or towards the light of each,
    (N, 3). Column 2 is omega, column 0 the sun's perpendicular part; where the two are parallel the roll is arbitrary
    but fixed.
    """
    omega = np.asarray(omega, np.float64)
    along = product(omega, sun) if np.ndim(sun) == 1 else (omega * sun).sum(axis=1)
    x = sun - along[:, None] * omega
    length = lengths(x)
    parallel = np.flatnonzero(length < 1e-6)
    if len(parallel):
        # The axis least aligned with omega replaces a perpendicular part that vanishes.
        rays = omega[parallel]
        spare = np.eye(3)[np.abs(rays).argmin(axis=1)]
        x[parallel] = spare - np.sum(spare * rays, axis=1, keepdims=True) * rays
        length = lengths(x)
    x /= length[:, None]
    turned = np.empty((len(omega), 3, 3))
    turned[:, :, 0], turned[:, :, 2] = x, omega
    # Their cross product; numpy's own function is slow along short axes.
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        turned[:, i, 1] = omega[:, j] * x[:, k] - omega[:, k] * x[:, j]
    return turned
