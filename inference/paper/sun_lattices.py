# SPDX-License-Identifier: GPL-3.0-or-later
"""Lattices of the scaled transmittance of one sun (appendix A.3 of the paper).

That of mip m is field i = max(m - 1, 0), exp(-BETA^(i + 1) tau), where the optical depth tau towards the sun is
integrated through level i + 1 of the density pyramid. Beyond the cube it equals that of the redirection to the boundary
in the paper.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..features.mip_lattices import QUANTA, FineCells, Lattices, fill_lattices, margins
from ..features.stencil import Stencil
from ..grids.optical_depth_sweep import sun_optical_depth
from ..occluders.shadow_map import ShadowMap
from ..plan.resolution import LEVEL0_CELLS

# beta of the scaled transmittance.
BETA = 0.578
# Optical depth that stands for the shadow of surfaces in the scaled transmittance: no volume that the network was
# trained on makes its wider fields black.
MAX_SHADOW_DEPTH = 10.0
# Sample points along an edge of a cell of levels 1 to 7 for the visibility of the sun.
VISIBILITY_SAMPLES = (1, 1, 1, 2, 4, 4, 4)


def unit_optical_depths(padded: Sequence[np.ndarray], direction: np.ndarray) -> list[np.ndarray]:
    """Optical depth towards the sun through levels 1 to 7 for sigma_hat = 1, on the padded lattices.

    direction: (3,) unit vector towards the sun in the cube's frame.
    """
    return [
        sun_optical_depth(level, direction, 1.0 / (LEVEL0_CELLS >> m)) for m, level in enumerate(padded[1:], start=1)
    ]


def visibility_levels(stencil: Stencil, shadow_map: ShadowMap) -> list[np.ndarray]:
    """Visibility of the sun in the cells of levels 1 to 7, on the padded lattices.

    shadow_map: in the cube's frame.
    """
    return [
        shadow_map.cell_visibility(LEVEL0_CELLS >> m, margin, samples)
        for m, (margin, samples) in enumerate(zip(margins(stencil)[1:], VISIBILITY_SAMPLES), start=1)
    ]


@dataclass(frozen=True)
class SunLevels:
    """Light of one sun on levels 1 to 7 of the padded pyramid.

    unit_depths: from `unit_optical_depths`. visibility: from `visibility_levels`, or None if no surface shadows the
    cube.
    """

    unit_depths: list[np.ndarray]
    visibility: list[np.ndarray] | None = None


def sun_lattices(
    sun: SunLevels,
    sigma_hat: float,
    stencil: Stencil,
    extent: tuple[np.ndarray | float, np.ndarray | float] = (-0.5, 0.5),
    mapper: Callable[..., Iterable[None]] = map,
) -> Lattices:
    """Lattices of the scaled transmittance; arguments as for `density_lattices`.

    Optical depth is interpolated before taking the exponential.
    """

    def filling(cells: FineCells) -> dict[str, Any]:
        source = max(cells.mip, 1)
        between, scale = cells.between(source), BETA**source
        fields = {
            "depth": between.described(sun.unit_depths[source - 1]),
            "depth_scale": sigma_hat * scale,
            "least_visible": float(np.exp(-MAX_SHADOW_DEPTH * scale)),
        }
        if sun.visibility is not None:
            fields["visibility"] = between.described(sun.visibility[source - 1])
        return fields

    return fill_lattices(stencil, extent, np.float32(1.0 / QUANTA), filling, mapper)
