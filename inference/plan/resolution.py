"""Resolutions that the plan decides and later stages build to."""

#: Cells along an edge of the working cube at level 0 of the density pyramid.
LEVEL0_CELLS = 256
#: Grids with fewer voxels along their longest edge are refined, to at most this many.
FINE_EDGE = 128
#: Rows per band of the image. Pixels interpolate multiple scattering within a band, and tiles are whole bands, so that
#: the image does not depend on the tiles.
BAND = 33


def refinement(shape) -> int:
    """Factor by which a grid of this shape is refined along each axis."""
    return max(FINE_EDGE // max(shape), 1)
