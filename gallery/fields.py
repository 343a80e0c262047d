# SPDX-License-Identifier: GPL-3.0-or-later
"""Densities of the gallery's volumes: functions of points float32 (M, 3) to float32 (M,), and their sampling.

Functions of several grids give float32 (M, C).
"""

from collections.abc import Callable

import numpy as np

from training.procedural.noise import Fractal, Swirl
from training.procedural.shapes import ball_union

Field = Callable[[np.ndarray], np.ndarray]


def sample(field: Field, low, high, voxel: float) -> np.ndarray:
    """The field at the centres of cubic voxels between two corners (3,): float32 (nx, ny, nz), or (nx, ny, nz, C) if
    it has channels."""
    shape = [max(round((h - l) / voxel), 1) for l, h in zip(low, high)]
    axes = [(np.arange(n, dtype=np.float32) + 0.5) * voxel + l for n, l in zip(shape, low)]
    slabs = np.array_split(axes[0], max(len(axes[0]) // 16, 1))
    grids = [np.stack(np.meshgrid(slab, *axes[1:], indexing="ij"), axis=-1) for slab in slabs]
    values = [field(np.ascontiguousarray(grid.reshape(-1, 3), np.float32)) for grid in grids]
    return np.concatenate([v.reshape(*g.shape[:3], *v.shape[1:]) for v, g in zip(values, grids)]).astype(np.float32)


def ramp(x, low: float, high: float):
    """Smoothstep from 0 below `low` to 1 above `high`."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def heap(rng, towers, turrets: int = 9):
    """Centres (N, 3) and radii (N,) of a cloud's balls: towers of balls with smaller balls on them, twice.

    towers: (x, y, height, radius) of each, which stand on z = 0.
    """
    balls = []
    for x, y, height, radius in towers:
        z = 0.35 * radius
        while z < height:
            shrink = 1.0 - 0.45 * z / height
            balls.append((x + 0.2 * radius * rng.standard_normal(), y + 0.2 * radius * rng.standard_normal(), z))
            balls[-1] += (radius * shrink,)
            z += 0.75 * radius * shrink
    for count, least, most in ((turrets, 0.35, 0.6), (3, 0.3, 0.5)):
        for x, y, z, radius in list(balls):
            for _ in range(count):
                way = rng.standard_normal(3)
                way[2] = abs(way[2]) * 0.8
                way *= radius / np.linalg.norm(way)
                balls.append((x + way[0], y + way[1], z + way[2], radius * rng.uniform(least, most)))
    table = np.array(balls, np.float32)
    return table[:, :3].copy(), table[:, 3].copy()


def cumulus(rng, balls, size: float = 1.0, base: float = 0.0) -> Field:
    """Heaped cloud with a flat base: balls with creased lumps on them. size: of the lumps, in units of length."""
    centres, radii = balls
    lumps = Fractal(rng, 1.1 / size, 6, 0.52, billow=True)
    curls = Swirl(rng, 2.5 / size, 3, 0.6, steps=4)
    uneven = Fractal(rng, 0.8 / size, 3)

    def density(points):
        out = np.zeros(len(points), np.float32)
        floor = base + 0.05 * size * uneven(points * np.array([1, 1, 0], np.float32))
        near = np.flatnonzero(ball_union(points, centres, radii, np.float32(0.05 * size)) < 0.35 * size)
        moved = curls(points[near], 0.035 * size)
        distance = ball_union(moved, centres, radii, np.float32(0.05 * size)) - 0.07 * size * lumps(moved)
        bottom = ramp(points[near, 2] - floor[near], -0.02 * size, 0.25 * size)
        out[near] = ramp(-distance, 0.0, 0.06 * size) * bottom * (0.8 + 0.2 * np.tanh(uneven(moved)))
        return out

    return density
