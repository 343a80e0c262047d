# SPDX-License-Identifier: GPL-3.0-or-later
"""The phase functions of Cycles' volume nodes."""

import math

from ...inference.scene.phase_function import PhaseFunction


def phase_function(kind: str, *parameters: float) -> PhaseFunction:
    """The phase function of a node's `phase` and parameters.

    HENYEY_GREENSTEIN: (g). RAYLEIGH: (). DRAINE: (g, alpha). MIE: (diameter in micrometres), Jendersie and d'Eon 2023.
    FOURNIER_FORAND: (relative index of refraction, backscatter fraction).
    """
    if kind == "RAYLEIGH":
        return PhaseFunction(((1.0, "draine", (0.0, 1.0)),))
    if kind == "MIE":
        hg, g, alpha, share = mie_parameters(*parameters)
        return PhaseFunction(((1.0 - share, "henyey_greenstein", (hg,)), (share, "draine", (g, alpha))))
    return PhaseFunction(((1.0, kind.lower(), tuple(parameters)),))


def mie_parameters(diameter: float) -> tuple[float, float, float, float]:
    """(g of Henyey-Greenstein, g and alpha of Draine, Draine's share) fitted to water droplets.

    diameter: micrometres, clamped to the fit's maximum of 50; below 5, its fits for haze. Jendersie and d'Eon, "An
    Approximate Mie Scattering Function for Fog and Cloud Rendering" (SIGGRAPH Talks 2023).
    """
    d = min(max(diameter, 0.01), 50.0)
    if d <= 0.1:
        return 13.8 * d * d, 1.1456 * d * math.sin(9.29044 * d), 250.0, 0.252977 - 312.983 * d**4.3
    log = math.log(d)
    if d < 1.5:
        inner = math.cos(
            1.19692 * math.cos((log - 0.238604) * (log + 1.00667) / (0.507522 - 0.15677 * log))
            + 1.37932 * log
            + 0.0625835
        )
        return (
            0.862 - 0.143 * log * log,
            0.379685 * inner + 0.344213,
            250.0,
            0.146209 * math.cos(3.38707 * log + 2.11193) + 0.316072 + 0.0778917 * log,
        )
    if d < 5.0:
        twice = math.log(log)
        return (
            0.0604931 * twice + 0.940256,
            0.500411 - 0.081287 / (-2.0 * log + math.tan(log) + 1.27551),
            7.30354 * log + 6.31675,
            0.026914 * (log - math.cos(5.68947 * (twice - 0.0292149))) + 0.376475,
        )
    return (
        math.exp(-0.0990567 / (d - 1.67154)),
        math.exp(-2.20679 / (d + 3.91029) - 0.428934),
        math.exp(3.62489 - 8.29288 / (d + 5.52825)),
        math.exp(-0.599085 / (d - 0.641583) - 0.665888),
    )
