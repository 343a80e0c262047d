# SPDX-License-Identifier: GPL-3.0-or-later
"""Resolutions that the plan decides on and later stages build to."""

from collections.abc import Sequence

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


def refinement(shape: Sequence[int] | np.ndarray) -> int:
    """Factor by which a grid of `shape` (3,) voxels is refined along each axis."""
    return int(max(FINE_EDGE // max(shape), 1))
