# SPDX-License-Identifier: GPL-3.0-or-later
"""Opaque surfaces as occluders of the light in volumes."""

import functools
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Sun, Surface
from .shadow_map import ShadowMap


@dataclass(frozen=True)
class Occluders:
    """Black surfaces that block the light of suns, or scattered light, in volumes.

    suns: whose light they block. shadow_maps: ShadowMap per sun, of surfaces and of its own screen, or None if nothing
    shadows the volumes from any. triangles: float64 (T, 3, 3), in the world, of the surfaces that absorb scattered
    light. shading: triangles (N, 3, 3) of each surface that casts shadows, empty if shadow_maps is None.
    """

    suns: Sequence[Sun]
    shadow_maps: list[ShadowMap] | None
    triangles: np.ndarray
    shading: list[np.ndarray]

    def __bool__(self) -> bool:
        return bool(self.shadow_maps) or len(self.triangles) > 0

    def shadow_map(self, sun: Sun) -> ShadowMap | None:
        """ShadowMap of a sun, or None."""
        for candidate, shadow_map in zip(self.suns, self.shadow_maps or ()):
            if np.array_equal(candidate.direction, sun.direction) and candidate.screen_key == sun.screen_key:
                return shadow_map
        return None

    @functools.cached_property
    def key(self) -> bytes:
        """Digest that is equal for occluders of equal effect; empty if nothing occludes."""
        if not self:
            return b""
        digest = hashlib.blake2b(digest_size=16)
        for values in (*(sun.direction for sun in self.suns), *self.shading, self.triangles):
            digest.update(np.ascontiguousarray(values).tobytes())
        for sun in self.suns:
            digest.update(sun.screen_key)
        return digest.digest()


#: Occluders of a scene without surfaces.
NO_OCCLUDERS = Occluders([], None, np.zeros((0, 3, 3)), [])


def find_occluders(
    surfaces: Sequence[Surface],
    suns: Sequence[Sun],
    corners: np.ndarray,
    drop_dark: bool = True,
    cancel: CancelToken = NEVER,
) -> tuple[Occluders, list[int]]:
    """Occluders of the light in volumes, and the numbers of the suns that surfaces do not block entirely.

    corners: (8 B, 3) of the boxes of B volumes. drop_dark: whether to leave out the other suns; one remains in the
    Occluders even if all are blocked. Raises Cancelled.
    """
    boxes = corners.reshape(-1, 8, 3)
    shading = [surface for surface in surfaces if surface.shades]
    screens = [sun.screen(corners) for sun in suns]
    maps = []
    if shading or any(len(screen) for screen in screens):
        triangles = [surface.triangles for surface in shading]
        maps = [ShadowMap([*triangles, screen], sun.direction, corners, cancel) for sun, screen in zip(suns, screens)]
    if not any(shadow_map.shades(boxes) for shadow_map in maps):
        maps = []
    lit = [n for n in range(len(suns)) if not (drop_dark and maps and maps[n].darkens(boxes))]
    if len(lit) < len(suns):
        suns, maps = [suns[n] for n in lit or [0]], [maps[n] for n in lit or [0]]
        if not any(shadow_map.shades(boxes) for shadow_map in maps):
            maps = []
    # Only surfaces within the bounds of the volumes: light that has left these does not come back.
    low, high = corners.min(axis=0), corners.max(axis=0)
    ends = [surface.triangles for surface in surfaces if surface.stops and len(surface.triangles)]
    ends = [
        triangles
        for triangles in ends
        if np.all(triangles.min(axis=(0, 1)) < high) and np.all(triangles.max(axis=(0, 1)) > low)
    ]
    return Occluders(
        suns,
        maps or None,
        np.concatenate(ends) if ends else np.zeros((0, 3, 3)),
        [surface.triangles for surface in shading] if maps else [],
    ), lit
