# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that lamps inside a volume or near it leave on coarse cells once it has scattered.

It comes in three parts: light that has scattered within the phase function's forward peak alone (`peak_photons`), light
of the lamp or of that part that scatters by a wide angle, until it scatters again (`wide_light`), and what scatters on
(`discrete_ordinates`, in whose delta scaling the peak has no width).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..runtime.cancellation import NEVER, CancelToken
from ..transport.discrete_ordinates import DiscreteOrdinates
from ..transport.ordinates import ORDINATE_WEIGHTS, ORDINATES
from .forward_peak import forward_peak
from .held_cells import box_of
from .lamp_beam import CubeCells, LampInCube
from .peak_photons import LampInCells, peak_light
from .wide_light import MOMENTS, JoinedLobes, Lobe, scattered_wide, wide_light

# Optical thickness of cells within surfaces.
OPAQUE = np.float32(1e3)


@dataclass(frozen=True)
class NearbyMedium:
    """A medium on the cells of the working cube.

    density: float32 (n, n, n). sigma: extinction for density 1, per edge of the cube. anisotropy, albedo: of it.
    """

    density: np.ndarray
    sigma: float
    anisotropy: float
    albedo: float


def nearby_light(
    solver: DiscreteOrdinates,
    medium: NearbyMedium,
    lamps: Sequence[tuple[LampInCube, float]],
    cancel: CancelToken = NEVER,
) -> np.ndarray:
    """Scattered light of lamps of power 1, each times a factor: float32 (20, n, n, n).

    Moments of its radiance by `spherical_harmonics`, of all but the light that has scattered within the forward peak
    alone, and this light's fluence and flux. solver: of the medium. Raises Cancelled.
    """
    n, boundaries, box = len(medium.density), solver.boundaries, box_of(medium.density, 1)
    inner = (slice(None), *box)
    depth, closed = medium.density * np.float32(medium.sigma / n), None
    if boundaries is not None:
        depth = np.where(boundaries.inside, OPAQUE, depth)
        closed = (boundaries.facing > 0.0).astype(np.uint8)[inner]
    depth, peak = np.ascontiguousarray(depth[box]), forward_peak(medium.anisotropy)
    corner, cells = tuple(part.start for part in box), CubeCells(medium.density, medium.sigma)
    moments, lobes = np.zeros((MOMENTS + 4, n, n, n), np.float32), JoinedLobes(depth.shape)
    narrow, wide = moments[MOMENTS:], moments[:MOMENTS]
    for lamp, power in lamps:
        light, towards = lamp(cells, cancel)
        light = light[box] if boundaries is None else (light * ~boundaries.inside)[box]
        place = (lamp.place + 0.5) * n - corner
        lit_cells = LampInCells(depth, light, place, closed, medium.albedo, lamp.cone, corner)
        narrow[inner] += np.float32(power) * peak_light(lit_cells, peak, cancel)
        lobes.add(Lobe(light * np.float32(power), -towards[inner], _straightness(lit_cells)))
    scattered, beams = [*lobes.lobes, Lobe.of(narrow[0][box], narrow[1:][inner])], None
    if boundaries is None:
        scaled = solver.extinction[box] * np.float32(1.0 / n)
        wide[inner] = wide_light(scaled, float(solver.albedo), scattered, peak, cancel)
    else:
        # Few directions, but none passes a surface.
        beams = np.zeros((len(ORDINATES), n, n, n), np.float32)
        beams[inner] = scattered_wide(scattered, peak, -ORDINATES, ORDINATE_WEIGHTS)
    wide += solver.moments(wide[:4].copy(), beams, cancel)
    return moments


def _straightness(cells: LampInCells) -> np.ndarray | float:
    """Mean cosine of a lamp's light around its mean direction in each cell: from the lamp's own, it goes all around."""
    if cells.cone is not None:
        return 1.0
    apart = [axis + 0.5 - place for axis, place in zip(np.ogrid[tuple(map(slice, cells.depth.shape))], cells.place)]
    return np.tanh(1.5 * np.sqrt(sum(one**2 for one in apart))).astype(np.float32)
