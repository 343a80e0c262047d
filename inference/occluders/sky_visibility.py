# SPDX-License-Identifier: GPL-3.0-or-later
"""Which parts of the sky surfaces leave open to points in volumes: a shadow map in each of many directions."""

import functools
import hashlib
from collections.abc import Sequence

import numpy as np

from ..numerics.quadrature import even_directions
from ..runtime.cancellation import NEVER, CancelToken
from .shadow_map import ShadowMap

# Directions, fewer where that makes more pairs of triangle and direction; and cells along the longer side of a map.
DIRECTIONS, LEAST_DIRECTIONS, MOST_PAIRS, CELLS = 96, 24, 1 << 20, 64
# Points along an edge of the volumes' box, of the mean visibility.
POINTS = 4


class SkyVisibility:
    """The share of light from each of K directions that reaches points past surfaces; equal for equal surfaces.

    directions: (K, 3), unit vectors towards the light, spread evenly over the sphere.
    """

    def __init__(self, surfaces: Sequence[np.ndarray], corners: np.ndarray, cancel: CancelToken = NEVER):
        """Raises Cancelled.

        surfaces: triangles (T, 3, 3) of each, in the world. corners: (N, 3), whose convex hull holds all volumes.
        """
        triangles = np.concatenate(surfaces)
        self.directions = even_directions(int(np.clip(MOST_PAIRS // len(triangles), LEAST_DIRECTIONS, DIRECTIONS)))
        self._maps = [ShadowMap([triangles], towards, corners, cancel, CELLS) for towards in self.directions]
        self._ends = corners.min(axis=0), corners.max(axis=0)
        self._key = hashlib.blake2b(triangles.tobytes() + corners.tobytes(), digest_size=16).digest()

    def towards(self, positions: np.ndarray) -> np.ndarray:
        """Visibility float32 (N, K) in each direction from world positions (N, 3)."""
        visible = np.empty((len(self._maps), len(positions)), np.float32)
        for row, shadow_map in zip(visible, self._maps):
            row[:] = shadow_map.visibility_at(positions)
        return visible.T

    def __call__(self, positions: np.ndarray) -> np.ndarray:
        """Mean over the directions, float32 (N,), at world positions (N, 3)."""
        return self.towards(positions).mean(axis=1)

    @functools.cached_property
    def mean(self) -> float:
        """Mean over the volumes' box, too."""
        axes = np.linspace(*self._ends, POINTS).T
        return float(self(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)).mean())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SkyVisibility) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)
