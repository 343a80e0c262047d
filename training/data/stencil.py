# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of A.2's stencil: those that all data and weights were made with, and how they were found.

python -m training.data.stencil FILE.npz    # relaxes new ones
"""

import functools
import pathlib
import sys

import numpy as np

from inference.features.stencil import LAYER_POINTS, LOW_LAYERS, Stencil
from inference.plan.resolution import LEVEL0_CELLS

POINTS_FILE = pathlib.Path(__file__).with_name("stencil.npz")


@functools.lru_cache(maxsize=1)
def load_stencil() -> Stencil:
    """The stencil of the data sets and of the shipped weights."""
    with np.load(POINTS_FILE) as points:
        return Stencil(points["low"], points["high"])


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

    Each point and its nearest neighbour move apart along the line between them, in shrinking steps; `onto_domain`
    projects points back onto the sphere or into the ball. Returns the best set found.
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
    # One seed per layer, so that the three balls differ.
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


def relaxed_stencil() -> Stencil:
    """The stencil from scratch, in a few seconds.

    Each step of `relax` looks for the nearest point. Ties are decided by the last bit, which differs between
    processors:
    the result is equally good everywhere but not the same.
    """
    low = []
    for layer in range(1, LOW_LAYERS + 1):
        unit = unit_layer(layer)
        low.append(unit * layer_radius(layer, unit))
    return Stencil(np.concatenate(low), high_frequency_distances())


if __name__ == "__main__":
    made = relaxed_stencil()
    np.savez(sys.argv[1], low=made.low, high=made.high)
