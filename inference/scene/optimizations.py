# SPDX-License-Identifier: GPL-3.0-or-later
"""Optimizations: what a render skips because it hardly changes the picture. Each can be turned off."""

import itertools
from dataclasses import dataclass


@dataclass(frozen=True)
class Optimization:
    """One optimization.

    title: its name in the interface. what: the effect, for a tooltip. budget: largest change of a picture that it may
    cause, as root mean square over the mean where the picture shows volumes, at 8 depth samples; measured with
    "shared_pixels" off except for "shared_pixels" itself, because a picture that hardly differs may interpolate other
    pixels.
    """

    title: str
    what: str
    budget: float


# Change caused by summing in another order in single precision.
ROUNDING = 1e-4

# In the order in which they were added: .blend files hold the numbers of those that are on, RETIRED ones counted.
OPTIMIZATIONS = {
    "missed_pixels": Optimization("Skip Empty Pixels", "No camera rays through pixels away from every volume", 0.0),
    "empty_space": Optimization("Skip Empty Space", "Camera rays skip space without density", ROUNDING),
    "behind_opaque": Optimization("Early Ray Termination", "Camera rays end where volumes have become opaque", 1e-3),
    "needless_suns": Optimization(
        "Merge and Cull Suns", "Suns without light, or shadowed by meshes, are skipped, and parallel ones merged", 5e-3
    ),
    "faint_lamps": Optimization(
        "Skip Faint Lamps", "Lamps too weak or too far to be seen beside other light are skipped", 5e-3
    ),
    "soft_suns": Optimization(
        "Join Soft Suns", "Multiple scattering of the directions of a soft sun is predicted once for all of them", 0.02
    ),
    "distant_lamps": Optimization(
        "Join Lamps", "Lamps near a volume, or from about the same direction, share multiple scattering", 0.02
    ),
    "equal_channels": Optimization(
        "Share Equal Extinction", "Color channels of equal extinction share rays, lookup grids and network", ROUNDING
    ),
    "equal_albedos": Optimization(
        "Share Equal Albedos", "Channels of equal albedo share the network's prediction, black ones need none", ROUNDING
    ),
    "unchanged": Optimization(
        "Reuse Between Frames", "Viewport and animations reuse volumes, shadows and lookup grids", ROUNDING
    ),
    "faint_rays": Optimization("Adaptive Depth Samples", "Fewer depth samples where volumes are faint", 0.02),
    "shared_pixels": Optimization(
        "Adaptive Interpolation", "Pixels interpolate multiple scattering where their neighbors agree", 0.02
    ),
    "unseen_voxels": Optimization(
        "Skip Unseen Voxels", "Baked light is 0 where no ray reaches within an optical depth of 20", ROUNDING
    ),
    "smooth_light": Optimization(
        "Interpolate Smooth Light", "Baked light is interpolated between voxels where these agree", 0.02
    ),
    "small_voxels": Optimization(
        "Join Small Voxels",
        "Light is baked in voxels half as large as a pixel where the volume's are smaller, at least 32 along its edge",
        0.02,
    ),
    "soft_shadows": Optimization(
        "Average Soft Shadows",
        "The shadows of a lamp's parts are averaged at voxels where rays are many; those of faint lamps are coarser",
        0.02,
    ),
    "joined_volumes": Optimization("Join Overlapping Volumes", "Camera rays see one volume where many overlap", 0.03),
    "level_of_detail": Optimization(
        "Level of Detail",
        "The light of volumes that cover few pixels is computed on larger cells, and less often",
        5e-3,
    ),
}
ALL = frozenset(OPTIMIZATIONS)
# Optimizations that older files and command lines name, by number: nothing depends on them any more.
RETIRED = {9: "unread_fields"}


def numbers() -> dict[str, int]:
    """The number of each optimization in .blend files."""
    free = (number for number in itertools.count() if number not in RETIRED)
    return dict(zip(OPTIMIZATIONS, free))
