# SPDX-License-Identifier: GPL-3.0-or-later
"""Solids filled with homogeneous fog, as artists fill meshes: hard faces, density constant inside or nearly so.

Entries of SOLIDS are like those of `volume_kinds.KINDS`: each takes a numpy Generator and returns the density as a
function of points (M, 3). A solid is defined by its signed distance, a function of points, negative inside.
"""

import numpy as np

from .noise import Fractal
from .shapes import BOX, CYLINDER, constructive_solid, random_rotation


def _filled(rng, distance):
    """Fog inside a signed distance: homogeneous or slightly uneven, ending at once or within a voxel or two."""
    strength = rng.choice([0.0, 0.1, 0.3], p=[0.6, 0.2, 0.2])
    noise = Fractal(rng, rng.uniform(0.5, 4.0), 3, 0.5)
    edge = rng.choice([1e-5, rng.uniform(0.005, 0.03)], p=[0.6, 0.4])
    shell = rng.choice([0.0, rng.uniform(0.03, 0.12)], p=[0.85, 0.15])

    def density(points):
        depth = -distance(points)
        if shell:
            depth = np.minimum(depth, shell - depth)
        inside = np.clip(depth / np.float32(edge), 0, 1)
        return inside * np.exp(strength * np.clip(noise(points), -2, 2)) if strength else inside

    return density


def _joined(rng, kinds, centres, sizes, removed, turned):
    count = len(kinds)
    frames = np.array([random_rotation(rng) if turned else np.eye(3) for _ in range(count)], np.float32)
    centres, sizes = np.asarray(centres, np.float32), np.asarray(sizes, np.float32)
    return lambda points: constructive_solid(points, kinds, centres, frames, sizes, removed)


def single_solid(rng):
    """A box, ellipsoid, torus, capsule or cylinder: three in ten with equal sizes, the others thin."""
    low = rng.choice([1.0, 0.5, 0.1], p=[0.3, 0.4, 0.3])
    sizes = 0.8 * np.exp(rng.uniform(np.log(low), 0.0, (1, 3)))
    kinds = rng.integers(BOX, CYLINDER + 1, 1)
    return _filled(rng, _joined(rng, kinds, np.zeros((1, 3)), sizes, np.zeros(1, bool), True))


def joined_solids(rng):
    """Several solids that overlap, stand apart or are cut from one another."""
    count = int(rng.integers(2, 8))
    removed = rng.random(count) < 0.25
    removed[0] = False
    centres = rng.uniform(-1, 1, (count, 3)) * rng.uniform(0.2, 0.8)
    sizes = np.exp(rng.uniform(np.log(0.12), np.log(0.6), (count, 3)))
    kinds = rng.integers(BOX, CYLINDER + 1, count)
    return _filled(rng, _joined(rng, kinds, centres, sizes, removed, rng.random() < 0.6))


def polyhedron(rng):
    """A convex polyhedron."""
    count = int(rng.integers(5, 24))
    normals = rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # A last plane faces the sum of the others' normals.
    normals = np.vstack([normals, -normals.sum(axis=0) / np.linalg.norm(normals.sum(axis=0))]).astype(np.float32)
    offsets = rng.uniform(0.2, 0.7, count + 1).astype(np.float32)
    ball = np.float32(rng.uniform(0.8, 1.1))
    squeeze = rng.uniform(1.0, 3.0, 3).astype(np.float32)

    def distance(points):
        planes = ((points * squeeze) @ normals.T - offsets).max(axis=1)
        return np.maximum(planes, np.linalg.norm(points, axis=1) - ball) / squeeze.max()

    return _filled(rng, distance)


def figure(rng):
    """A smooth body with limbs and hollows, like a sculpted mesh: a ball whose radius is displaced by noise."""
    lumps = Fractal(rng, rng.uniform(0.7, 2.0), int(rng.integers(1, 4)), 0.5)
    height = rng.uniform(0.08, 0.3)
    squeeze = rng.uniform(1.0, 2.5, 3).astype(np.float32)

    def distance(points):
        length = np.linalg.norm(points * squeeze, axis=1)
        near = np.flatnonzero(length < 1.1)
        out = np.full(len(points), 1.0, np.float32)
        out[near] = (length[near] - 0.65 + height * np.clip(lumps(points[near]), -1.5, 2)) / squeeze.max()
        return out

    return _filled(rng, distance)


#: Share of each kind.
SOLIDS = {single_solid: 0.4, joined_solids: 0.25, polyhedron: 0.15, figure: 0.2}
