# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of a soft falloff in the even matter around it, against sums over its disk and over collisions."""

import numpy as np
import pytest

from inference.grids.sphere_depth import NODES, excess_depths, start_depths

DISTANCES = 0.3, 1.0, 2.5


def at(table, distance):
    """A table's value at a distance, in radii."""
    return np.interp(distance / (1.0 + distance) * (NODES - 1), np.arange(NODES), table)


def transmittance(thickness, distance):
    """Mean over the solid angle of a disk of radius 1 that faces a place, and the fluence for a radiance of 1."""
    square = (np.arange(4000) + 0.5) / 4000
    way = np.sqrt(distance**2 + square)
    angles = np.pi * distance / way**3
    return (angles * np.exp(-thickness * way)).sum() / angles.sum(), angles.mean()


def collided(thickness, distance, lost):
    """Light that collided between the disk's middle and a distance, by a factor `lost` of what did since; over what a
    point of the same intensity, pi, gives there."""
    step = distance / 1000
    places = (np.arange(1000) + 0.5) * step
    found = 0.0
    for place in places:
        through, fluence = transmittance(thickness, place)
        found += (
            thickness * step * place**2 * fluence / np.pi * through * np.exp(-lost * thickness * (distance - place))
        )
    return found


@pytest.mark.parametrize("thickness, forward", [(0.1, 0.7), (1.0, 0.2), (1.0, 0.7), (4.0, 0.7)])
def test_light_that_scatters_straight_on_is_that_of_all_collisions(thickness, forward):
    table = excess_depths(thickness * (1.0 - forward), True, 0.0, forward)
    for distance in DISTANCES:
        through, fluence = transmittance(thickness, distance)
        share = distance**2 * fluence / np.pi
        expected = -np.log(through + forward * collided(thickness, distance, 1.0 - forward) / share)
        found = at(table, distance) + (1.0 - forward) * thickness * distance
        assert found == pytest.approx(expected, rel=0.01, abs=2e-3)


@pytest.mark.parametrize("thickness", [0.1, 1.0, 4.0])
def test_light_starts_to_scatter_where_all_that_has_scattered_started(thickness):
    table = start_depths(thickness)
    for distance in DISTANCES:
        through, fluence = transmittance(thickness, distance)
        scattered = collided(thickness, distance, 0.0) / (distance**2 * fluence / np.pi)
        assert np.exp(-at(table, distance)) - through == pytest.approx(scattered, rel=0.01, abs=2e-3)


def test_nothing_changes_where_nothing_scatters_straight_on():
    np.testing.assert_array_equal(excess_depths(1.0, False, 0.5, 0.7), excess_depths(1.0, False, 0.5))
    found, expected = excess_depths(1.0, True, 0.5, 1e-6), excess_depths(1.0, True, 0.5)
    np.testing.assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize("thickness", [1e-30, 1e-3, 30.0, 1e4, 1e8])
@pytest.mark.parametrize("forward", [1e-6, 0.5, 1.0 - 1e-6])
def test_depths_are_finite_in_any_matter(thickness, forward):
    for apart in (0.0, 0.5):
        assert np.isfinite(excess_depths(thickness, True, apart, forward)).all()
    starts = start_depths(thickness)
    assert np.isfinite(starts).all() and starts.min() > -1e-6
