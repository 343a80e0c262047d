# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the light lamps give, and how finely their shadows are told for it."""

import numpy as np
import pytest

from inference import Medium, PointLight, Settings, SpotLight, Sun, render
from inference.grids.grid import Grid
from inference.marching.lamp_in_media import place_lamp
from inference.plan.lights import lamp_shares
from tests.support.volumes import camera, cloud

CORNERS = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij")).reshape(3, -1).T
BOX = {"smoke": CORNERS}
RING = [(3.0 * np.cos(angle), 3.0 * np.sin(angle), 0.4) for angle in np.arange(30) * np.pi / 15]


def test_shares_of_equal_lamps_far_away_are_equal():
    lamps = [PointLight(100.0 * np.array(place), 5.0) for place in RING]
    assert lamp_shares(lamps, [], BOX) == pytest.approx(1.0 / 30.0, rel=0.02)
    assert lamp_shares(lamps[:1], [], BOX) == pytest.approx(1.0)


def test_suns_take_their_part():
    lamp, sun = PointLight((0.0, 0.0, 1000.0), 4e6 * np.pi), Sun((0.0, 0.0, 1.0), 3.0)
    # Fluence of 1 at the middle of the box.
    assert lamp_shares([lamp], [sun], BOX) == pytest.approx(0.25, rel=0.01)
    assert lamp_shares([lamp], [Sun((0.0, 0.0, 1.0), 3.0, receivers=frozenset())], BOX) == pytest.approx(1.0)


def test_spots_that_shine_elsewhere_take_nothing():
    """A beam that is alone in a part of the volume has fine shadows there, however many others there are."""
    place = np.array([0.0, 0.0, 5.0])
    spots = [SpotLight(place, towards - place, 5.0, 0.05, 0.0) for towards in 0.5 * CORNERS[CORNERS[:, 2] > 0.0]]
    assert lamp_shares(spots, [], BOX) == pytest.approx(1.0)


def test_lamps_of_little_light_have_coarser_shadows_of_the_same_sum():
    volume, lamps = cloud(voxels=48), [PointLight(place, 6.0) for place in RING]
    grid = Grid(volume)
    sizes = [
        sum(pyramid.depths.size for pyramid in place_lamp(lamps[0], [grid], share=share).depths[0][0].pyramids)
        for share in (1.0, 0.1, 0.01)
    ]
    assert sizes[0] > 3.0 * sizes[1] > 9.0 * sizes[2]
    settings, medium = Settings(4, multiple=False), Medium(20.0, 0.9, 0.5)
    view = camera(resolution=(48, 48))
    together = render([(volume, medium)], lamps, view, settings).single
    alone = sum(render([(volume, medium)], [lamp], view, settings).single for lamp in lamps)
    assert np.sqrt(((together - alone) ** 2).mean()) < 0.01 * np.sqrt((alone**2).mean())
