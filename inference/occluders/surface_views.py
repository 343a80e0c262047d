# SPDX-License-Identifier: GPL-3.0-or-later
"""How the light of surfaces looks from places throughout volumes.

The surfaces are known as one point sees them. What other places see follows from that: a ray meets the plane through
the surface point that is seen where the ray ends so far, a few times over (distance impostors, Szirmay-Kalos et al.
2005). That is exact for planes.
"""

import numpy as np

from ..numerics.small_matmul import product
from ..scene.environment import Environment, PlaceLattice, pixel_directions, pixel_numbers, pixel_solid_angles
from .seen_surfaces import ROWS, SeenSurfaces

# Places along an edge of the volumes' box, rows of their images, and their least distance from surfaces, in edges.
PLACES, VIEW_ROWS, CLEARANCE = 6, 16, 0.01
# Steps along a ray, and distances at which it starts to look for surfaces, in edges of the box.
STEPS, STARTS = 3, (100.0, 1.0, 0.5, 0.25, 0.125)


class SurfaceViews:
    """Which of P seen points N places see in the K directions of an image's pixels.

    The places are PLACES^3 throughout the volumes' box, and the one from which the points were seen. found: int (N, K),
    -1 where there is none. angles: (K,), solid angles.
    """

    def __init__(self, seen: SeenSurfaces, eye: np.ndarray, corners: np.ndarray):
        """eye: (3,), from which the points were seen. corners: (M, 3), of volumes."""
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)
        axes = np.linspace(self.low, self.high, PLACES).T
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        known = np.full(2 * ROWS * ROWS, -1)
        known[seen.pixel] = np.arange(len(seen.pixel))
        edge = float((self.high - self.low).max())
        places = np.concatenate([_before(seen, known, eye, places, CLEARANCE * edge), eye[None]])
        self.found = _found(seen, known, eye, places, edge)
        self.angles = np.broadcast_to(pixel_solid_angles(VIEW_ROWS), (VIEW_ROWS, 2 * VIEW_ROWS)).ravel()

    def fluence(self, radiance: np.ndarray) -> np.ndarray:
        """Mean (3,) over the places of the fluence of surfaces' radiance (P, 3)."""
        return product(self.angles[None], self._image(radiance))[0]

    def environment(self, radiance: np.ndarray, name: str) -> Environment | None:
        """What places see of a radiance (P, 3), None if it is black: the mean of it, as strong at each as there.

        It comes from where the surfaces are as seen first, since volumes have been opened there.
        """
        image = self._image(radiance) * (self.found[-1] >= 0)[:, None]
        if not image.any():
            return None
        fluence = product(_shown(radiance.mean(axis=1), self.found[:-1]), self.angles)
        weights = fluence / product(self.angles[None], image).mean()
        lattice = PlaceLattice(self.low, self.high, weights.reshape([PLACES] * 3).astype(np.float32))
        return Environment(image.reshape(VIEW_ROWS, 2 * VIEW_ROWS, 3), name=name, weight=lattice)

    def _image(self, radiance: np.ndarray) -> np.ndarray:
        return np.stack([_shown(channel, self.found).mean(axis=0) for channel in radiance.T], axis=1)


def _shown(values: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Values (P,) of what is found, 0 where nothing is."""
    return np.append(values, 0.0)[found]


def _before(seen: SeenSurfaces, known: np.ndarray, eye: np.ndarray, places: np.ndarray, clearance: float) -> np.ndarray:
    """Places (N, 3), those behind surfaces moved along their normals to a distance before them.

    known: int, which of the seen points each pixel shows, or -1.
    """
    number = known[pixel_numbers(places - eye, ROWS)]
    height = ((places - seen.points[number]) * seen.normals[number]).sum(axis=1)
    missing = np.where(number >= 0, np.maximum(clearance - height, 0.0), 0.0)
    return places + missing[:, None] * seen.normals[number]


def _found(seen: SeenSurfaces, known: np.ndarray, eye: np.ndarray, places: np.ndarray, edge: float) -> np.ndarray:
    """Which of the seen points lie in the directions of pixels from places (N, 3): int (N, K), or -1.

    known: as for `_before`. edge: of the volumes' box.
    """
    directions = pixel_directions(VIEW_ROWS).reshape(-1, 3)
    found = np.full((len(places), len(directions)), -1)
    for start in STARTS:
        place, way = np.nonzero(found < 0)
        distance = np.full(len(place), start * edge)
        for _ in range(STEPS):
            origins, towards = places[place], directions[way]
            number = known[pixel_numbers(origins + distance[:, None] * towards - eye, ROWS)]
            normals = seen.normals[number]
            with np.errstate(divide="ignore", invalid="ignore"):
                distance = ((seen.points[number] - origins) * normals).sum(axis=1) / (towards * normals).sum(axis=1)
            met = (number >= 0) & np.isfinite(distance) & (distance > 0.0)
            place, way, number, distance = place[met], way[met], number[met], distance[met]
        found[place, way] = number
    return found
