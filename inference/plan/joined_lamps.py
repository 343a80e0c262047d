# SPDX-License-Identifier: GPL-3.0-or-later
"""Which distant lamps multiple scattering is predicted of at once.

What they give to a volume must hardly differ in direction or in how it falls off. Clusters are joined in the order in
which that changes the light least (Ward, "Hierarchical Grouping to Optimize an Objective Function", 1963), until the
variance within them reaches a bound: weak lamps are joined from further apart than strong ones.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from ..scene.description import Sun
from ..scene.environment import Environment
from ..scene.lamps import Lamp, distance_from_box
from .lights import linking

# Distance from a volume's box over its diagonal from which on lamps are joined.
DISTANT = 0.25
# Bounds of the squared change of direction, in square radians: mean over all light, and between two that are joined.
VARIANCE, MOST = 0.05, 0.6
# Largest difference of the colours' shares of lamps that are joined.
COLOUR = 0.02


def joined_lamps(
    lamps: Sequence[Lamp], others: Sequence[Sun | Environment], boxes: Mapping[str, np.ndarray]
) -> list[list[int]]:
    """Lamps, by number, in clusters that multiple scattering is predicted of at once, in the order of their first.

    others: all other lights. boxes: corners (8, 3) of the boxes of some volumes, by their names.
    """
    corners = np.concatenate(list(boxes.values()))
    low, high = corners.min(axis=0), corners.max(axis=0)
    fields, light = _fields(lamps, low, high)
    light *= linking(lamps, list(boxes)).any(axis=0)
    rest = sum(one.mean_fluence() for one, lit in zip(others, linking(others, list(boxes)).any(axis=0)) if lit)
    weights = light / max(light.sum() + rest, 1e-300)
    clusters, spent = [[k] for k in range(len(lamps))], 0.0
    joinable = _joinable(lamps, low, high) & (light > 0.0) & (light[:, None] > 0.0)
    while len(clusters) > 1:
        apart = ((fields[:, None] - fields) ** 2).sum(axis=2)
        both = weights[:, None] * weights / np.maximum(weights[:, None] + weights, 1e-300)
        cost = np.where(joinable & (apart < MOST), both * apart, np.inf)
        a, b = np.unravel_index(cost.argmin(), cost.shape)
        if spent + cost[a, b] > VARIANCE:
            break
        spent += cost[a, b]
        total = max(weights[a] + weights[b], 1e-300)
        fields[a] = (weights[a] * fields[a] + weights[b] * fields[b]) / total
        weights[a] += weights[b]
        joinable[a] &= joinable[b]
        joinable[:, a] &= joinable[:, b]
        clusters[a] += clusters[b]
        del clusters[b]
        fields, weights = np.delete(fields, b, axis=0), np.delete(weights, b)
        joinable = np.delete(np.delete(joinable, b, axis=0), b, axis=1)
    return sorted(sorted(cluster) for cluster in clusters)


def _fields(lamps: Sequence[Lamp], low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions of lamps' light times how bright it is at some points over its mean, float64 (K, D); the means (K,).

    As if every lamp faced each point: cones and shadows do not keep lamps from being joined.
    """
    ends = np.array(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij")).reshape(3, -1).T
    points = np.concatenate([ends, 0.5 * (low + high)[None]])
    fields, light = np.zeros((len(lamps), 3 * len(points))), np.zeros(len(lamps))
    for k, lamp in enumerate(lamps):
        field = np.zeros_like(points)
        for emitter in lamp.emitters(low, high, 1):
            away = emitter.position - points
            away /= np.maximum(np.linalg.norm(away, axis=1), 1e-30)[:, None]
            field += float(lamp.power.mean()) * emitter.brightest(points)[:, None] * away
        light[k] = np.linalg.norm(field, axis=1).mean()
        fields[k] = field.ravel() / max(light[k] * len(points) ** 0.5, 1e-300)
    return fields, light


def _joinable(lamps: Sequence[Lamp], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Whether pairs of different lamps may be joined, bool (K, K)."""
    reach = DISTANT * float(np.linalg.norm(high - low))
    distant = np.array([distance_from_box(lamp.centre, low, high) > reach for lamp in lamps], bool)
    colours = np.array([lamp.power / max(lamp.power.sum(), 1e-300) for lamp in lamps]).reshape(-1, 3)
    same = np.abs(colours[:, None] - colours).max(axis=2) < COLOUR
    linked = np.array([[lamp.receivers == other.receivers for other in lamps] for lamp in lamps], bool)
    return distant[:, None] & distant & same & linked.reshape(same.shape) & ~np.eye(len(lamps), dtype=bool)
