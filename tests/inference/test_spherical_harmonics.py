# SPDX-License-Identifier: GPL-3.0-or-later
"""Spherical harmonics up to degree 3."""

import numpy as np
import pytest

from inference.numerics.spherical_harmonics import DEGREES, spherical_harmonics


def test_harmonics_of_a_degree_add_up_to_legendres_polynomial():
    first, second = np.random.default_rng(3).normal(size=(2, 50, 3))
    first, second = (vectors / np.linalg.norm(vectors, axis=1)[:, None] for vectors in (first, second))
    products = spherical_harmonics(first) * spherical_harmonics(second)
    cosine = (first * second).sum(axis=1)
    for degree in range(4):
        expected = np.polynomial.legendre.Legendre.basis(degree)(cosine)
        assert products[DEGREES == degree].sum(axis=0) == pytest.approx(expected, abs=1e-12)
