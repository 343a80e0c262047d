# SPDX-License-Identifier: GPL-3.0-or-later
"""Matrix products in blocks against numpy's."""

import time

import numpy as np
import pytest

from inference.numerics.small_matmul import MATRIX_WORK, VECTOR_WORK, product


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize(
    "a, b",
    [
        ((5, 8), (8,)),
        ((3, VECTOR_WORK // 4, 8), (8,)),
        ((1025, 8), (8,)),
        ((2, 40_000), (40_000,)),
        ((70_000, 3), (3, 5)),
        ((70_000, 3), (3, 1)),
        ((7, 500), (500, 400)),
        ((100, 3), (3, 0)),
        ((0, 3), (3, 2)),
        ((4, 0), (0, 2)),
        ((2, 0, 6), (6,)),
    ],
)
def test_products_equal_those_of_numpy(a, b, kind):
    """Longer and shorter than a block, and empty."""
    random = np.random.default_rng(3)
    a, b = random.random(a).astype(kind), random.random(b).astype(kind)
    found, wanted = product(a, b), a @ b
    assert found.shape == wanted.shape and found.dtype == wanted.dtype
    np.testing.assert_allclose(found, wanted, rtol=1e-5 if kind == np.float32 else 1e-12)


def test_a_row_does_not_depend_on_the_others():
    random = np.random.default_rng(4)
    a, b = random.random((3 * MATRIX_WORK // 24, 8)), random.random((8, 3))
    np.testing.assert_array_equal(product(a[:1000], b), product(a, b)[:1000])


@pytest.mark.parametrize(
    "a, b", [((70_000, 3), (3, 1)), ((70_000, 3), (3, 3)), ((70_000, 8), (8,)), ((2000, 400), (400, 90))]
)
def test_no_other_thread_works(a, b):
    a, b = np.ones(a, np.float32), np.ones(b, np.float32)
    product(a, b)
    # Threads that spin after earlier products go to sleep.
    time.sleep(0.2)
    process, thread = time.process_time(), time.thread_time()
    while time.thread_time() < thread + 0.3:
        product(a, b)
    assert time.process_time() - process < 1.1 * (time.thread_time() - thread)
