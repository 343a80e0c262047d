# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth samples of camera rays that pass lamps near volumes.

Light that the coarse transport alone tells varies along a ray as that of the lamp does: where the ray passes it at a
distance h over a length of about h, and at once at the edge of a spot's cone.
"""

from collections.abc import Sequence

import numpy as np

from ..scene.settings import DETAIL
from .lamp_in_media import LampInMedia
from .ray_steps import RayBatch

# Length of a ray over its distance to a lamp from which on it takes more samples: as many times as it is longer.
CLOSE = 4.0


def detail_of_rays(lamps: Sequence[LampInMedia], rays: RayBatch, most: int) -> np.ndarray:
    """By how much the depth samples of rays are multiplied, int (R,): of DETAIL; most: of these, the largest."""
    found = np.ones(len(rays.near))
    for lamp in lamps:
        away = lamp.centre - rays.origins
        nearest = np.clip((away * rays.directions).sum(axis=1), rays.near, rays.far)
        distance = np.linalg.norm(away - nearest[:, None] * rays.directions, axis=1)
        np.maximum(found, (rays.far - rays.near) / np.maximum(CLOSE * distance, CLOSE * lamp.reach + 1e-30), out=found)
        for emitter in lamp.emitters:
            if emitter.cone is not None:
                first, last = emitter.lit_between(rays.origins, rays.directions)
                first, last = np.maximum(first, rays.near), np.minimum(last, rays.far)
                found[(first < last) & ((first > rays.near) | (last < rays.far))] = most
    return np.array(DETAIL)[np.searchsorted(DETAIL, np.minimum(found, most))]
