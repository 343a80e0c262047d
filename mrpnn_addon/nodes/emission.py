"""Light that volume shaders emit, with Cycles' meaning of each socket.

Measured with Cycles 4.5: emission does not depend on the density, and is radiance for each world unit.
"""

import math

import numpy as np

# Emission strengths, and intensities of blackbodies, up to this are none.
LEAST = 1e-5
# Of Stefan and Boltzmann in W/(m^2 K^4), in Cycles' millionths, as radiance.
STEFAN_BOLTZMANN = 5.670373e-8 * 1e-6 / math.pi
# Beyond these temperatures, in K, the colour stays.
COLDEST, HOTTEST = 800.0, 12000.0
# Red and blue of luminance 1 as polynomials of 1000 K / T, highest power first; within 0.005 and 0.007 of
# what Cycles 4.5 rendered at 45 temperatures. Cold blackbodies have less than no blue: Rec.709 does not hold them.
RED = [-1.09436, 4.913916, -9.117071, 7.504134, 1.766682, 0.627503]
BLUE = [-3.404655, 15.654529, -28.88976, 27.029891, -12.963098, 2.481796]
LUMA = 0.2126, 0.7152, 0.0722


def blackbody_colour(temperature: np.ndarray) -> np.ndarray:
    """Linear Rec.709 (n, 3) of luminance 1 of temperatures (n, 1) in K."""
    inverse = 1000.0 / np.clip(temperature[:, 0], COLDEST, HOTTEST)
    red, blue = np.polyval(RED, inverse), np.polyval(BLUE, inverse)
    green = (1.0 - LUMA[0] * red - LUMA[2] * blue) / LUMA[1]
    return np.stack([red, green, blue], axis=1)


def strength_and_colour(values, node, strength: str, colour: str, groups) -> np.ndarray:
    """(n, 3): the product of two sockets; none where the strength is not above 0."""
    amount = values.number(node, strength, groups)
    if amount.max() <= LEAST and not values.is_linked(node, strength, groups):
        return np.zeros((1, 3))
    return np.where(amount > LEAST, amount * values.colour(node, colour, groups), 0.0)


def blackbody(values, node, groups, attribute: str) -> np.ndarray:
    """(n, 3): emission of Principled Volume as a blackbody.

    attribute: name of the grid that its Temperature is multiplied by, where there is one.
    """
    share = values.number(node, "Blackbody Intensity", groups)
    if share.max() <= LEAST and not values.is_linked(node, "Blackbody Intensity", groups):
        return np.zeros((1, 3))
    temperature = np.maximum(values.number(node, "Temperature", groups), 0.0)
    if attribute and values.points.has(attribute):
        temperature = temperature * np.maximum(values.points.attribute(attribute, node), 0.0)
    intensity = STEFAN_BOLTZMANN * (1.0 - share + share * temperature**4)
    intensity = np.where((share > LEAST) & (intensity > LEAST), intensity, 0.0)
    return intensity * values.colour(node, "Blackbody Tint", groups) * blackbody_colour(temperature)


def reads_temperature(values, node, groups, attribute: str) -> bool:
    """Whether a grid that Principled Volume reads itself drives the temperature of its blackbody."""
    share = values.number(node, "Blackbody Intensity", groups)
    return bool(attribute) and values.points.has(attribute) and (
        share.max() > LEAST or values.is_linked(node, "Blackbody Intensity", groups))
