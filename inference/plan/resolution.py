# SPDX-License-Identifier: GPL-3.0-or-later
"""Resolutions that the plan decides on and later stages build to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

#: Cells along an edge of the working cube at level 0 of the density pyramid.
LEVEL0_CELLS = 256
#: Cells along an edge of the coarse transport.
TRANSPORT_CELLS = 64
#: Grids with fewer voxels along their longest edge are refined, to at most this many.
FINE_EDGE = 128
#: Rows and columns of the image per band. Pixels interpolate multiple scattering within a band of rows and one of
#: columns, and tiles consist of whole bands, so that the image does not depend on the tiles.
BAND = 33


@dataclass(frozen=True)
class Coarser:
    """Octaves by which a group of volumes is resolved less finely than usual.

    transport: of cells of the coarse transport. density: of those of the density that networks read.
    """

    transport: int = 0
    density: int = 0


#: As finely as usual.
USUAL = Coarser()


def refinement(shape: Sequence[int] | np.ndarray) -> int:
    """Factor by which a grid of `shape` (3,) voxels is refined along each axis."""
    return int(max(FINE_EDGE // max(shape), 1))
