"""What opaque surfaces do to the light in volumes."""

import functools
import hashlib
from dataclasses import dataclass

import numpy as np

from ..runtime.cancellation import NEVER, CancelToken
from .shadow_map import ShadowMap


@dataclass(frozen=True)
class Occluders:
    """Black surfaces that keep suns' light, or scattered light, from volumes.

    directions: unit vectors (3,) to the suns, in the world. shadow_maps: a ShadowMap of each sun, or None where nothing
    shades the volumes from any. triangles: float64 (T, 3, 3), in the world, of the surfaces at which scattered light ends.
    shading: triangles (N, 3, 3) of each surface that shades, empty where shadow_maps is None.
    """

    directions: list[np.ndarray]
    shadow_maps: list[ShadowMap] | None
    triangles: np.ndarray
    shading: list[np.ndarray]

    def __bool__(self):
        return bool(self.shadow_maps) or len(self.triangles) > 0

    def shadow_map(self, direction) -> ShadowMap | None:
        """The ShadowMap of the sun in a direction, or None."""
        for known, shadow_map in zip(self.directions, self.shadow_maps or ()):
            if np.array_equal(known, direction):
                return shadow_map
        return None

    @functools.cached_property
    def key(self) -> bytes:
        """Equal for occluders that do the same to the light; b"" where they do nothing."""
        if not self:
            return b""
        digest = hashlib.blake2b(digest_size=16)
        for values in (*self.directions, *self.shading, self.triangles):
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.digest()


#: Those of a scene without surfaces.
NO_OCCLUDERS = Occluders([], None, np.zeros((0, 3, 3)), [])


def find_occluders(surfaces, directions, corners, cancel: CancelToken = NEVER):
    """Occluders for the suns of which some light reaches the volumes, and the numbers of these suns.

    surfaces: Surfaces. directions: unit vectors (3,) to the suns. corners: (8 B, 3) of the boxes of B volumes. Where no
    sun reaches the volumes, the occluders are those of the first. Raises Cancelled.
    """
    boxes = corners.reshape(-1, 8, 3)
    shading = [surface for surface in surfaces if surface.shades]
    maps = [ShadowMap(shading, direction, corners, cancel) for direction in directions if shading]
    if not any(shadow_map.shades(boxes) for shadow_map in maps):
        maps = []
    lit = [n for n in range(len(directions)) if not (maps and maps[n].darkens(boxes))]
    # Only surfaces that reach into the volumes' box: light that leaves it does not come back.
    low, high = corners.min(axis=0), corners.max(axis=0)
    ends = [surface.triangles for surface in surfaces if surface.stops and len(surface.triangles)]
    ends = [triangles for triangles in ends
            if np.all(triangles.min(axis=(0, 1)) < high) and np.all(triangles.max(axis=(0, 1)) > low)]
    return Occluders(
        list(directions), maps or None, np.concatenate(ends) if ends else np.zeros((0, 3, 3)),
        [surface.triangles for surface in shading] if maps else []), lit


def of_suns(occluders: Occluders, numbers: list[int], corners) -> Occluders:
    """The same for some of the suns."""
    maps = [occluders.shadow_maps[n] for n in numbers] if occluders.shadow_maps else []
    shaded = any(shadow_map.shades(corners.reshape(-1, 8, 3)) for shadow_map in maps)
    return Occluders([occluders.directions[n] for n in numbers], maps if shaded else None, occluders.triangles,
                     occluders.shading if shaded else [])
