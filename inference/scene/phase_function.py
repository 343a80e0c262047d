# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase functions of single scattering: Henyey-Greenstein and others, and mixtures of them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

# Angles at which mean cosines without a closed form are integrated numerically.
ANGLES = 20000
# Lower bound of sin^2(theta / 2): the Fournier-Forand function diverges straight ahead.
MIN_SINE = 1e-12

# A cosine, or an array of them.
Cosine = Any


def henyey_greenstein(cosine: Cosine, anisotropy: float) -> Cosine:
    """Henyey-Greenstein phase function, 1/sr.

    cosine: between the directions of light before and after scattering, so that 1 is straight ahead.
    """
    g = abs(anisotropy)
    # 1 + g^2 - 2 g cosine, without the cancellation at the peak.
    square = (1.0 - g) ** 2 + 2.0 * g * np.maximum(1.0 - np.copysign(1.0, anisotropy) * cosine, 0.0)
    return (1.0 - g * g) / (4.0 * np.pi * square * np.sqrt(square))


def reduced_anisotropy(anisotropy: Any) -> Any:
    """G', the mean cosine of Henyey and Greenstein's phase function without its forward peak (Wiscombe 1977)."""
    return anisotropy / (1.0 + anisotropy)


@dataclass(frozen=True)
class PhaseFunction:
    """A mixture of phase functions.

    lobes: (weight, name, parameters) of each, where name is a key of LOBES; the weights sum to 1.
    """

    lobes: tuple[tuple[float, str, tuple[float, ...]], ...]

    def __call__(self, cosine: Cosine) -> Cosine:
        """Value in 1/sr at cosines between the directions before and after scattering; it integrates to 1."""
        return sum(weight * LOBES[name][0](cosine, *parameters) for weight, name, parameters in self.lobes)

    def mean_cosine(self) -> float:
        """Mean cosine of the scattering angle, the anisotropy."""
        return float(sum(weight * LOBES[name][1](*parameters) for weight, name, parameters in self.lobes))

    @property
    def is_henyey_greenstein(self) -> bool:
        """Whether this is a single Henyey-Greenstein lobe."""
        return len(self.lobes) == 1 and self.lobes[0][1] == "henyey_greenstein"

    @classmethod
    def mixed(cls, amounts: "dict[PhaseFunction, float]") -> "PhaseFunction":
        """Mixture of phase functions with amounts above 0, which need not sum to 1; equal lobes are merged."""
        total = sum(amounts.values())
        lobes: dict[tuple[str, tuple[float, ...]], float] = {}
        for phase, amount in amounts.items():
            for weight, name, parameters in phase.lobes:
                lobes[name, parameters] = lobes.get((name, parameters), 0.0) + weight * amount / total
        return cls(tuple((weight, name, parameters) for (name, parameters), weight in lobes.items()))


def draine(cosine: Cosine, g: float, alpha: float) -> Cosine:
    """Draine 2003, eq. 6, 1/sr; g = 0 and alpha = 1 give Rayleigh's phase function."""
    bend = (1.0 + alpha * np.square(cosine)) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)
    return henyey_greenstein(cosine, g) * bend


def draine_mean(g: float, alpha: float) -> float:
    """Mean cosine of `draine`."""
    return g * (1.0 + alpha * (3.0 + 2.0 * g * g) / 5.0) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)


def fournier_forand(cosine: Cosine, index: float, backwards: float) -> Cosine:
    """Fournier and Forand's phase function in the form of Fournier and Jonasz 1999, 1/sr.

    index: relative index of refraction; backwards: fraction of the light that is scattered backwards.
    """
    index, backwards = max(index, 1.01), min(max(backwards, 1e-4), 0.499)
    half = np.maximum((1.0 - np.asarray(cosine, np.float64)) / 2.0, MIN_SINE)

    def delta(sine: Any) -> Any:
        return 4.0 * sine / (3.0 * (index - 1.0) ** 2)

    # The exponent for which the given fraction goes backwards.
    v = -np.log1p(2.0 * backwards * (delta(0.5) - 1.0)) / np.log(delta(0.5))
    d, full = delta(half), delta(1.0)
    # Numerator and denominator vanish at d = 1.
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


# By name: the phase function, of the cosine and its parameters, and its mean cosine, of its parameters.
LOBES: dict[str, tuple[Callable[..., Any], Callable[..., float]]] = {
    "henyey_greenstein": (henyey_greenstein, lambda g: g),
    "draine": (draine, draine_mean),
    "fournier_forand": (fournier_forand, fournier_forand_mean),
}
