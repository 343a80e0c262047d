# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of a lamp nearby that scatters towards the camera."""

import numpy as np

from inference.network.lamp_nearby import (
    LAST,
    LEAST,
    STRAIGHTEST,
    STRAIGHTEST_PEAK,
    WEIGHTS,
    LampAtPoints,
    LampNearby,
    _terms,
)
from inference.numerics.small_matmul import lengths, product
from inference.numerics.spherical_harmonics import spherical_harmonics
from inference.scene.phase_function import henyey_greenstein, reduced_anisotropy

# The first harmonic of each degree.
FIRST = np.arange(LAST + 1) ** 2


def radiance(
    nearby: LampNearby, albedo: float, positions: np.ndarray, omega: np.ndarray, lamp: LampAtPoints
) -> np.ndarray:
    """As `LampNearby.radiance`, of light that scatters forwards or backwards."""
    light, scale = nearby.lights[albedo]
    moments = light.values(positions) * np.float32(scale)
    found = _scattered(moments, omega, lamp, nearby.anisotropy, albedo)
    return np.maximum(found, LEAST / (4.0 * np.pi) * moments[:, 0])


def _scattered(
    moments: np.ndarray, omega: np.ndarray, lamp: LampAtPoints, anisotropy: float, albedo: float
) -> np.ndarray:
    """Light (N,), W/(m^2 sr), that scatters towards the camera, of the lamp and of the transport's moments (N, 20).

    omega: (N, 3), along camera rays.
    """
    count = (LAST + 1) ** 2
    found = _scattered_wide(moments[:, :count], omega, anisotropy)
    # Light that scatters backwards has no peak.
    if anisotropy > 0.0:
        found += _scattered_narrow(moments[:, count], moments[:, count + 1 :], omega, lamp, anisotropy, albedo)
    return found


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
    means, less = lamp.way.means(anisotropy, count), lamp.way.means(reduced_anisotropy(anisotropy), count)
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
