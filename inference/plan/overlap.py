# SPDX-License-Identifier: GPL-3.0-or-later
"""Overlapping volumes, which the network treats as one medium."""

from collections.abc import Sequence

import numpy as np

from ..numerics.small_matmul import product
from ..scene.description import Medium, Volume

# Volumes are joined while the extent of all is at most this many times that of the smallest: beyond, the network would
# resolve the smallest too coarsely. Parts of a cloud that is made of many are as details of a single volume.
MAX_EXTENT_RATIO, MANY, MAX_EXTENT_RATIO_OF_MANY = 4.0, 8, 8.0


def group_name(members: Sequence[tuple[Volume, Medium]]) -> str:
    """Names of volumes that are treated as one medium, for messages: two of them at most, each once."""
    first, *others = dict.fromkeys(volume.name for volume, _ in members)
    if len(others) > 1:
        return f"{first} and {len(others)} more"
    return " and ".join([first, *others])


def overlapping(
    volumes: Sequence[tuple[Volume, Medium]],
) -> tuple[list[list[int]], list[tuple[int, int]]]:
    """Groups of volumes that are treated as one medium, and pairs that overlap but differ too much in size for that.

    Volumes are given by number. Every volume is in one group; groups and their members are in the order of the volumes.
    Which volumes are together does not depend on that order: pairs of nearly equal extent are joined first.
    """
    corners = np.array([_corners(volume) for volume, _ in volumes]).reshape(-1, 8, 3)
    low, high = corners.min(axis=1), corners.max(axis=1)
    extent = (high - low).max(axis=1)
    pairs = _alike_first(_meeting(low, high), low, high)
    apart = [pair for pair in pairs if share_light(volumes[pair[0]][1], volumes[pair[1]][1])]
    # Of each volume the members of its group, which these share.
    groups, grown = [[v] for v in range(len(volumes))], True
    # Groups that have become large may grow further.
    while grown:
        grown = False
        for first, second in apart:
            if groups[first] is groups[second]:
                continue
            joined = sorted(groups[first] + groups[second])
            edge = (high[joined].max(axis=0) - low[joined].min(axis=0)).max()
            ratio = MAX_EXTENT_RATIO if len(joined) < MANY else MAX_EXTENT_RATIO_OF_MANY
            if edge <= ratio * extent[joined].min():
                grown = True
                for v in joined:
                    groups[v] = joined
        apart = [(first, second) for first, second in apart if groups[first] is not groups[second]]
    return [group for v, group in enumerate(groups) if group[0] == v], sorted(apart)


def _meeting(low: np.ndarray, high: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of boxes that overlap, ascending; low, high: (V, 3)."""
    order, pairs = np.argsort(low[:, 0], kind="stable"), []
    starts = low[order, 0]
    # Those that begin, along the first axis, before each of them ends.
    for place, (v, end) in enumerate(zip(order, np.searchsorted(starts, high[order, 0]))):
        others = order[place + 1 : end]
        meet = others[((low[v] < high[others]) & (low[others] < high[v])).all(axis=1)]
        pairs += [(min(v, other), max(v, other)) for other in meet.tolist()]
    return sorted((int(first), int(second)) for first, second in pairs)


def _alike_first(pairs: list[tuple[int, int]], low: np.ndarray, high: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of boxes by how little the extent of both exceeds that of the smaller, then by their place."""
    if not pairs:
        return []
    of = np.array(pairs)
    joint_low, joint_high = low[of].min(axis=1), high[of].max(axis=1)
    smaller = (high - low).max(axis=1)[of].min(axis=1)
    ratio = (joint_high - joint_low).max(axis=1) / np.maximum(smaller, np.finfo(float).tiny)
    return [pairs[n] for n in np.lexsort((*joint_high.T, *joint_low.T, ratio))]


def share_light(medium: Medium, other: Medium) -> bool:
    """Whether what one medium does to light matters to the other: unless they attenuate different colours."""
    both = (medium.sigma_t > 0.0) & (other.sigma_t > 0.0)
    return bool(both.any()) or not medium.sigma_t.any() or not other.sigma_t.any()


def _corners(volume: Volume) -> np.ndarray:
    """World corners (8, 3) of the box between the centres of a grid's outermost voxels."""
    ends = np.array([(x, y, z, 1.0) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    index = ends * [*(np.array(volume.density.shape) - 1.0), 1.0]
    return product(index, volume.world_from_index.T)[:, :3]
