# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles of a mesh: copied from Blender at once, processed on any thread."""

import functools
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ...inference.scene import SceneError
from .placement import LARGEST

IDENTITY = np.eye(4)


@dataclass
class Mesh:
    """places: float32 (V, 3), vertices. corners: int32 (L,), vertex of each corner of each polygon. first: int32 (P +
    1,), first corner of each polygon, and the number of corners. chosen: int32 (T, 3), Blender's own triangulation
    where polygons have more than four corners, else None. areas: float64 (M,), of the polygons of each material slot
    up to the last that is used; empty where there is but one.
    """

    places: np.ndarray
    corners: np.ndarray
    first: np.ndarray
    chosen: np.ndarray | None = None
    areas: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @functools.cached_property
    def is_finite(self) -> bool:
        """Whether all vertices are finite and in range."""
        return bool(np.abs(self.places).max(initial=0.0) <= LARGEST)

    def triangles(self, matrix: np.ndarray = IDENTITY, places: np.ndarray | None = None) -> np.ndarray:
        """float64 (T, 3, 3) corners, transformed by a matrix (4, 4).

        places: (V, 3), other ones of the vertices.
        """
        places = self.places if places is None else places
        places = places.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        return places[self.numbers()]

    def numbers(self) -> np.ndarray:
        """int (T, 3), vertices of each triangle."""
        if self.chosen is not None:
            return self.chosen
        # Triangles, and the first triangle of each quad: corners 0, 1, 2. The second: 0, 2, 3.
        first, quad = self.first[:-1], np.diff(self.first) == 4
        start = np.arange(len(first)) + np.cumsum(quad) - quad
        found = np.empty((len(first) + np.count_nonzero(quad), 3), np.int32)
        found[start] = self.corners[first[:, None] + [0, 1, 2]]
        corners = self.corners[first[quad, None] + np.arange(4)]
        found[start[quad] + 1] = corners[:, [0, 2, 3]]
        # Where that diagonal lies outside the quad, use the other.
        a, b, c, d = self.places[corners.T]
        outside = (np.cross(b - a, c - a) * np.cross(d - a, c - a)).sum(axis=1) > 0.0
        found[start[quad][outside]] = corners[outside][:, [0, 1, 3]]
        found[start[quad][outside] + 1] = corners[outside][:, [1, 2, 3]]
        return found


def require_finite(mesh: Mesh, where: str) -> None:
    """Raises SceneError, prefixed with `where`, unless all vertices are finite and in range."""
    if not mesh.is_finite:
        raise SceneError(f"{where}: some of its vertices are not finite or exceed {LARGEST:g}; check its modifiers")


def read_mesh(mesh_object: "bpy.types.Object") -> Mesh:
    """The mesh of an evaluated object, in object space. Call on Blender's main thread or in a render."""
    mesh = mesh_object.to_mesh()
    try:
        # Without faces or vertices, Blender omits the attributes.
        if not len(mesh.polygons):
            return Mesh(np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(1, np.int32))
        places, corners = np.empty(3 * len(mesh.vertices), np.float32), np.empty(len(mesh.loops), np.int32)
        first = np.empty(len(mesh.polygons), np.int32)
        # Attributes are copied as a block; vertices and loops one by one, which takes fifty times as long.
        attributes: Any = mesh.attributes
        attributes["position"].data.foreach_get("vector", places)
        attributes[".corner_vert"].data.foreach_get("value", corners)
        mesh.polygons.foreach_get("loop_start", first)
        first = np.append(first, np.int32(len(corners)))
        found = Mesh(places.reshape(-1, 3), corners, first)
        if len(mesh_object.material_slots) > 1:
            areas, slots = np.empty(len(mesh.polygons), np.float32), np.empty(len(mesh.polygons), np.int32)
            mesh.polygons.foreach_get("area", areas)
            mesh.polygons.foreach_get("material_index", slots)
            found.areas = np.bincount(np.maximum(slots, 0), areas)
        if np.diff(first).max(initial=3) > 4:
            mesh.calc_loop_triangles()
            chosen = np.empty(3 * len(mesh.loop_triangles), np.int32)
            mesh.loop_triangles.foreach_get("vertices", chosen)
            found.chosen = chosen.reshape(-1, 3)
        return found
    finally:
        mesh_object.to_mesh_clear()
