"""What opaque surfaces do to the light in volumes."""

import copy
from typing import List

import numpy as np

from .sun_map import SunMap


class Obstacles:
    """Surfaces that keep suns, or light that is scattered, from volumes; black.

    sun_maps: a SunMap of each sun, or None where nothing is shaded from any. lit: numbers of the suns of which some
    light may reach the volumes. triangles: float64 (T, 3, 3), in the world, of the surfaces that end scattered light.
    """

    def __init__(self, surfaces, directions: List[np.ndarray], corners: np.ndarray, check=lambda: None):
        """surfaces: Surfaces; directions: (3,) unit vectors to the suns; corners: (8 B, 3) of B volumes.
        check: called several times a second; what it raises ends the work.
        """
        self.directions, self.boxes = directions, corners.reshape(-1, 8, 3)
        self.shading = [surface for surface in surfaces if surface.shades]
        self.sun_maps = [SunMap(self.shading, direction, corners, check) for direction in directions if self.shading]
        self._forget_what_shades_nothing()
        self.lit = [n for n in range(len(directions)) if not (self.sun_maps and self.sun_maps[n].darkens(self.boxes))]
        # Only those that reach into the volumes' box: light that leaves it does not come back.
        low, high = corners.min(axis=0), corners.max(axis=0)
        stopping = [surface.triangles for surface in surfaces if surface.stops and len(surface.triangles)]
        stopping = [triangles for triangles in stopping
                    if np.all(triangles.min(axis=(0, 1)) < high) and np.all(triangles.max(axis=(0, 1)) > low)]
        self.triangles = np.concatenate(stopping) if stopping else np.zeros((0, 3, 3))

    def __bool__(self):
        return bool(self.sun_maps) or len(self.triangles) > 0

    def of_suns(self, numbers: List[int]) -> "Obstacles":
        """The same for some of the suns."""
        some = copy.copy(self)
        some.directions = [self.directions[n] for n in numbers]
        some.sun_maps = [self.sun_maps[n] for n in numbers]
        some._forget_what_shades_nothing()
        return some

    def _forget_what_shades_nothing(self):
        if not any(sun_map.shades(self.boxes) for sun_map in self.sun_maps):
            self.sun_maps, self.shading = None, []

    def alike(self, other) -> bool:
        """Whether both do the same to the light."""
        if not self or not other:
            return bool(self) == bool(other)
        mine, theirs = ([*one.directions, *(surface.triangles for surface in one.shading), one.triangles]
                        for one in (self, other))
        return len(mine) == len(theirs) and all(map(np.array_equal, mine, theirs))
