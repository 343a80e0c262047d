"""The stencil of A.2: 192 points around x at which the medium is described.

160 low-frequency points live in a frame that follows the camera ray: z along
omega, the sun in the half-plane x > 0, y = 0. 32 high-frequency points lie on the ray to
the sun. The points are computed once and travel inside the weights file.
"""

import hashlib
from dataclasses import dataclass, field

import numpy as np

LEVEL0_CELLS = 256
LAYER_POINTS = (8, 8, 16, 16, 16, 32, 32, 32, 8, 8, 8, 8)
LAYER_MIPS = (0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3)
LOW_LAYERS = 8
LOW_POINTS = sum(LAYER_POINTS[:LOW_LAYERS])
POINTS = sum(LAYER_POINTS)
MIPS = 8


@dataclass(frozen=True)
class Stencil:
    """Points of the stencil, in units of the working cube's edge.

    low: float32 (160, 3), offsets in the frame of `frames`.
    high: float32 (32,), distances along the direction towards the sun.
    """

    low: np.ndarray
    high: np.ndarray
    mips: np.ndarray = field(init=False)  # int (192,), mip of each point

    def __post_init__(self):
        if self.low.shape != (LOW_POINTS, 3) or self.high.shape != (POINTS - LOW_POINTS,):
            raise ValueError(f"stencil of {self.low.shape} and {self.high.shape} points is not A.2's")
        object.__setattr__(self, "low", np.ascontiguousarray(self.low, np.float32))
        object.__setattr__(self, "high", np.ascontiguousarray(self.high, np.float32))
        object.__setattr__(self, "mips", np.repeat(LAYER_MIPS, LAYER_POINTS))

    @property
    def digest(self) -> str:
        """Identifies the points: sha256 of their float32 bytes."""
        return hashlib.sha256(self.low.tobytes() + self.high.tobytes()).hexdigest()

    def reach(self, mip: int) -> float:
        """Largest distance from x of a point of this mip, in cube edges."""
        low = np.linalg.norm(self.low[self.mips[:LOW_POINTS] == mip], axis=1)
        high = self.high[self.mips[LOW_POINTS:] == mip]
        return float(max(low.max(initial=0.0), high.max(initial=0.0)))


def mutual_minimum_distances(points: np.ndarray) -> np.ndarray:
    """Distance of each point to its nearest neighbour: the terms of eq. 1."""
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    return distance.min(axis=1)


def fibonacci_sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors of a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    phi = k * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)


def relax(points: np.ndarray, onto_domain, iterations: int = 4000) -> np.ndarray:
    """Spread points by ascent on the mean mutual minimum distance R (eq. 1).

    Each point and its nearest neighbour move apart along the line between them, by a
    step that shrinks; `onto_domain` brings the points back to the sphere or into the ball. Returns
    the best set met.
    """
    best, best_r = points, mutual_minimum_distances(points).mean()
    for step in np.geomspace(0.05, 1e-4, iterations):
        delta = points[:, None] - points[None]
        distance = np.linalg.norm(delta, axis=-1)
        np.fill_diagonal(distance, np.inf)
        nearest = distance.argmin(axis=1)
        rows = np.arange(len(points))
        push = delta[rows, nearest] / np.maximum(distance[rows, nearest], 1e-9)[:, None]
        move = push.copy()
        np.add.at(move, nearest, -push)
        points = onto_domain(points + step * move)
        r = mutual_minimum_distances(points).mean()
        if r > best_r:
            best, best_r = points, r
    return best


def _on_sphere(points):
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def _in_ball(points):
    return points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1.0)


def unit_layer(layer: int) -> np.ndarray:
    """Auxiliary layer Q-hat of unit radius; layers count from 1 as in the paper."""
    count = LAYER_POINTS[layer - 1]
    if layer == 1:
        return np.concatenate([np.zeros((1, 3)), relax(fibonacci_sphere(count - 1), _on_sphere)])
    if layer <= 5:
        return relax(fibonacci_sphere(count), _on_sphere)
    # A seed a layer, so that the three balls differ.
    random = np.random.default_rng(layer)
    directions = _on_sphere(random.normal(size=(count, 3)))
    return relax(directions * random.random((count, 1)) ** (1 / 3), _in_ball)


def layer_radius(layer: int, unit: np.ndarray) -> float:
    """Eq. 2: radius of a low-frequency layer, in cube edges."""
    shrink = 1.0 - 0.08 * min(layer, 5)
    return 2.0 ** (layer - 1) / (LEVEL0_CELLS * mutual_minimum_distances(unit).mean()) * shrink


def high_frequency_distances() -> np.ndarray:
    """(32,) distances towards the sun: eight cells of each mip 0..3, end to end, from cell 1."""
    distances, edge = [], 0.5
    for mip in range(4):
        cell = 2.0**mip
        distances.append(edge + cell * (np.arange(8) + 0.5))
        edge += 8 * cell
    return np.concatenate(distances) / LEVEL0_CELLS


def make_stencil() -> Stencil:
    """The stencil from scratch; deterministic, a few seconds."""
    low = []
    for layer in range(1, LOW_LAYERS + 1):
        unit = unit_layer(layer)
        low.append(unit * layer_radius(layer, unit))
    return Stencil(np.concatenate(low), high_frequency_distances())


def frames(omega: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Rotations from the stencil's frame to the cube's.

    omega: (N, 3) unit camera-ray directions; sun: (3,) unit vector towards the sun.
    Returns (N, 3, 3); column 2 is omega, column 0 the sun's part perpendicular to it. Where
    the two are parallel the roll is arbitrary but fixed.
    """
    omega = np.asarray(omega, np.float64)
    x = sun - (omega @ sun)[:, None] * omega
    # The axis least aligned with omega stands in for a sun without a perpendicular part.
    spare = np.eye(3)[np.abs(omega).argmin(axis=1)]
    spare = spare - np.sum(spare * omega, axis=1, keepdims=True) * omega
    x = np.where(np.linalg.norm(x, axis=1, keepdims=True) < 1e-6, spare, x)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(omega, x), omega], axis=2)
