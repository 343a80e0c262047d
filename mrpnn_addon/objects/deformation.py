# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog in meshes that change their shape: the velocities that carry it while the shutter is open."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from mathutils.bvhtree import BVHTree

from ...inference.numerics.intersection import barycentric
from ...inference.scene import Velocity
from .mesh_triangles import Mesh

# Velocities along the longest edge of what the mesh passes, and beyond it on each side.
CELLS, MARGIN = 24, 2


@dataclass
class Deformation:
    """A mesh that changes its shape.

    mesh: of any time, with triangles. vertices: float32 (S, V, 3), at evenly spaced times, in object space.
    """

    mesh: Mesh
    vertices: np.ndarray

    def velocity(self, matrix: np.ndarray, frame: float) -> Velocity:
        """What carries the fog: at each place, how far the nearest place of the surface moves in a whole shutter.

        matrix: (4, 4), world from object. frame: when the frame is, from 0 at the shutter's opening to 1 at its end.
        """
        last = len(self.vertices) - 1
        before = min(int(frame * last), last - 1)
        between = frame * last - before
        shape = ((1.0 - between) * self.vertices[before] + between * self.vertices[before + 1]).astype(np.float64)
        moved = (self.vertices[-1] - self.vertices[0]).astype(np.float64)
        triangles = self.mesh.numbers()
        tree: Any = BVHTree.FromPolygons(shape.tolist(), triangles.tolist(), all_triangles=True)
        low, high = (find(self.vertices.reshape(-1, 3), axis=0) for find in (np.min, np.max))
        cell = float((high - low).max()) / CELLS
        counts = np.ceil((high - low) / cell).astype(int) + 1 + 2 * MARGIN
        first = 0.5 * (low + high) - 0.5 * cell * (counts - 1)
        asked = first + cell * np.moveaxis(np.indices(counts), 0, -1).reshape(-1, 3)
        places, _, numbers, _ = zip(*map(tree.find_nearest, asked.tolist()))
        corners = triangles[np.array(numbers)]
        shares = barycentric(np.array(places), shape[corners])
        velocities = np.einsum("nk,nkc->nc", shares, moved[corners]).astype(np.float32).reshape(*counts, 3)
        object_from_index = np.diag([cell, cell, cell, 1.0])
        object_from_index[:3, 3] = first
        return Velocity(
            components=tuple(np.moveaxis(velocities, -1, 0)),
            world_from_index=matrix @ object_from_index,
            world_from_velocity=matrix[:3, :3],
            times=(-frame, 1.0 - frame),
        )
