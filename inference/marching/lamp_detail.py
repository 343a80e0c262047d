# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth samples of camera rays that pass lamps near volumes.

Multiple scattering that the coarse transport gives varies along a ray as the lamp's own light does: over a length of
about h where the ray passes the lamp at a distance h, and abruptly at the edge of a spot's cone.
"""

from collections.abc import Sequence

import numpy as np

from ..scene.settings import DETAIL
from .lamp_in_media import LampInMedia
from .ray_steps import RayBatch

# Length of a ray over its distance to a lamp above which it takes more samples, in proportion.
CLOSE = 4.0


def detail_of_rays(lamps: Sequence[LampInMedia], rays: RayBatch, most: int) -> np.ndarray:
    """Factors of the depth samples of rays, int (R,), each a value of DETAIL up to most."""
    times = np.ones(len(rays.near))
    for lamp in lamps:
        away = lamp.centre - rays.origins
        nearest = np.clip((away * rays.directions).sum(axis=1), rays.near, rays.far)
        distance = np.linalg.norm(away - nearest[:, None] * rays.directions, axis=1)
        np.maximum(times, (rays.far - rays.near) / np.maximum(CLOSE * distance, CLOSE * lamp.reach + 1e-30), out=times)
        for emitter in lamp.emitters:
            if emitter.cone is not None:
                first, last = emitter.lit_between(rays.origins, rays.directions)
                first, last = np.maximum(first, rays.near), np.minimum(last, rays.far)
                times[(first < last) & ((first > rays.near) | (last < rays.far))] = most
    return np.array(DETAIL)[np.searchsorted(DETAIL, np.minimum(times, most))]
