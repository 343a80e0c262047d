# SPDX-License-Identifier: GPL-3.0-or-later
"""Unscattered light of a lamp in cells of a lattice, by compiled kernels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..grids.lamp_optical_depth import LampOpticalDepth
from ..kernels.library import call
from ..kernels.structures import array_of, pointers_to
from ..occluders.lamp_shadow_map import LampShadowMap
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.emitters import Emitter
from .described_lamps import describe_emitter, describe_shadow_map

# Samples between two polls of cancellation.
SAMPLES_PER_CALL = 1 << 19


@dataclass(frozen=True)
class LampCells:
    """Cells of a lattice, in matter of which the optical depths of a lamp's light are known.

    shape: (3,), of the lattice. world_from_index: (3, 3) and origin: (3,), the world position of a cell's middle.
    first: int (3,), the cell whose index is 0 in the grid of the optical depths. sigma, forward: extinction for density
    1, without the fraction that stands for light that scatters straight on.
    """

    shape: Sequence[int]
    world_from_index: np.ndarray
    origin: np.ndarray
    first: np.ndarray
    sigma: float
    forward: float = 0.0


def light_in_cells(
    emitters: Sequence[tuple[Emitter, LampOpticalDepth, LampShadowMap | None]],
    cells: LampCells,
    samples: tuple[np.ndarray, int, float],
    cancel: CancelToken = NEVER,
) -> np.ndarray:
    """Means over cells of a lamp's light of power 1, float32 (2, C): as it is, and without what lies in between.

    emitters: with the optical depths towards each, and its shadow map or None. samples: int (C,), flat numbers of the
    cells; the parts along their edges in whose middles the light is found; and the distance from the lamp within which
    it is not told apart. Raises Cancelled.
    """
    numbers, parts, radius = samples
    light = np.zeros((2, len(numbers)), np.float32)
    columns = [depth.described(cells.sigma, cells.forward) for _, depth, _ in emitters]
    maps = [None if one is None else describe_shadow_map(one) for _, _, one in emitters]
    described = array_of([describe_emitter(emitter) for emitter, _, _ in emitters])
    size = max(SAMPLES_PER_CALL // (parts**3 * len(emitters)), 1)
    for start in range(0, len(numbers), size):
        cancel.check()
        span = slice(start, start + size)
        call(
            "lamp_beam",
            lamp=len(emitters),
            columns=pointers_to(columns),
            emitters=described,
            shadow_maps=pointers_to(maps),
            shape=np.array(cells.shape),
            first=cells.first,
            count=len(numbers[span]),
            numbers=np.ascontiguousarray(numbers[span], np.int64),
            parts=parts,
            world=cells.world_from_index,
            offset=cells.origin,
            sigma=cells.sigma,
            radius=radius,
            light=light[0, span],
            open=light[1, span],
        )
    return light
