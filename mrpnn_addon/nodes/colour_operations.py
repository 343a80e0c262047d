# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour models and blending modes, with Cycles' results; colours are (n, 3).

The OpenColorIO configuration or the file chooses the space of scene linear colours: Rec. 709 by default. Cycles
converts blackbodies and the colours of images to it, and a colour's grey is its luminance in it.
"""

import numpy as np
from mathutils import Color

from .math_operations import divide

PRIMARIES = np.eye(3)


def from_rec709(colours: np.ndarray) -> np.ndarray:
    """Scene linear colours (..., 3) of linear Rec. 709 ones."""
    columns = [Color(primary).from_rec709_linear_to_scene_linear() for primary in PRIMARIES]
    return colours @ np.array(columns)


def luminance(colours: np.ndarray) -> np.ndarray:
    """(..., 1) of scene linear colours (..., 3)."""
    return colours @ np.array([[Color(primary).from_scene_linear_to_xyz_d65()[1]] for primary in PRIMARIES])


def to_hsv(rgb: np.ndarray) -> np.ndarray:
    """Hue in [0, 1), saturation and value."""
    most, chroma, hue = _hue(rgb)
    return np.concatenate([hue, divide(chroma, most), most], axis=1)


def from_hsv(hsv: np.ndarray) -> np.ndarray:
    """The colour of a hue, saturation and value."""
    hue, saturation, value = _columns(hsv)
    return value * (1.0 - saturation * (1.0 - _pure(hue - np.floor(hue))))


def to_hsl(rgb: np.ndarray) -> np.ndarray:
    """Hue in [0, 1), saturation and lightness."""
    most, chroma, hue = _hue(rgb)
    least = most - chroma
    total = most + least
    saturation = divide(chroma, np.where(total > 1.0, 2.0 - total, total))
    return np.concatenate([hue, saturation, np.minimum(0.5 * total, 1.0)], axis=1)


def from_hsl(hsl: np.ndarray) -> np.ndarray:
    """The colour of a hue, saturation and lightness."""
    hue, saturation, lightness = _columns(hsl)
    return lightness + (_pure(hue) - 0.5) * (1.0 - np.abs(2.0 * lightness - 1.0)) * saturation


def _columns(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return values[:, :1], values[:, 1:2], values[:, 2:]


def _hue(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Largest component, span of the components and hue, (n, 1) each."""
    red, green, blue = _columns(rgb)
    most = rgb.max(axis=1, keepdims=True)
    chroma = most - rgb.min(axis=1, keepdims=True)
    sixth = np.where(
        red == most,
        divide(green - blue, chroma) % 6.0,
        np.where(green == most, 2.0 + divide(blue - red, chroma), 4.0 + divide(red - green, chroma)),
    )
    return most, chroma, sixth / 6.0


def _pure(hue: np.ndarray) -> np.ndarray:
    """The saturated colour of a hue, in [0, 1]."""
    sixth = 6.0 * hue
    parts = np.abs(sixth - 3.0) - 1.0, 2.0 - np.abs(sixth - 2.0), 2.0 - np.abs(sixth - 4.0)
    return np.clip(np.concatenate(parts, axis=1), 0.0, 1.0)


def _mixed(f: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a + f * (b - a)


def _burn(f: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    shade = 1.0 - f + f * b
    return np.where(shade > 0.0, np.clip(1.0 - divide(1.0 - a, shade), 0.0, 1.0), 0.0)


def _dodge(f: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    rest = 1.0 - f * b
    return np.where(a != 0.0, np.where(rest > 0.0, np.minimum(divide(a, rest), 1.0), 1.0), 0.0)


def _overlay(f: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(a < 0.5, a * (1.0 - f + 2.0 * f * b), 1.0 - (1.0 - f + 2.0 * f * (1.0 - b)) * (1.0 - a))


def _soft_light(f: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    screen = 1.0 - (1.0 - b) * (1.0 - a)
    return _mixed(f, a, (1.0 - a) * b * a + a * screen)


def _hue_of(f: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    first, second = to_hsv(a), to_hsv(b)
    return _where_coloured(second, _mixed(f, a, from_hsv(np.concatenate([second[:, :1], first[:, 1:]], axis=1))), a)


def _colour_of(f: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    first, second = to_hsv(a), to_hsv(b)
    return _where_coloured(second, _mixed(f, a, from_hsv(np.concatenate([second[:, :2], first[:, 2:]], axis=1))), a)


def _saturation_of(f: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    first, second = to_hsv(a), to_hsv(b)
    share = _mixed(f, first[:, 1:2], second[:, 1:2])
    return _where_coloured(first, from_hsv(np.concatenate([first[:, :1], share, first[:, 2:]], axis=1)), a)


def _value_of(f: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    first, second = to_hsv(a), to_hsv(b)
    return from_hsv(np.concatenate([first[:, :2], _mixed(f, first[:, 2:], second[:, 2:])], axis=1))


def _where_coloured(hsv: np.ndarray, changed: np.ndarray, plain: np.ndarray) -> np.ndarray:
    return np.where(hsv[:, 1:2] != 0.0, changed, plain)


# Blending modes by name: of a factor, (n, 1) or (n, 3), and two colours.
BLENDS = {
    "MIX": _mixed,
    "ADD": lambda f, a, b: a + f * b,
    "MULTIPLY": lambda f, a, b: a * (1.0 - f + f * b),
    "SUBTRACT": lambda f, a, b: a - f * b,
    "SCREEN": lambda f, a, b: 1.0 - (1.0 - f + f * (1.0 - b)) * (1.0 - a),
    "DIVIDE": lambda f, a, b: np.where(b != 0.0, (1.0 - f) * a + f * divide(a, b), a),
    "DIFFERENCE": lambda f, a, b: _mixed(f, a, np.abs(a - b)),
    "EXCLUSION": lambda f, a, b: np.maximum(_mixed(f, a, a + b - 2.0 * a * b), 0.0),
    "DARKEN": lambda f, a, b: _mixed(f, a, np.minimum(a, b)),
    "LIGHTEN": lambda f, a, b: _mixed(f, a, np.maximum(a, b)),
    "BURN": _burn,
    "DODGE": _dodge,
    "OVERLAY": _overlay,
    "SOFT_LIGHT": _soft_light,
    "LINEAR_LIGHT": lambda f, a, b: a + f * (2.0 * b - 1.0),
    "HUE": _hue_of,
    "SATURATION": _saturation_of,
    "COLOR": _colour_of,
    "VALUE": _value_of,
}
