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

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..grids.sphere_depth import EXCESS_MOST, FIRST_PART, NODES
from ..kernels.library import call
from ..numerics.quadrature import legendre_nodes
from ..numerics.spherical_harmonics import DEGREES
from ..scene.phase_function import reduced_anisotropy
from ..source_terms.forward_peak import MIN_FORWARD
from ..source_terms.lamp_beam import directions_to
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
# Places on the way from a lamp at which matter is read.
PLACES = 4
# Largest mean cosines of light around a direction: that of the transport's moments, measured, and that of the peak's.
STRAIGHTEST, STRAIGHTEST_PEAK = 0.9, 0.999
# Least light that scatters towards the camera, over what would if it did so evenly; measured.
LEAST = 0.05
# Terms of Legendre series are summed down to this one, but no more than so many.
MIN_TERM, MAX_TERMS = 1e-4, 160
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
class Way:
    """The straight ways from a lamp to N points, at some places each.

    parts: (K, N), of the way up to each place, in [0, 1]. matter: (K, N), share of the way's matter that is there.
    """

    parts: np.ndarray
    matter: np.ndarray

    def means(self, anisotropy: float, count: int) -> list[np.ndarray | float]:
        """Means (N,) of the moments G^(l t) over the matter at parts t, of orders l below a count.

        G^l where light scatters backwards.
        """
        if anisotropy < 0.0:
            return [anisotropy**order for order in range(count)]
        step = np.exp(self.parts * np.log(max(anisotropy, 1e-30)))
        depths, moments = [], self.matter
        for _ in range(count):
            depths.append(moments.sum(axis=0))
            moments = moments * step
        return depths


@dataclass(frozen=True)
class LampAtPoints:
    """Unscattered light of a lamp at N points, in the frame of the working cube.

    towards: (N, 3), unit vectors to the lamp. irradiance, depth: (N,), without what lies in between, and its optical
    depth. scattering: (N,), the part of this depth in which it is scattered as on a straight way. way: from the lamp.
    """

    towards: np.ndarray
    irradiance: np.ndarray
    depth: np.ndarray
    scattering: np.ndarray
    way: Way


@dataclass(frozen=True)
class SoftStart:
    """Where the light of a soft falloff starts to be scattered.

    radius: of the lamp, in edges of the cube. around: the mean density within it. depths: of `start_depths` there.
    """

    radius: float
    around: float
    depths: np.ndarray

    def __call__(self, lamp: np.ndarray, points: np.ndarray, density: FluenceLattice) -> np.ndarray:
        """Optical depth (N,) of the ways from a lamp (3,) to points (N, 3); in proportion to the density on them."""
        ways = points - lamp
        distance = np.maximum(np.linalg.norm(ways, axis=1), 1e-30)
        weight = np.minimum(FIRST_PART * self.radius / distance, 1.0)
        places = lamp + ((0.5 + 0.5 * legendre_nodes(2)[0])[:, None, None] * weight[:, None]) * ways
        mean = density.values(places.reshape(-1, 3)).reshape(places.shape[:2]).mean(axis=0)
        node = distance / (distance + self.radius) * (NODES - 1)
        more = np.clip(mean / max(self.around, 1e-30), 0.0, EXCESS_MOST)
        return more * np.interp(node, np.arange(NODES), self.depths)


@dataclass(frozen=True)
class LampNearby:
    """The transport of a lamp of power 1, solved for some albedos.

    share: of it in the multiple scattering. lights: of each albedo, its FluenceLattice over a factor, and the factor.
    anisotropy: G of the phase function. density: of the cube's cells, a lattice of one value. extent: lower and upper
    corner (3,) of the volume's box in the cube's frame. start: of a lamp with a soft falloff, or None.
    """

    share: float
    lights: Mapping[float, tuple[FluenceLattice, float]]
    anisotropy: float
    density: FluenceLattice
    extent: Bounds
    start: SoftStart | None = None

    def lit(self, lamp: np.ndarray, points: np.ndarray, irradiance: np.ndarray, depth: np.ndarray) -> LampAtPoints:
        """The light of a lamp (3,) at points (N, 3); irradiance, depth: (N,), as of LampAtPoints."""
        scattering = depth
        if self.start is not None:
            scattering = np.maximum(depth - self.start(lamp, points, self.density), 0.0)
        return LampAtPoints(directions_to(lamp, points), irradiance, depth, scattering, self.way(lamp, points))

    def way(self, lamp: np.ndarray, points: np.ndarray) -> Way:
        """The ways from a lamp (3,) to points (N, 3), within the volume's box."""
        ways = points - lamp
        slopes = np.where(np.abs(ways) > 1e-12, ways, 1e-12)
        nearer = np.minimum((self.extent[0] - lamp) / slopes, (self.extent[1] - lamp) / slopes)
        start = np.clip(nearer.max(axis=1), 0.0, 1.0)
        parts = start + (1.0 - start) * ((np.arange(PLACES)[:, None] + 0.5) / PLACES)
        places = (lamp + parts[..., None] * ways).reshape(-1, 3)
        # Evenly spread where the cells hold none.
        matter = self.density.values(places).reshape(parts.shape) + np.float32(1e-9)
        return Way(parts, matter / matter.sum(axis=0))

    def radiance(self, albedo: float, positions: np.ndarray, omega: np.ndarray, lamp: LampAtPoints) -> np.ndarray:
        """Multiple scattering float64 (N,) at points, without the factor of the local albedo.

        albedo: one of those that it is solved for. positions, omega: (N, 3), of points and camera rays in the cube's
        frame. lamp: at the points.
        """
        (light, scale), g = self.lights[albedo], self.anisotropy
        if g**2 < MIN_FORWARD:
            moments = light.values(positions) * np.float32(scale)
            scattered = (moments[:, 0] - 3.0 * g * (moments[:, 1:4] * omega).sum(axis=1)) / (4.0 * np.pi)
            return np.maximum(scattered, LEAST / (4.0 * np.pi) * moments[:, 0])
        out = np.empty(len(positions), np.float32)
        call(
            "scatter_nearby",
            points=len(positions),
            index=_floats(light.index(positions)),
            omega=_floats(omega.T),
            towards=_floats(lamp.towards.T),
            irradiance=_floats(lamp.irradiance),
            depth=_floats(lamp.depth),
            scattering=_floats(lamp.scattering),
            places=len(lamp.way.parts),
            parts=_floats(lamp.way.parts),
            matter=_floats(lamp.way.matter),
            cells=_floats(light.cells),
            edge=len(light.cells),
            scale=scale,
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


def _floats(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)


def _terms(anisotropy: float) -> int:
    """Number of the terms of Legendre series."""
    return max(min(int(np.log(MIN_TERM) / np.log(anisotropy**2)) + 2, MAX_TERMS), LAST + 1)
