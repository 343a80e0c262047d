# SPDX-License-Identifier: GPL-3.0-or-later
"""The operations of the Math and Vector Math nodes, with Cycles' results where the mathematical result is undefined."""

from collections.abc import Callable
from typing import Any

import numpy as np


def divide(a: Any, b: Any) -> Any:
    """a / b, 0 where b is 0."""
    return np.where(b != 0.0, a / np.where(b != 0.0, b, 1.0), 0.0)


def clamp(value: Any, low: Any, high: Any) -> Any:
    return np.minimum(np.maximum(value, low), high)


def smoothstep(value: np.ndarray, low: np.ndarray, high: np.ndarray, smoother: bool = False) -> np.ndarray:
    """Hermite step from 0 at `low` to 1 at `high`; `smoother` with a continuous second derivative."""
    x = clamp(divide(value - low, high - low), 0.0, 1.0)
    return x**3 * (x * (x * 6.0 - 15.0) + 10.0) if smoother else x * x * (3.0 - 2.0 * x)


def _power(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where((a < 0.0) & (b != np.floor(b)), 0.0, np.nan_to_num(np.power(a, b), posinf=0.0, neginf=0.0))


def _logarithm(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    valid = (a > 0.0) & (b > 0.0)
    return np.where(valid, divide(np.log(np.where(valid, a, 1.0)), np.log(np.where(valid, b, 1.0))), 0.0)


def _smooth_minimum(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    near = divide(np.maximum(c - np.abs(a - b), 0.0), c)
    return np.minimum(a, b) - near**3 * c / 6.0


def _wrap(value: np.ndarray, high: np.ndarray, low: np.ndarray) -> np.ndarray:
    return np.where(high != low, value - (high - low) * np.floor(divide(value - low, high - low)), low)


def _ping_pong(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs((divide(a - b, 2.0 * b) % 1.0) * b * 2.0 - b) * (b != 0.0)


def _truncated_modulo(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(b != 0.0, np.fmod(a, np.where(b != 0.0, b, 1.0)), 0.0)


MATH: dict[str, Callable[..., np.ndarray]] = {
    "ADD": lambda a, b, c: a + b,
    "SUBTRACT": lambda a, b, c: a - b,
    "MULTIPLY": lambda a, b, c: a * b,
    "DIVIDE": lambda a, b, c: divide(a, b),
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "POWER": lambda a, b, c: _power(a, b),
    "LOGARITHM": lambda a, b, c: _logarithm(a, b),
    "SQRT": lambda a, b, c: np.sqrt(np.maximum(a, 0.0)),
    "INVERSE_SQRT": lambda a, b, c: np.where(a > 0.0, 1.0 / np.sqrt(np.where(a > 0.0, a, 1.0)), 0.0),
    "ABSOLUTE": lambda a, b, c: np.abs(a),
    "EXPONENT": lambda a, b, c: np.exp(a),
    "MINIMUM": lambda a, b, c: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c: np.maximum(a, b),
    "LESS_THAN": lambda a, b, c: (a < b) * 1.0,
    "GREATER_THAN": lambda a, b, c: (a > b) * 1.0,
    "SIGN": lambda a, b, c: np.sign(a),
    "COMPARE": lambda a, b, c: (np.abs(a - b) <= np.maximum(c, 1.1920929e-7)) * 1.0,
    "SMOOTH_MIN": _smooth_minimum,
    "SMOOTH_MAX": lambda a, b, c: -_smooth_minimum(-a, -b, c),
    "ROUND": lambda a, b, c: np.floor(a + 0.5),
    "FLOOR": lambda a, b, c: np.floor(a),
    "CEIL": lambda a, b, c: np.ceil(a),
    "TRUNC": lambda a, b, c: np.trunc(a),
    "FRACT": lambda a, b, c: a - np.floor(a),
    "MODULO": lambda a, b, c: _truncated_modulo(a, b),
    "FLOORED_MODULO": lambda a, b, c: np.where(b != 0.0, a - np.floor(divide(a, b)) * b, 0.0),
    "WRAP": _wrap,
    "SNAP": lambda a, b, c: np.floor(divide(a, b)) * b,
    "PINGPONG": lambda a, b, c: _ping_pong(a, b),
    "SINE": lambda a, b, c: np.sin(a),
    "COSINE": lambda a, b, c: np.cos(a),
    "TANGENT": lambda a, b, c: np.tan(a),
    "ARCSINE": lambda a, b, c: np.arcsin(clamp(a, -1.0, 1.0)),
    "ARCCOSINE": lambda a, b, c: np.arccos(clamp(a, -1.0, 1.0)),
    "ARCTANGENT": lambda a, b, c: np.arctan(a),
    "ARCTAN2": lambda a, b, c: np.arctan2(a, b),
    "SINH": lambda a, b, c: np.sinh(a),
    "COSH": lambda a, b, c: np.cosh(a),
    "TANH": lambda a, b, c: np.tanh(a),
    "RADIANS": lambda a, b, c: np.radians(a),
    "DEGREES": lambda a, b, c: np.degrees(a),
}


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=1, keepdims=True)


def _length(a: np.ndarray) -> np.ndarray:
    return np.sqrt(_dot(a, a))


def _normalized(a: np.ndarray) -> np.ndarray:
    return divide(a, _length(a))


def _refract(a: np.ndarray, b: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    normal = _normalized(b)
    cosine = _dot(normal, a)
    under = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    return np.where(under >= 0.0, ratio * a - (ratio * cosine + np.sqrt(np.maximum(under, 0.0))) * normal, 0.0)


def euler_matrices(angles: np.ndarray) -> np.ndarray:
    """Rotations (n, 3, 3) of XYZ Euler angles (n, 3)."""
    found = np.eye(3)
    for axis, angle in enumerate(angles.T):
        turn = np.zeros((len(angles), 3, 3))
        one, two = (axis + 1) % 3, (axis + 2) % 3
        turn[:, axis, axis] = 1.0
        turn[:, one, one] = turn[:, two, two] = np.cos(angle)
        turn[:, two, one] = np.sin(angle)
        turn[:, one, two] = -turn[:, two, one]
        found = turn @ found
    return found


def rotated(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) turned by matrices (n, 3, 3); one of either serves all of the other."""
    return (matrices @ vectors[:, :, None])[:, :, 0]


def about_axis(vectors: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) turned about axes (n, 3) by angles (n, 1); unchanged where an axis is 0."""
    unit = _normalized(axis)
    cosine = np.cos(angle)
    turned = vectors * cosine + np.cross(unit, vectors) * np.sin(angle) + unit * _dot(unit, vectors) * (1.0 - cosine)
    return np.where(_dot(axis, axis) > 0.0, turned, vectors)


# Operations on vectors a, b, c (n, 3) and a number s (n, 1).
VECTOR_MATH: dict[str, Callable[..., np.ndarray]] = {
    "ADD": lambda a, b, c, s: a + b,
    "SUBTRACT": lambda a, b, c, s: a - b,
    "MULTIPLY": lambda a, b, c, s: a * b,
    "DIVIDE": lambda a, b, c, s: divide(a, b),
    "MULTIPLY_ADD": lambda a, b, c, s: a * b + c,
    "CROSS_PRODUCT": lambda a, b, c, s: np.cross(a, b),
    "PROJECT": lambda a, b, c, s: divide(_dot(a, b), _dot(b, b)) * b,
    "REFLECT": lambda a, b, c, s: a - 2.0 * _dot(a, _normalized(b)) * _normalized(b),
    "REFRACT": lambda a, b, c, s: _refract(a, b, s),
    "FACEFORWARD": lambda a, b, c, s: np.where(_dot(c, b) < 0.0, a, -a),
    "DOT_PRODUCT": lambda a, b, c, s: _dot(a, b),
    "DISTANCE": lambda a, b, c, s: _length(a - b),
    "LENGTH": lambda a, b, c, s: _length(a),
    "SCALE": lambda a, b, c, s: a * s,
    "NORMALIZE": lambda a, b, c, s: _normalized(a),
    "ABSOLUTE": lambda a, b, c, s: np.abs(a),
    "SIGN": lambda a, b, c, s: np.sign(a),
    "MINIMUM": lambda a, b, c, s: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c, s: np.maximum(a, b),
    "FLOOR": lambda a, b, c, s: np.floor(a),
    "CEIL": lambda a, b, c, s: np.ceil(a),
    "FRACTION": lambda a, b, c, s: a - np.floor(a),
    "MODULO": lambda a, b, c, s: _truncated_modulo(a, b),
    "POWER": lambda a, b, c, s: _power(a, b),
    "WRAP": lambda a, b, c, s: _wrap(a, b, c),
    "SNAP": lambda a, b, c, s: np.floor(divide(a, b)) * b,
    "SINE": lambda a, b, c, s: np.sin(a),
    "COSINE": lambda a, b, c, s: np.cos(a),
    "TANGENT": lambda a, b, c, s: np.tan(a),
}
