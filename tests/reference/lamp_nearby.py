# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of a lamp nearby that scatters towards the camera."""

from dataclasses import dataclass

import numpy as np

from inference.grids.sphere_depth import EXCESS_MOST, FIRST_PART, NODES
from inference.network.lamp_nearby import (
    LAST,
    LEAST,
    STRAIGHTEST,
    STRAIGHTEST_PEAK,
    WEIGHTS,
    LampNearby,
    NearbyPoints,
    NearLamp,
    _terms,
)
from inference.numerics.quadrature import legendre_nodes
from inference.numerics.small_matmul import lengths, product
from inference.numerics.spherical_harmonics import spherical_harmonics
from inference.scene.phase_function import henyey_greenstein, reduced_anisotropy
from inference.transport.scattered_fluence import FluenceLattice

# Places on the way from a lamp.
PLACES = 4
# The first harmonic of each degree.
FIRST = np.arange(LAST + 1) ** 2


@dataclass(frozen=True)
class Ways:
    """The straight ways from a lamp to N points, at some places each.

    parts: (K, N), of the way up to each place, in [0, 1]. matter: (K, N), share of the way's matter that is there.
    """

    parts: np.ndarray
    matter: np.ndarray

    def means(self, anisotropy: float, count: int) -> list[np.ndarray]:
        """Means (N,) of the moments G^(l t) over the matter at parts t, of orders l below a count."""
        return [(self.matter * anisotropy ** (order * self.parts)).sum(axis=0) for order in range(count)]


@dataclass(frozen=True)
class LampAtPoints:
    """Unscattered light of a lamp at N points, in the frame of the working cube.

    towards: (N, 3), unit vectors to the lamp. irradiance, depth: (N,), without what lies in between, and its optical
    depth. scattering: (N,), the part of this depth in which it is scattered as on a straight way. ways: from the lamp.
    """

    towards: np.ndarray
    irradiance: np.ndarray
    depth: np.ndarray
    scattering: np.ndarray
    ways: Ways


def ways_to(nearby: LampNearby, lamp: np.ndarray, points: np.ndarray) -> Ways:
    """The ways from a lamp (3,) to points (N, 3), within the volume's box."""
    away = points - lamp
    slopes = np.where(np.abs(away) > 1e-12, away, 1e-12)
    nearer = np.minimum((nearby.extent[0] - lamp) / slopes, (nearby.extent[1] - lamp) / slopes)
    start = np.clip(nearer.max(axis=1), 0.0, 1.0)
    parts = start + (1.0 - start) * ((np.arange(PLACES)[:, None] + 0.5) / PLACES)
    matter = nearby.density.values((lamp + parts[..., None] * away).reshape(-1, 3)).reshape(parts.shape) + 1e-9
    return Ways(parts, matter / matter.sum(axis=0))


def at_points(nearby: LampNearby, lamp: NearLamp, points: NearbyPoints, depth: np.ndarray) -> LampAtPoints:
    """The light of a lamp behind optical depths (N,)."""
    fluence = np.sum([emitter.fluence(points.world) for emitter in lamp.emitters], axis=0)
    least = 0.25 * np.sum([emitter.brightest(points.world) for emitter in lamp.emitters], axis=0)
    depth = np.maximum(depth + np.log(np.clip(fluence / np.maximum(least, 1e-30), 1e-30, 1.0)), 0.0)
    irradiance = fluence / (1.0 + fluence * (4.0 * np.pi * nearby.radius**2))
    away, scattering = lamp.place - points.positions, depth
    if lamp.start is not None:
        scattering = np.maximum(depth - _soft_start(nearby, lamp, points.positions), 0.0)
    ways = ways_to(nearby, lamp.place, points.positions)
    return LampAtPoints(away / lengths(away)[:, None], lamp.power * irradiance, depth, scattering, ways)


def _soft_start(nearby: LampNearby, lamp: NearLamp, positions: np.ndarray) -> np.ndarray:
    """Optical depth (N,) from a lamp at which its light starts to be scattered."""
    start, away = lamp.start, positions - lamp.place
    distance = lengths(away)
    weight = np.minimum(FIRST_PART * start.radius / distance, 1.0)
    places = lamp.place + ((0.5 + 0.5 * legendre_nodes(2)[0])[:, None, None] * weight[:, None]) * away
    mean = nearby.density.values(places.reshape(-1, 3)).reshape(places.shape[:2]).mean(axis=0)
    node = distance / (distance + start.radius) * (NODES - 1)
    more = np.clip(mean / max(start.around, 1e-30), 0.0, EXCESS_MOST)
    return more * np.interp(node, np.arange(NODES), start.depths)


def radiance(nearby: LampNearby, albedo: float, points: NearbyPoints) -> np.ndarray:
    """As `LampNearby.radiance`, where each lamp is told apart, of light that scatters forwards or backwards."""
    light, g, count = nearby.lights[albedo], nearby.anisotropy, (LAST + 1) ** 2
    rest, found = np.zeros((len(points.world), count)), np.zeros(len(points.world))
    if light.together is not None:
        rest[:, :4] = FluenceLattice(light.together).values(points.positions)
    for lamp, (cells, scale), depth in zip(nearby.lamps, light.cells, points.depths):
        values = FluenceLattice(cells).values(points.positions) * (lamp.power * scale)
        own = _scattered_wide(values[:, :count], points.omega, g)
        # Light that scatters backwards has no peak.
        if g > 0.0:
            seen = at_points(nearby, lamp, points, depth)
            own += _scattered_narrow(values[:, count], values[:, count + 1 :], points.omega, seen, g, albedo)
        found += np.maximum(own, LEAST / (4.0 * np.pi) * values[:, 0])
        rest[:, :4] -= values[:, :4]
    return found if light.together is None else found + np.maximum(_scattered_wide(rest, points.omega, g), 0.0)


def _scattered_wide(moments: np.ndarray, omega: np.ndarray, anisotropy: float) -> np.ndarray:
    """Of the light that the transport's moments (N, 16) tell."""
    g, flux = anisotropy, moments[:, 1:4]
    middle = flux / np.maximum(lengths(flux), 1e-30)[:, None]
    inside = _along(moments, middle)
    whole, mean = np.maximum(inside[:, 0], 0.0), np.maximum(inside[:, 1], 0.0)
    straightness = (inside[:, 2] / np.maximum(mean, 1e-30)).clip(0.0, STRAIGHTEST)
    amount = np.minimum(mean / np.maximum(straightness, 1e-6), whole)
    turn = -(middle * omega).sum(axis=1)
    differs = _along(moments, -omega)
    differs -= (amount[:, None] * straightness[:, None] ** np.arange(LAST + 1)) * _legendre(turn)
    # Of degree 0, what is not of that distribution.
    found = product(differs, WEIGHTS * g ** np.arange(LAST + 1))
    return found + amount * henyey_greenstein(turn, g * straightness)


def _scattered_narrow(
    fluence: np.ndarray, flux: np.ndarray, omega: np.ndarray, lamp: LampAtPoints, anisotropy: float, albedo: float
) -> np.ndarray:
    """Of light that has scattered within the peak alone, of a fluence (N,) and a flux (N, 3)."""
    cosine = (omega * lamp.towards).sum(axis=1)
    ahead = np.maximum(cosine, 0.0)
    straight = straight_light(lamp, anisotropy, albedo)
    first = straight[1]
    known = np.divide(-(flux * lamp.towards).sum(axis=1), first, out=np.ones(len(first)), where=np.abs(first) > 1e-30)
    known = known.clip(0.0, 1.0)
    rest = flux + (known * first)[:, None] * lamp.towards
    found = (1.0 - ahead) * _lobe(fluence, flux, omega, anisotropy)
    found += ahead * _lobe(fluence - known * straight[0], rest, omega, anisotropy)
    # Legendre's polynomials by their recurrence.
    before, here = np.zeros(len(cosine)), np.ones(len(cosine))
    for order, light in enumerate(straight):
        found += (2 * order + 1) / (4.0 * np.pi) * anisotropy**order * ahead * known * light * here
        before, here = here, ((2 * order + 1) * cosine * here - order * before) / (order + 1)
    return found


def straight_light(lamp: LampAtPoints, anisotropy: float, albedo: float) -> list[np.ndarray]:
    """Legendre moments (N,) around the way from the lamp of light that has turned within the peak alone, by degree."""
    count, unscattered = _terms(anisotropy), np.exp(-lamp.depth)
    means, less = lamp.ways.means(anisotropy, count), lamp.ways.means(reduced_anisotropy(anisotropy), count)
    wide = 1.0 - anisotropy**2
    return [
        lamp.irradiance * (np.exp(albedo * (mean - wide * part) * lamp.scattering - lamp.depth) - unscattered)
        for mean, part in zip(means, less)
    ]


def _lobe(fluence: np.ndarray, flux: np.ndarray, omega: np.ndarray, anisotropy: float) -> np.ndarray:
    """What scatters towards the camera (N,) of light around the direction of its flux (N, 3)."""
    fluence, size = np.maximum(fluence, 0.0), lengths(flux)
    straightness = np.minimum(size / np.maximum(fluence, 1e-30), STRAIGHTEST_PEAK)
    turn = -(flux * omega).sum(axis=1) / np.maximum(size, 1e-30)
    return fluence * henyey_greenstein(turn, anisotropy * straightness)


def _along(moments: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Moments (N, LAST + 1) by Legendre's polynomials along directions (N, 3), of those by spherical harmonics."""
    return np.add.reduceat(moments * spherical_harmonics(directions).T, FIRST, axis=1)


def _legendre(cosine: np.ndarray) -> np.ndarray:
    """Legendre's polynomials (N, LAST + 1) of cosines (N,)."""
    square = cosine * cosine
    return np.stack([np.ones_like(cosine), cosine, 1.5 * square - 0.5, cosine * (2.5 * square - 1.5)], axis=1)
