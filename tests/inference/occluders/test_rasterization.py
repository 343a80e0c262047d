# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles that hide each other, against all of them."""

import numpy as np
import pytest

from inference.occluders import rasterization
from inference.occluders.rasterization import rasterize, rasterize_nearest

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
        return rasterize(corners, *others)

    monkeypatch.setattr(rasterization, "rasterize", counted)
    largest, number = rasterize_nearest(corners, value, size)
    assert np.all(largest == 1.0) and np.all(number == count - 1)
    assert sum(tested) < 0.02 * count
