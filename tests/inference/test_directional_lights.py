# SPDX-License-Identifier: GPL-3.0-or-later
"""Environments as a few parallel lights."""

import math

import numpy as np
import pytest

from inference import Environment
from inference.plan.directional_lights import directional_lights
from inference.scene.environment import pixel_directions, pixel_solid_angles


@pytest.mark.parametrize("count", [12, 20])
def test_uniform_light_keeps_its_moments(count):
    found = directional_lights(Environment(np.full((64, 128, 3), 0.5)), count)
    assert len(found) == count
    if count == 12:
        # Half of it is above the horizon, nothing lies on it.
        assert sorted(np.sign(np.round(sun.direction[2], 3)) for sun in found) == [-1] * 6 + [1] * 6
    total = sum(sun.irradiance[0] for sun in found)
    assert total == pytest.approx(2 * math.pi)
    second = sum(sun.irradiance[0] * np.outer(sun.direction, sun.direction) for sun in found) / total
    np.testing.assert_allclose(second, np.eye(3) / 3, atol={12: 0.01, 20: 0.12}[count])


def test_a_bright_spot_gets_a_light_of_its_own():
    directions = pixel_directions(64)
    sun = np.array([0.3, -0.7, 0.5]) / np.linalg.norm([0.3, -0.7, 0.5])
    radiance = np.where(directions @ sun > math.cos(0.06), 300.0, 0.1)[..., None] * [1.0, 0.8, 0.6]
    found = directional_lights(Environment(radiance), 16)
    brightest = max(found, key=lambda light: light.irradiance[0])
    assert brightest.direction @ sun > math.cos(0.03)
    np.testing.assert_allclose(sum(light.irradiance for light in found), Environment(radiance).fluence(), rtol=1e-5)


def test_each_part_of_the_light_keeps_its_mean_direction():
    """Together, the fewer directions have the moments of the whole light."""
    directions, angles = pixel_directions(64), pixel_solid_angles(64)
    radiance = np.exp(4.0 * directions @ [0.6, 0.0, 0.8])[..., None] * [1.0, 0.8, 0.6]
    found = directional_lights(Environment(radiance), 12)
    assert 1000 < sum(len(sun.spread[1]) for sun in found) < directions.size // 3
    light = angles * radiance[..., 0]
    for power in (0, 1, 2, 5):
        wanted = (light * (directions @ [0.6, 0.0, 0.8]) ** power).sum()
        parts = sum(sun.irradiance[0] * (sun.spread[1] @ (sun.spread[0] @ [0.6, 0.0, 0.8]) ** power) for sun in found)
        assert parts == pytest.approx(wanted, rel=0.005)
