# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that a lamp inside a volume leaves on coarse cells."""

import numpy as np
import pytest

from inference import PointLight
from inference.grids.working_cube import Cube
from inference.source_terms.lamp_beam import CubeCells, LampInCube
from inference.source_terms.nearby_light import NearbyMedium, nearby_light
from inference.transport.discrete_ordinates import DiscreteOrdinates

CELLS, PLACE = 64, np.array([0.11, -0.07, 0.04])


def lamp_at(place):
    cube = Cube(np.eye(3), np.zeros(3), 1.0, np.zeros(3), np.ones(3))
    emitters = PointLight(tuple(place), 1.0).emitters(np.full(3, -0.5), np.full(3, 0.5), 4)
    return LampInCube(emitters, cube, None, b"", place)


def light_of(sigma, anisotropy, albedo, density, triangles=None):
    """Unscattered and scattered light in cells."""
    solver = DiscreteOrdinates(density, sigma, anisotropy, triangles, albedo)
    medium, lamp = NearbyMedium(density, sigma, anisotropy, albedo), lamp_at(PLACE)
    return lamp(CubeCells(density, sigma))[0], nearby_light(solver, medium, [(lamp, 1.0)])


@pytest.mark.parametrize("albedo", [0.3, 0.9])
@pytest.mark.parametrize("anisotropy", [-0.5, 0.0, 0.5, 0.857])
def test_all_power_is_absorbed(anisotropy, albedo):
    """In a cube that no light leaves."""
    sigma = 80.0 / (1.0 - albedo * max(anisotropy, 0.0))
    unscattered, found = light_of(sigma, anisotropy, albedo, np.ones((CELLS,) * 3, np.float32))
    absorbed = sigma * (1.0 - albedo) * (unscattered + found[0] + found[16]).sum() / CELLS**3
    # The unscattered light of cells that are optically thick is known to a few parts in a hundred.
    alone = sigma * unscattered.sum() / CELLS**3
    assert absorbed == pytest.approx(alone, rel=0.02) and alone == pytest.approx(1.0, rel=0.06)


def test_a_wall_takes_light_from_behind_it():
    """Light that scatters on the lamp's side; no shadow map tells the lamp's own beam of the wall."""
    wall = np.array([[-0.2, -2.0, -2.0], [-0.2, 2.0, -2.0], [-0.2, 2.0, 2.0], [-0.2, -2.0, 2.0]])
    triangles = wall[[[0, 1, 2], [0, 2, 3]]]
    density = np.ones((CELLS,) * 3, np.float32)
    open_, walled = (light_of(8.0, 0.857, 0.9, density, faces)[1][[0, 16]] for faces in (None, triangles))
    near, behind = walled[:, 22:].sum(), walled[:, :17].sum()
    assert 0.7 * open_[:, 22:].sum() < near < 1.05 * open_[:, 22:].sum()
    assert behind < 0.8 * open_[:, :17].sum()


@pytest.mark.parametrize("anisotropy", [0.0, 0.02])
def test_light_of_several_lamps_is_the_sum_of_theirs(anisotropy):
    density = np.ones((CELLS,) * 3, np.float32)
    solver = DiscreteOrdinates(density, 12.0, anisotropy, albedo=0.9)
    medium = NearbyMedium(density, 12.0, anisotropy, 0.9)
    places = (PLACE, -PLACE, PLACE[::-1], np.array([0.3, 0.3, -0.3]))
    lamps = list(zip(map(lamp_at, places), (0.4, 0.3, 0.2, 0.1)))
    found, expected = nearby_light(solver, medium, lamps), sum(nearby_light(solver, medium, [one]) for one in lamps)
    assert np.abs(found - expected).mean() < 2e-3 * expected[0].mean()
