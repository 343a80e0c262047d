"""Mean cosines of the phase functions that Cycles' volume nodes offer.

The renderer knows Henyey-Greenstein alone; of another phase function it keeps the mean cosine, on
which multiple scattering depends most.
"""

import math

import numpy as np

from ..inference.scene import ANISOTROPY_MOST

ANGLES = 20000


def mean_cosine(kind: str, *parameters: float) -> float:
    """Mean cosine of a phase function, within [-0.999, 0.999].

    HENYEY_GREENSTEIN: (g). RAYLEIGH: (). DRAINE: (g, alpha), Draine 2003, eq. 6. MIE: (diameter in
    micrometres), Jendersie and d'Eon 2023. FOURNIER_FORAND: (relative index of refraction, fraction
    scattered backwards), Fournier and Jonasz 1999.
    """
    return float(np.clip(MEANS[kind](*parameters), -ANISOTROPY_MOST, ANISOTROPY_MOST))


def draine_mean(g: float, alpha: float) -> float:
    """Mean cosine of (1 - g^2) (1 + alpha u^2) / (1 + g^2 - 2 g u)^1.5, normalised."""
    return g * (1.0 + alpha * (3.0 + 2.0 * g * g) / 5.0) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)


def _mie_mean(diameter: float) -> float:
    hg, draine, alpha, share = mie_parameters(diameter)
    return (1.0 - share) * hg + share * draine_mean(draine, alpha)


def mie_parameters(diameter: float):
    """(g of Henyey-Greenstein, g and alpha of Draine, Draine's share) that fit water droplets.

    Jendersie and d'Eon, "An Approximate Mie Scattering Function for Fog and Cloud Rendering" (SIGGRAPH
    Talks 2023); diameter in micrometres, held within the fit's 5 to 50, below 5 its fits for haze.
    """
    d = min(max(diameter, 0.01), 50.0)
    if d <= 0.1:
        return 13.8 * d * d, 1.1456 * d * math.sin(9.29044 * d), 250.0, 0.252977 - 312.983 * d**4.3
    log = math.log(d)
    if d < 1.5:
        inner = math.cos(1.19692 * math.cos((log - 0.238604) * (log + 1.00667) / (0.507522 - 0.15677 * log))
                         + 1.37932 * log + 0.0625835)
        return (0.862 - 0.143 * log * log, 0.379685 * inner + 0.344213, 250.0,
                0.146209 * math.cos(3.38707 * log + 2.11193) + 0.316072 + 0.0778917 * log)
    if d < 5.0:
        twice = math.log(log)
        return (0.0604931 * twice + 0.940256,
                0.500411 - 0.081287 / (-2.0 * log + math.tan(log) + 1.27551),
                7.30354 * log + 6.31675,
                0.026914 * (log - math.cos(5.68947 * (twice - 0.0292149))) + 0.376475)
    return (math.exp(-0.0990567 / (d - 1.67154)),
            math.exp(-2.20679 / (d + 3.91029) - 0.428934),
            math.exp(3.62489 - 8.29288 / (d + 5.52825)),
            math.exp(-0.599085 / (d - 0.641583) - 0.665888))


def _fournier_forand_mean(index: float, backwards: float) -> float:
    angle = (np.arange(ANGLES) + 0.5) * (np.pi / ANGLES)
    weight = fournier_forand(np.cos(angle), index, backwards) * np.sin(angle)
    return float((weight * np.cos(angle)).sum() / weight.sum())


def fournier_forand(cosine, index: float, backwards: float):
    """Phase function at cosines (n,), up to its normalisation."""
    index, backwards = max(index, 1.01), min(max(backwards, 1e-4), 0.499)
    half = (1.0 - np.asarray(cosine)) / 2.0  # sin^2 of half the angle

    def delta(sine):
        return 4.0 * sine / (3.0 * (index - 1.0) ** 2)

    # The exponent at which the stated share goes backwards.
    v = -np.log1p(2.0 * backwards * (delta(0.5) - 1.0)) / np.log(delta(0.5))
    d, full = delta(half), delta(1.0)
    power = d**v
    main = (v * (1.0 - d) - (1.0 - power) + (d * (1.0 - power) - v * (1.0 - d)) / half) / ((1.0 - d) ** 2 * power)
    rest = (1.0 - full**v) / (4.0 * (full - 1.0) * full**v) * (3.0 * np.asarray(cosine) ** 2 - 1.0)
    return main + rest


MEANS = {
    'HENYEY_GREENSTEIN': lambda g: g,
    'RAYLEIGH': lambda: 0.0,
    'DRAINE': draine_mean,
    'MIE': _mie_mean,
    'FOURNIER_FORAND': _fournier_forand_mean,
}
