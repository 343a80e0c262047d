"""What a render leaves out, since the picture does not need it; each can be asked for all the same."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Optimization:
    """One thing that is left out.

    title: a few words. what: what happens instead. budget: root mean square that a picture may change by, over its
    mean where it shows volumes, at 8 depth samples and, but for "shared_pixels" itself, without pixels that share: a
    picture that hardly differs may share others.
    """

    title: str
    what: str
    budget: float


# Of sums in another order, in single precision.
ROUNDING = 1e-4

OPTIMIZATIONS = {
    "missed_pixels": Optimization(
        "Pixels Without Volumes", "No camera rays through pixels away from every volume", 0.0),
    "empty_space": Optimization(
        "Empty Space", "Camera rays skip what lies away from density", ROUNDING),
    "behind_opaque": Optimization(
        "What Is Hidden", "Camera rays end where volumes have become opaque", 1e-3),
    "needless_suns": Optimization(
        "Needless Suns",
        "Suns of no light, or in the shadow of meshes, are left out, and parallel ones merged", 5e-3),
    "equal_channels": Optimization(
        "Equal Extinction", "Colour channels of one extinction share rays, fields and network", ROUNDING),
    "equal_albedos": Optimization(
        "Equal Albedos", "Channels of one albedo share the network's answer, and black ones need none", ROUNDING),
    "unread_fields": Optimization(
        "Fields Out of Reach", "Lookup fields are built only as far as visible points reach", ROUNDING),
    "unchanged": Optimization(
        "What Has Not Changed", "Viewport and animations keep volumes, shadows and fields", ROUNDING),
    "faint_rays": Optimization(
        "Samples of Faint Rays", "Fewer depth samples where volumes are faint", 0.02),
    "shared_pixels": Optimization(
        "Pixels Like Their Neighbours", "Pixels take multiple scattering from neighbours that agree", 0.02),
}
ALL = frozenset(OPTIMIZATIONS)
