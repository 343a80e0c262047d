"""A mesh's triangles: what Blender has of them is read at once, and what takes time made of it on any thread."""

import functools
from dataclasses import dataclass
from typing import Optional

import numpy as np

from ...inference.scene import SceneError
from .placement import LARGEST


@dataclass
class Mesh:
    """places: float32 (V, 3). corners: int32 (L,), the vertex of each corner of each polygon. first: int32 (P + 1,), the
    first corner of each polygon, and where the last one ends. chosen: int32 (T, 3), vertices of Blender's own triangles,
    where polygons have more than four corners, else None.
    """

    places: np.ndarray
    corners: np.ndarray
    first: np.ndarray
    chosen: Optional[np.ndarray] = None

    @functools.cached_property
    def is_finite(self) -> bool:
        """Whether all places are numbers that can be computed with."""
        return bool(np.abs(self.places).max(initial=0.0) <= LARGEST)

    def triangles(self, matrix=np.eye(4)) -> np.ndarray:
        """float64 (T, 3, 3): corners, moved by a matrix (4, 4)."""
        places = self.places.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        return places[self._vertices()]

    def _vertices(self):
        if self.chosen is not None:
            return self.chosen
        # Triangles, and the first one of each quad: its corners 0, 1 and 2; the second one: 0, 2 and 3.
        first, quad = self.first[:-1], np.diff(self.first) == 4
        start = np.arange(len(first)) + np.cumsum(quad) - quad
        found = np.empty((len(first) + np.count_nonzero(quad), 3), np.int32)
        found[start] = self.corners[first[:, None] + [0, 1, 2]]
        corners = self.corners[first[quad, None] + np.arange(4)]
        found[start[quad] + 1] = corners[:, [0, 2, 3]]
        # Where that diagonal lies outside: along the other one.
        a, b, c, d = self.places[corners.T]
        outside = (np.cross(b - a, c - a) * np.cross(d - a, c - a)).sum(axis=1) > 0.0
        found[start[quad][outside]] = corners[outside][:, [0, 1, 3]]
        found[start[quad][outside] + 1] = corners[outside][:, [1, 2, 3]]
        return found


def require_finite(mesh: Mesh, where: str) -> None:
    """Raises SceneError, beginning with `where`, unless all places are numbers that can be computed with."""
    if not mesh.is_finite:
        raise SceneError(f"{where}: some of its vertices are not numbers, or lie above {LARGEST:g}; look at its "
                         "modifiers")


def read_mesh(mesh_object) -> Mesh:
    """The mesh of an evaluated object, in its own space. On Blender's main thread, or in a render."""
    mesh = mesh_object.to_mesh()
    try:
        # Without faces, or without vertices, Blender leaves the attributes away.
        if not len(mesh.polygons):
            return Mesh(np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(1, np.int32))
        places, corners = np.empty(3 * len(mesh.vertices), np.float32), np.empty(len(mesh.loops), np.int32)
        first = np.empty(len(mesh.polygons), np.int32)
        # As attributes they are copied whole; as vertices and loops one by one, which takes fifty times as long.
        mesh.attributes["position"].data.foreach_get("vector", places)
        mesh.attributes[".corner_vert"].data.foreach_get("value", corners)
        mesh.polygons.foreach_get("loop_start", first)
        first = np.append(first, np.int32(len(corners)))
        found = Mesh(places.reshape(-1, 3), corners, first)
        if np.diff(first).max(initial=3) > 4:
            mesh.calc_loop_triangles()
            chosen = np.empty(3 * len(mesh.loop_triangles), np.int32)
            mesh.loop_triangles.foreach_get("vertices", chosen)
            found.chosen = chosen.reshape(-1, 3)
        return found
    finally:
        mesh_object.to_mesh_clear()
