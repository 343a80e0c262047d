# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering of lamps inside a volume or near it, from the coarse transport alone.

Networks have learnt the light of suns, which enters a volume from outside and is as bright everywhere. That of a lamp
nearby is not: it falls with the square of the distance, comes from all around, and how much of it an albedo below 1
leaves does not follow from the transport for albedo 1 that networks read. `source_terms.nearby_light` solves it for the
true albedo, in two parts that scatter towards the camera in different ways.

Light that has scattered within the phase function's forward peak alone has a fluence S and a flux F. Seen from the side
and from behind the lamp it is light of Henyey and Greenstein's distribution p around the flux, with the mean cosine
|F| / S, and scatters as

    S p(-omega . F / |F|; G |F| / S).

Seen towards the lamp its shape counts, too. The lamp's light of irradiance E behind an optical depth tau has become

    E sum_l (2 l + 1) / (4 pi) G^l P_l(omega . l) T(p_l),    T(s) = exp(-(1 - w s) tau) - exp(-tau),

where p_l = G^l - (1 - G^2) G'^l with the transport's G' = G / (1 + G) are the peak's moments, were the lamp far away:
after n scatterings moments are n-th powers (Goudsmit and Saunderson, "Multiple Scattering of Electrons", 1940). But
light from a place that turns by an angle a at a part t of the way arrives off the straight line by about t a, not a: s
is the mean of p_(t l) over the matter on the way, read at a few places. As much of this is taken as F holds along the
lamp's light, and the rest of S and F scatters by p again: all of it where the lamp is right ahead, and the first form
alone from beside it on.

The light of a soft falloff is weaker near its middle than that of a point, and what it scatters there is, too: its
depth tau counts from `start_depths` on in the first term of T.

Of all other light the transport holds moments L_lm of the radiance up to degree 3, and what scatters towards the camera
is

    (L_0 - a) / (4 pi) + a p(-omega . f; G r)
        + sum_lm (2 l + 1) / (4 pi) G^l f_l (L_lm - a r^l Y_lm(f)) Y_lm(-omega):

light that comes evenly from everywhere, and light of Henyey and Greenstein's distribution around its mean direction f,
of an amount a and a mean cosine r that its first two moments along f tell. What differs from these fades, f_l being
the roots of Lanczos' factors sinc(l / 4), since a series that breaks off is as negative at some angles as it is too
bright at others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..kernels import structures
from ..kernels.library import call
from ..kernels.structures import array_of
from ..numerics.spherical_harmonics import DEGREES
from ..scene.emitters import Emitter
from ..scene.phase_function import reduced_anisotropy
from ..source_terms.described_lamps import describe_emitter
from ..source_terms.forward_peak import MIN_FORWARD
from ..transport.scattered_fluence import FluenceLattice
from .conditions import Bounds

# Distance from a lamp to the nearest point of a volume, over that to the farthest, up to which the transport alone is
# its multiple scattering, and from which on it is what networks predict: against photons at a mean cosine of 0.857 the
# transport is closer at 0.1, the network at 0.3.
NEAR, FAR = 0.1, 0.2
#: Highest degree of the transport's moments.
LAST = int(DEGREES[-1])
# Roots of Lanczos' factors of the degrees, times their weights in a series of Legendre's polynomials.
WEIGHTS = np.sqrt(np.sinc(np.arange(LAST + 1) / (LAST + 1))) * (2 * np.arange(LAST + 1) + 1) / (4.0 * np.pi)
# Largest mean cosines of light around a direction: that of the transport's moments, measured, and that of the peak's.
STRAIGHTEST, STRAIGHTEST_PEAK = 0.9, 0.999
# Least light that scatters towards the camera, over what would if it did so evenly; measured.
LEAST = 0.05
# Terms of Legendre series are summed down to this one, but no more than so many.
MIN_TERM, MAX_TERMS = 1e-4, 160
# Part of the fluence, over the number of lamps, below which a lamp's light is not told apart from that of others.
JOINED = 0.02
#: Smallest albedo for which the transport is solved.
MIN_ALBEDO = 1e-3


def transport_share(lamp: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Share of the transport alone in a lamp's multiple scattering, 0 to 1.

    lamp: (3,), its place. low, high: (3,), of the box around the volume.
    """
    nearest = float(np.linalg.norm(np.maximum(np.maximum(low - lamp, lamp - high), 0.0)))
    farthest = float(np.linalg.norm(np.maximum(lamp - low, high - lamp)))
    return min(max((FAR - nearest / max(farthest, 1e-30)) / (FAR - NEAR), 0.0), 1.0)


@dataclass(frozen=True)
class SoftStart:
    """Where the light of a soft falloff starts to be scattered.

    radius: of the lamp, in edges of the cube. around: the mean density within it. depths: of `start_depths` there. On a
    ray they are in proportion to the density on its first radii.
    """

    radius: float
    around: float
    depths: np.ndarray


@dataclass(frozen=True)
class NearLamp:
    """A lamp of power 1 near a volume, times a factor.

    emitters: its parts, in the world. place: (3,), in the cube's frame. start: of a soft falloff, or None.
    """

    emitters: Sequence[Emitter]
    power: float
    place: np.ndarray
    start: SoftStart | None = None


@dataclass(frozen=True)
class NearbyTransport:
    """The transport of lamps for one albedo.

    cells: `moment_lattice` of `nearby_light` over a factor, and the factor: of each lamp of power 1, or where light
    scatters evenly of all of them together. together: of several lamps, the first four values of all their light.
    """

    cells: Sequence[tuple[np.ndarray, float]]
    together: np.ndarray | None = None


@dataclass(frozen=True)
class NearbyPoints:
    """N points of rays near lamps.

    world, positions: float64 (N, 3), in the world and in the cube's frame. omega: (N, 3), unit vectors along the rays,
    in the cube's frame. depths: float32 (K, N), optical depths towards each lamp, of ray features.
    """

    world: np.ndarray
    positions: np.ndarray
    omega: np.ndarray
    depths: np.ndarray


@dataclass(frozen=True)
class LampNearby:
    """The transport of lamps together, solved for some albedos.

    share: of it in the multiple scattering. lights: of each albedo. lamps: K of them. anisotropy: G of the phase
    function. density: of the cube's cells, a lattice of one value. extent: lower and upper corner (3,) of the volume's
    box in the cube's frame. radius: in the world, within which light that turned by small angles is not told apart.
    """

    share: float
    lights: Mapping[float, NearbyTransport]
    lamps: Sequence[NearLamp]
    anisotropy: float
    density: FluenceLattice
    extent: Bounds
    radius: float

    def radiance(self, albedo: float, points: NearbyPoints) -> np.ndarray:
        """Multiple scattering float32 (N,) at points, without the factor of the local albedo.

        albedo: one of those that it is solved for.
        """
        light, g = self.lights[albedo], self.anisotropy
        if g**2 < MIN_FORWARD:
            [(cells, scale)] = light.cells
            moments = FluenceLattice(cells).values(points.positions) * np.float32(scale)
            scattered = (moments[:, 0] - 3.0 * g * (moments[:, 1:4] * points.omega).sum(axis=1)) / (4.0 * np.pi)
            return np.maximum(scattered, LEAST / (4.0 * np.pi) * moments[:, 0]).astype(np.float32)
        out = np.empty(len(points.positions), np.float32)
        call(
            "scatter_nearby",
            points=len(out),
            positions=np.ascontiguousarray(points.world, np.float64),
            index=_floats(self.density.index(points.positions)),
            omega=_floats(points.omega.T),
            edge=len(self.density.cells),
            density=self.density.cells,
            together=light.together,
            low=np.float64(self.extent[0]),
            high=np.float64(self.extent[1]),
            lamps=len(self.lamps),
            lamp_list=self._described[albedo],
            depths=_floats(points.depths),
            radius=self.radius,
            joined=JOINED / len(self.lamps),
            anisotropy=g,
            reduced=reduced_anisotropy(g),
            albedo=albedo,
            terms=_terms(g),
            weights=WEIGHTS,
            straightest=STRAIGHTEST,
            straightest_peak=STRAIGHTEST_PEAK,
            least=LEAST,
            out=out,
        )
        return out

    @cached_property
    def _described(self) -> dict[float, Any]:
        """The lamps as compiled kernels read them, by albedo."""
        return {
            albedo: array_of([_describe(lamp, *cells) for lamp, cells in zip(self.lamps, light.cells)])
            for albedo, light in self.lights.items()
        }


def _describe(lamp: NearLamp, cells: np.ndarray, scale: float) -> structures.Shared:
    start = lamp.start
    return structures.NearbyLamp(
        emitters=len(lamp.emitters),
        parts=array_of([describe_emitter(emitter) for emitter in lamp.emitters]),
        power=lamp.power,
        place=np.float64(lamp.place),
        cells=cells,
        scale=scale,
        start=None if start is None else _floats(start.depths),
        radius=0.0 if start is None else start.radius,
        around=0.0 if start is None else start.around,
    )


def _floats(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)


def _terms(anisotropy: float) -> int:
    """Number of the terms of Legendre series."""
    return max(min(int(np.log(MIN_TERM) / np.log(anisotropy**2)) + 2, MAX_TERMS), LAST + 1)
