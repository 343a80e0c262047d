"""Phase functions of single scattering: Henyey-Greenstein and others, and mixtures of them."""

from dataclasses import dataclass

import numpy as np

ANGLES = 20000
# Of the sine of half the angle, squared: Fournier and Forand's function has no end straight ahead.
LEAST_SINE = 1e-12


def henyey_greenstein(cosine, anisotropy: float):
    """Phase function at the cosine between the directions before and after scattering, 1/sr."""
    g = abs(anisotropy)
    # 1 + g^2 - 2 g cosine, without the cancellation at the peak.
    square = (1.0 - g) ** 2 + 2.0 * g * np.maximum(1.0 - np.copysign(1.0, anisotropy) * cosine, 0.0)
    return (1.0 - g * g) / (4.0 * np.pi * square * np.sqrt(square))


@dataclass(frozen=True)
class PhaseFunction:
    """A mixture of phase functions.

    lobes: (share, name, parameters) of each, name of LOBES; the shares add up to 1.
    """

    lobes: tuple[tuple[float, str, tuple[float, ...]], ...]

    def __call__(self, cosine):
        """Value, 1/sr, at cosines between the directions before and after scattering; its integral is 1."""
        return sum(share * LOBES[name][0](cosine, *parameters) for share, name, parameters in self.lobes)

    def mean_cosine(self) -> float:
        return float(sum(share * LOBES[name][1](*parameters) for share, name, parameters in self.lobes))

    @property
    def is_henyey_greenstein(self) -> bool:
        return len(self.lobes) == 1 and self.lobes[0][1] == "henyey_greenstein"

    @classmethod
    def mixed(cls, shares: dict) -> "PhaseFunction":
        """Of phase functions with amounts above 0, equal lobes put together."""
        total, lobes = sum(shares.values()), {}
        for phase, amount in shares.items():
            for share, *lobe in phase.lobes:
                lobes[tuple(lobe)] = lobes.get(tuple(lobe), 0.0) + share * amount / total
        return cls(tuple((share, *lobe) for lobe, share in lobes.items()))


def draine(cosine, g: float, alpha: float):
    """Draine 2003, eq. 6; Rayleigh's is that of g = 0 and alpha = 1."""
    bend = (1.0 + alpha * np.square(cosine)) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)
    return henyey_greenstein(cosine, g) * bend


def draine_mean(g: float, alpha: float) -> float:
    """Mean cosine of `draine`."""
    return g * (1.0 + alpha * (3.0 + 2.0 * g * g) / 5.0) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)


def fournier_forand(cosine, index: float, backwards: float):
    """Fournier and Jonasz 1999; index: relative index of refraction, backwards: fraction that is scattered backwards."""
    index, backwards = max(index, 1.01), min(max(backwards, 1e-4), 0.499)
    half = np.maximum((1.0 - np.asarray(cosine, np.float64)) / 2.0, LEAST_SINE)

    def delta(sine):
        return 4.0 * sine / (3.0 * (index - 1.0) ** 2)

    # The exponent at which the stated share goes backwards.
    v = -np.log1p(2.0 * backwards * (delta(0.5) - 1.0)) / np.log(delta(0.5))
    d, full = delta(half), delta(1.0)
    # Where d is 1, numerator and denominator are 0.
    d = np.where(np.abs(d - 1.0) < 1e-5, 1.0 + 1e-5, d)
    power = d**v
    main = (v * (1.0 - d) - (1.0 - power) + (d * (1.0 - power) - v * (1.0 - d)) / half) / ((1.0 - d) ** 2 * power)
    rest = (1.0 - full**v) / (4.0 * (full - 1.0) * full**v) * (3.0 * np.square(cosine) - 1.0)
    return (main + rest) / (4.0 * np.pi)


def fournier_forand_mean(index: float, backwards: float) -> float:
    """Mean cosine of `fournier_forand`."""
    angle = (np.arange(ANGLES) + 0.5) * (np.pi / ANGLES)
    weight = fournier_forand(np.cos(angle), index, backwards) * np.sin(angle)
    return float((weight * np.cos(angle)).sum() / weight.sum())


# By name: the function of the cosine and its parameters, and its mean cosine.
LOBES = {
    "henyey_greenstein": (henyey_greenstein, lambda g: g),
    "draine": (draine, draine_mean),
    "fournier_forand": (fournier_forand, fournier_forand_mean),
}
