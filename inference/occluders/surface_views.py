# SPDX-License-Identifier: GPL-3.0-or-later
"""How the light of surfaces looks from points throughout volumes.

The surfaces are known as the eye sees them. What other viewpoints see follows by iteration (distance impostors,
Szirmay-Kalos et al. 2005): a ray is intersected with the plane through the surface point that the eye sees towards the
ray's present end. That is exact for planes.
"""

import numpy as np

from ..numerics.small_matmul import product
from ..scene.environment import Environment, PlaceLattice, pixel_directions, pixel_numbers, pixel_solid_angles
from .seen_surfaces import ROWS, SeenSurfaces

# Viewpoints along an edge of the volumes' box, rows of their images, and their least distance from surfaces, in edges.
VIEWPOINTS, VIEW_ROWS, CLEARANCE = 6, 16, 0.01
# Steps along a ray, and distances at which it starts to look for surfaces, in edges of the box.
STEPS, STARTS = 3, (100.0, 1.0, 0.5, 0.25, 0.125)


class SurfaceViews:
    """Which of P seen points N viewpoints see in the K directions of an image's pixels.

    The viewpoints are VIEWPOINTS^3 throughout the volumes' box, and last the eye. hits: int (N, K), numbers of seen
    points, -1 where there is none. angles: (K,), solid angles.
    """

    def __init__(self, seen: SeenSurfaces, eye: np.ndarray, corners: np.ndarray):
        """eye: (3,), from which the points were seen. corners: (M, 3), of volumes."""
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)
        axes = np.linspace(self.low, self.high, VIEWPOINTS).T
        viewpoints = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        index = np.full(2 * ROWS * ROWS, -1)
        index[seen.pixel] = np.arange(len(seen.pixel))
        edge = float((self.high - self.low).max())
        # Of each seen point, the nearest viewpoint, and what a pixel's radiance there adds to the point's irradiance.
        place = (seen.points - self.low) / np.maximum(self.high - self.low, 1e-30) * (VIEWPOINTS - 1)
        i, j, k = np.clip(np.round(place), 0, VIEWPOINTS - 1).astype(int).T
        self._nearest = (i * VIEWPOINTS + j) * VIEWPOINTS + k
        viewpoints = np.concatenate([_before(seen, index, eye, viewpoints, CLEARANCE * edge), eye[None]])
        self.hits = _hits(seen, index, eye, viewpoints, edge)
        self.angles = np.broadcast_to(pixel_solid_angles(VIEW_ROWS), (VIEW_ROWS, 2 * VIEW_ROWS)).ravel()
        cosines = np.maximum(product(seen.normals, pixel_directions(VIEW_ROWS).reshape(-1, 3).T), 0.0)
        self._forms = cosines * self.angles

    def fluence(self, radiance: np.ndarray) -> np.ndarray:
        """Mean (3,) over the viewpoints of the fluence of surfaces' radiance (P, 3)."""
        return product(self.angles[None], self._image(radiance))[0]

    def irradiance(self, radiance: np.ndarray) -> np.ndarray:
        """Irradiance (P, 3) of the seen points by surfaces' radiance (P, 3), without what lies in between.

        Each point receives what the viewpoint nearest to it does in the direction of its normal.
        """
        received = np.zeros_like(radiance)
        for viewpoint in np.unique(self._nearest):
            some = np.flatnonzero(self._nearest == viewpoint)
            seen = np.stack([_at_hits(channel, self.hits[viewpoint]) for channel in radiance.T], axis=1)
            received[some] = product(self._forms[some], seen)
        return received

    def environment(self, radiance: np.ndarray, name: str) -> Environment | None:
        """The mean view of a radiance (P, 3), scaled to the fluence at each viewpoint; None if it is black.

        Only directions in which the eye sees surfaces shine: the sky is closed only there.
        """
        image = self._image(radiance) * (self.hits[-1] >= 0)[:, None]
        if not image.any():
            return None
        fluence = product(_at_hits(radiance.mean(axis=1), self.hits[:-1]), self.angles)
        weights = fluence / product(self.angles[None], image).mean()
        lattice = PlaceLattice(self.low, self.high, weights.reshape([VIEWPOINTS] * 3).astype(np.float32))
        return Environment(image.reshape(VIEW_ROWS, 2 * VIEW_ROWS, 3), name=name, weight=lattice)

    def _image(self, radiance: np.ndarray) -> np.ndarray:
        return np.stack([_at_hits(channel, self.hits).mean(axis=0) for channel in radiance.T], axis=1)


def _at_hits(values: np.ndarray, hits: np.ndarray) -> np.ndarray:
    """Values (P,) at hits, 0 where there is none."""
    return np.append(values, 0.0)[hits]


def _before(seen: SeenSurfaces, index: np.ndarray, eye: np.ndarray, points: np.ndarray, clearance: float) -> np.ndarray:
    """Points (N, 3), with those behind surfaces moved along the normals to a clearance in front of them.

    index: int, number of the seen point of each pixel of the eye's image, or -1.
    """
    number = index[pixel_numbers(points - eye, ROWS)]
    height = ((points - seen.points[number]) * seen.normals[number]).sum(axis=1)
    missing = np.where(number >= 0, np.maximum(clearance - height, 0.0), 0.0)
    return points + missing[:, None] * seen.normals[number]


def _hits(seen: SeenSurfaces, index: np.ndarray, eye: np.ndarray, points: np.ndarray, edge: float) -> np.ndarray:
    """Numbers of the seen points in the directions of pixels from points (N, 3): int (N, K), or -1.

    index: as for `_before`. edge: of the volumes' box.
    """
    directions = pixel_directions(VIEW_ROWS).reshape(-1, 3)
    hits = np.full((len(points), len(directions)), -1)
    for start in STARTS:
        view, pixel = np.nonzero(hits < 0)
        distance = np.full(len(view), start * edge)
        for _ in range(STEPS):
            origins, towards = points[view], directions[pixel]
            number = index[pixel_numbers(origins + distance[:, None] * towards - eye, ROWS)]
            normals = seen.normals[number]
            with np.errstate(divide="ignore", invalid="ignore"):
                distance = ((seen.points[number] - origins) * normals).sum(axis=1) / (towards * normals).sum(axis=1)
            met = (number >= 0) & np.isfinite(distance) & (distance > 0.0)
            view, pixel, number, distance = view[met], pixel[met], number[met], distance[met]
        hits[view, pixel] = number
    return hits
