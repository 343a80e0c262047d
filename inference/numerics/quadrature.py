# SPDX-License-Identifier: GPL-3.0-or-later
"""Gauss-Legendre quadrature, integrals of Legendre polynomials, and directions."""

import functools

import numpy as np

#: Powers of the reciprocal of the plastic number: multiples of them, less their whole parts, are spread evenly over a
#: square (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018).
PLASTIC = np.array([0.7548776662466927, 0.5698402909980532])
#: The angle between points that follow each other on a Fibonacci spiral.
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))

# Newton's method doubles the digits of nodes that are right to three from the start.
ITERATIONS = 5


@functools.lru_cache(maxsize=256)
def legendre_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in (-1, 1), ascending, and weights: float64 (count,) each, as `numpy.polynomial.legendre.leggauss`.

    numpy asks LAPACK for eigenvalues, whose threads then spin (`small_matmul`); this is Newton's method.
    """
    x = -np.cos(np.pi * (np.arange(count) + 0.75) / (count + 0.5))
    for _ in range(ITERATIONS):
        value, before = x, np.ones(count)
        for degree in range(2, count + 1):
            value, before = ((2 * degree - 1) * x * value - (degree - 1) * before) / degree, value
        slope = count * (before - x * value) / (1.0 - x * x)
        x = x - value / slope
    # Exactly symmetric.
    x = 0.5 * (x - x[::-1])
    weights = 2.0 / ((1.0 - x * x) * slope**2)
    weights = 0.5 * (weights + weights[::-1])
    return x, weights * (2.0 / weights.sum())


def legendre_integrals(x: np.ndarray, count: int) -> np.ndarray:
    """Integrals float64 (count, N) of the first Legendre polynomials P_d from -1 to x (N,).

    They are (P_{d+1} - P_{d-1}) / (2 d + 1), and x + 1 for d = 0.
    """
    values = np.polynomial.legendre.legvander(x, count).T
    degrees = 2.0 * np.arange(1, count)[:, None] + 1.0
    return np.concatenate([(x + 1.0)[None], (values[2:] - values[:-2]) / degrees])


def even_directions(count: int) -> np.ndarray:
    """Unit vectors float64 (count, 3) on a Fibonacci spiral, which stand for equal shares of the sphere."""
    number = np.arange(count)
    rise, turn = 1.0 - (2 * number + 1) / count, number * GOLDEN_ANGLE
    flat = np.sqrt(1.0 - rise**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), rise], axis=1)
