# SPDX-License-Identifier: GPL-3.0-or-later
"""How far light goes between two scatterings, and what arrives from there."""

import numpy as np
import pytest

from inference.transport.mean_free_path import FARTHEST, light_ahead, mean_free_path


def test_the_mean_free_path_is_that_where_most_is_scattered():
    """In a block within a veil that of the block; in thin fog, and where nothing is, at most a part of the cube."""
    density = np.full((16, 16, 16), 1e-3, np.float32)
    density[4:12, 4:12, 4:12] = 1.0
    assert mean_free_path(density, 20.0) == pytest.approx(1.0 / 20.0, rel=0.1)
    assert mean_free_path(density, 0.01) == FARTHEST
    assert mean_free_path(np.zeros_like(density), 20.0) == FARTHEST


@pytest.mark.parametrize("extinction", [0.0, 0.3, 40.0])
def test_light_ahead_is_that_of_even_parts_of_a_ray(extinction):
    """The integral of emission times transmittance, whatever the lengths of the parts."""
    ends = (0.1, 0.5, 0.6, 2.0)
    begins = np.array([0.0, *ends[:-1]])
    emission = np.array([3.0, 0.0, 1.0, 2.0])
    asked = []

    def read(number, distance):
        asked.append(distance)
        return np.full(2, extinction), emission[number] * np.array([1.0, 4.0])

    places = (np.arange(200_000) + 0.5) * (ends[-1] / 200_000)
    emitted = emission[np.searchsorted(ends, places)] * np.exp(-extinction * places)
    expected = emitted.mean() * ends[-1]
    np.testing.assert_allclose(light_ahead(read, ends), [expected, 4.0 * expected], rtol=1e-3)
    np.testing.assert_allclose(asked, 0.5 * (begins + ends))
