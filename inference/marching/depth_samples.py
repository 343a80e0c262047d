"""Depths along camera rays at which multiple scattering is wanted.

Multiple scattering is smooth along a ray. Its integral over the ray's opacity is Gauss's: n depths give what a
polynomial of degree 2n - 1 has, where as many even strata give no more than a straight line.
"""

import functools
from dataclasses import dataclass

import numpy as np

from ..numerics.small_matmul import product
from .ray_features import RayFeatures

# Rays fainter than this are not sampled in depth.
FAINTEST_ALPHA = 1e-4
# Numbers of samples above this are multiples of it.
MANY = 16
# What is left of the noise of samples in a row that are looked up at a lattice's places; measured.
CANCELLED = 0.5


@functools.lru_cache(maxsize=256)
def gauss_legendre(count: int):
    """Gauss's places in (0, 1) and their weights, which sum to 1: float64 (count,) each."""
    places, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 + 0.5 * places, 0.5 * weights


def sample_counts(alpha: np.ndarray, most: int, thin_faint: bool = True) -> np.ndarray:
    """int (R,) depths of each ray: `most` where it is opaque, fewer where its error shows less if `thin_faint`."""
    if not thin_faint:
        return np.where(alpha > 0.0, most, 0)
    counts = np.ceil(most * np.sqrt(alpha)).astype(int)
    # Many need not be told apart, and their places take time to find.
    counts = np.where(counts > MANY, -(-counts // MANY) * MANY, counts)
    # One would not tell its error.
    return np.where(alpha > FAINTEST_ALPHA, np.clip(counts, min(2, most), most), 0)


def sample_opacities(alpha: np.ndarray, most: int, thin_faint: bool = True):
    """Where on rays to sample: their ray int (M,), opacity from the ray's start (M,), and weight (M,).

    alpha: (R,), each ray's whole opacity; its samples' weights sum to it.
    """
    counts = sample_counts(alpha, most, thin_faint)
    ray = np.repeat(np.arange(len(alpha)), counts)
    number = np.arange(len(ray)) - np.repeat(np.cumsum(counts) - counts, counts)
    places, weights = np.zeros((2, most + 1, most))
    for count in np.unique(counts[counts > 0]):
        places[count, :count], weights[count, :count] = gauss_legendre(count)
    count = counts[ray]
    return ray, places[count, number] * alpha[ray], weights[count, number] * alpha[ray]


@dataclass
class DepthSamples:
    """Points along camera rays, ray after ray.

    pixel: int (P,), of each ray, ascending; origins, directions: float64 (P, 3); offsets: (P,) in [0, 1), of lookups.
    ray: int32 (M,), ascending; distance, weight: (M,); fraction: float32 (M, V), each volume's share of
    the extinction. features: for networks that need them, or None.
    """

    pixel: np.ndarray
    origins: np.ndarray
    directions: np.ndarray
    offsets: np.ndarray
    ray: np.ndarray
    distance: np.ndarray
    weight: np.ndarray
    fraction: np.ndarray
    features: RayFeatures | None = None

    def __post_init__(self):
        starts = np.flatnonzero(np.diff(self.ray, prepend=-1))
        counts = np.diff(starts, append=len(self.ray))
        #: int32 (M,), of each sample on its ray.
        self.number = (np.arange(len(self.ray)) - np.repeat(starts, counts)).astype(np.int32)
        self.starts, self.counts = starts, counts

    def positions(self, samples) -> np.ndarray:
        """World positions (N, 3) of some samples."""
        ray = self.ray[samples]
        return self.origins[ray] + self.distance[samples, None] * self.directions[ray]

    def jitter(self, samples) -> np.ndarray:
        """(N, 3) in [-1/2, 1/2): along a ray a rank-1 lattice in three dimensions, shifted by pixel."""
        along = self.number[samples, None] * [0.8191725133961645, 0.6710436067037893, 0.5497004779019703]
        # Large odd factors turn a pixel's offset into three that have nothing in common.
        along += self.offsets[self.ray[samples], None] * [1571.0, 5717.0, 9371.0]
        return along - np.floor(along) - 0.5

    def standard_error(self, parts: np.ndarray):
        """Of the sums over each sampled ray of weighted values (M,): the rays' pixels (S,), and the errors (S,).

        What the upper quarter of the polynomials hold that values at Gauss's places determine: what is smooth is small
        there, and noise would be as large in each of them as in the mean, if the lookups' lattice along the ray
        did not let some of it cancel. One sample tells nothing: then the sum itself.
        """
        errors = np.zeros(len(self.starts))
        for count in np.unique(self.counts):
            rays = np.flatnonzero(self.counts == count)
            samples = self.starts[rays, None] + np.arange(count)
            errors[rays] = _upper_quarter(parts[samples], count)
        return self.pixel[self.ray[self.starts]], errors


def _upper_quarter(parts, count: int):
    """CANCELLED times the root mean square of the last Legendre coefficients, normalised, of values (R, count)."""
    if count == 1:
        return np.abs(parts[:, 0])
    degrees = np.arange(max(3 * count // 4, 1), count)
    basis = np.polynomial.legendre.legvander(2.0 * gauss_legendre(count)[0] - 1.0, count - 1)[:, degrees]
    return CANCELLED * np.sqrt((product(parts, basis * np.sqrt(2 * degrees + 1.0)) ** 2).mean(axis=1))
