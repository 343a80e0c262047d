# SPDX-License-Identifier: GPL-3.0-or-later
"""Emission of volume shaders, with Cycles' meaning of each socket.

Measured in Cycles 4.5: emission is radiance per world unit and does not depend on density.
"""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from .colour_operations import from_rec709
from .sockets import Groups, Node

if TYPE_CHECKING:
    from .evaluation import NodeEvaluator

# Emission strengths and blackbody intensities up to this count as 0.
NEGLIGIBLE = 1e-5
# Stefan-Boltzmann constant, W/(m^2 K^4), as radiance and scaled by 1e-6 as in Cycles.
STEFAN_BOLTZMANN = 5.670373e-8 * 1e-6 / math.pi
# Temperatures, in K, beyond which the colour is constant.
COLDEST, HOTTEST = 800.0, 12000.0
# Red and blue at luminance 1 as polynomials of 1000 K / T, highest power first; within 0.005 and 0.007 of Cycles 4.5 at
# 45 temperatures. The blue of cold blackbodies is negative: they lie outside Rec.709.
RED = [-1.09436, 4.913916, -9.117071, 7.504134, 1.766682, 0.627503]
BLUE = [-3.404655, 15.654529, -28.88976, 27.029891, -12.963098, 2.481796]
LUMA = 0.2126, 0.7152, 0.0722


def blackbody_colour(temperature: np.ndarray) -> np.ndarray:
    """Scene linear colours (n, 3) of luminance 1 for temperatures (n, 1) in K."""
    inverse = 1000.0 / np.clip(temperature[:, 0], COLDEST, HOTTEST)
    red, blue = np.polyval(RED, inverse), np.polyval(BLUE, inverse)
    green = (1.0 - LUMA[0] * red - LUMA[2] * blue) / LUMA[1]
    return from_rec709(np.stack([red, green, blue], axis=1))


def strength_and_colour(values: "NodeEvaluator", node: Node, strength: str, colour: str, groups: Groups) -> np.ndarray:
    """(n, 3) product of two sockets; 0 where the strength is not positive."""
    amount = values.number(node, strength, groups)
    if amount.max() <= NEGLIGIBLE and not values.is_linked(node, strength, groups):
        return np.zeros((1, 3))
    return np.where(amount > NEGLIGIBLE, amount * values.colour(node, colour, groups), 0.0)


def blackbody(values: "NodeEvaluator", node: Node, groups: Groups, attribute: str) -> np.ndarray:
    """(n, 3) blackbody emission of Principled Volume.

    attribute: name of the grid that scales its Temperature, if it exists.
    """
    share = values.number(node, "Blackbody Intensity", groups)
    if share.max() <= NEGLIGIBLE and not values.is_linked(node, "Blackbody Intensity", groups):
        return np.zeros((1, 3))
    temperature = np.maximum(values.number(node, "Temperature", groups), 0.0)
    points: Any = values.points
    if attribute and points.has(attribute):
        found = points.attribute(attribute, node).mean(axis=1, keepdims=True)
        temperature = temperature * np.maximum(found, 0.0)
    intensity = STEFAN_BOLTZMANN * (1.0 - share + share * temperature**4)
    intensity = np.where((share > NEGLIGIBLE) & (intensity > NEGLIGIBLE), intensity, 0.0)
    return intensity * values.colour(node, "Blackbody Tint", groups) * blackbody_colour(temperature)


def reads_temperature(values: "NodeEvaluator", node: Node, groups: Groups, attribute: str) -> bool:
    """Whether a grid that Principled Volume reads itself drives its blackbody's temperature."""
    share = values.number(node, "Blackbody Intensity", groups)
    points: Any = values.points
    return (
        bool(attribute)
        and points.has(attribute)
        and (share.max() > NEGLIGIBLE or values.is_linked(node, "Blackbody Intensity", groups))
    )
