# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles that hide each other, against all of them."""

import numpy as np
import pytest

from inference.occluders import rasterization
from inference.occluders.rasterization import fill, rasterize, rasterize_nearest
from tests.support.kernels import VARIANTS, variant

# Count of triangles, and their size in points of the raster.
TRIANGLES = {"few and large": (6, 90.0), "many and small": (3000, 2.0), "many and large": (500, 200.0)}


@pytest.mark.parametrize(("count", "extent"), TRIANGLES.values(), ids=TRIANGLES)
def test_the_nearest_are_found_among_triangles_that_hide_each_other(count, extent):
    random, size = np.random.default_rng(3), np.array([203, 130])
    corners = random.uniform(-0.2, 1.2, (count, 1, 2)) * size + random.normal(0.0, extent, (count, 3, 2))
    value = random.uniform(0.0, 1.0, (count, 1)) + random.uniform(0.0, 0.1, (count, 3))
    expected = np.full(size[0] * size[1], -np.inf)
    for flat, found, _ in rasterize(corners, value, size):
        np.maximum.at(expected, flat, found)
    largest, number = rasterize_nearest(corners, value, size)
    np.testing.assert_array_equal(largest.ravel(), expected)
    assert np.array_equal(number >= 0, np.isfinite(largest)) and np.unique(number).size > 2
    # Each point's triangle covers it, and has that value there.
    for owner in np.unique(number[number >= 0])[:20]:
        alone, _ = rasterize_nearest(corners[[owner]], value[[owner]], size)
        np.testing.assert_array_equal(alone[number == owner], largest[number == owner])


def test_hidden_triangles_are_not_rasterized(monkeypatch):
    size, count = np.array([256, 256]), 400
    corners = np.tile(np.array([[-300.0, -300.0], [900.0, -300.0], [-300.0, 900.0]]), (count, 1, 1))
    value = np.tile(np.linspace(0.0, 1.0, count)[:, None], 3)
    tested = []

    def counted(corners, *others):
        tested.append(len(corners))
        return fill(corners, *others)

    monkeypatch.setattr(rasterization, "fill", counted)
    largest, number = rasterize_nearest(corners, value, size)
    assert np.all(largest == 1.0) and np.all(number == count - 1)
    assert sum(tested) < 0.02 * count


@pytest.mark.parametrize("kind", VARIANTS)
def test_every_kernel_fills_what_numpy_does(kind):
    """Also triangles with equal values, without area, off the raster, and with corners on its points."""
    random, size, count = np.random.default_rng(8), np.array([61, 37]), 300
    corners = np.round(random.uniform(-0.3, 1.3, (count, 1, 2)) * size + random.normal(0.0, 12.0, (count, 3, 2)))
    corners[:9, 2] = corners[:9, 0]
    corners[9:] += random.uniform(-0.5, 0.5, (count - 9, 3, 2)) * random.integers(0, 2, (count - 9, 1, 1))
    value = np.round(random.uniform(0.0, 1.0, (count, 1)), 1) + np.zeros(3)
    largest, number = np.full(size[0] * size[1], -np.inf), np.full(size[0] * size[1], -1)
    for flat, found, triangle in rasterize(corners, value, size):
        for at, one, owner in zip(flat, found, triangle):
            if one >= largest[at]:
                largest[at], number[at] = one, owner
    with variant(kind):
        found = rasterize_nearest(corners, value, size)
    np.testing.assert_array_equal(found[0].ravel(), largest)
    np.testing.assert_array_equal(found[1].ravel(), number)
