# SPDX-License-Identifier: GPL-3.0-or-later
"""Suns with an angular diameter: moments of their discs, and multiple scattering predicted for all parts at once."""

import numpy as np
import pytest

from inference import Medium, SceneError, Settings, Sun, bake, render, soft_sun
from inference.scene.optimizations import ALL, OPTIMIZATIONS
from tests.support.volumes import camera, cloud

AXIS = np.array([0.4, 0.3, 0.8]) / np.linalg.norm([0.4, 0.3, 0.8])
SEPARATE = ALL - {"soft_suns", "shared_pixels"}


@pytest.mark.parametrize("degrees", [5.0, 30.0, 90.0, 170.0])
def test_a_soft_sun_has_the_mean_direction_of_a_uniform_disc(degrees):
    suns, rim = soft_sun(2.0 * AXIS, (3.0, 2.0, 1.0), np.radians(degrees)), np.cos(np.radians(degrees) / 2.0)
    light = np.array([sun.irradiance for sun in suns])
    np.testing.assert_allclose(light.sum(axis=0), (3.0, 2.0, 1.0))
    mean = light.T @ np.array([sun.direction for sun in suns]) / light.sum(axis=0)[:, None]
    np.testing.assert_allclose(mean, np.tile(0.5 * (1.0 + rim) * AXIS, (3, 1)), atol=1e-4)


def test_a_sharp_sun_is_one_direction():
    (sun,) = soft_sun(AXIS, 2.0, np.radians(0.5))
    np.testing.assert_allclose(sun.direction, AXIS)
    with pytest.raises(SceneError, match="angle"):
        soft_sun(AXIS, 2.0, -0.1)
    with pytest.raises(SceneError, match="direction"):
        soft_sun((0.0, 0.0, 0.0), 2.0, 0.3)


@pytest.mark.slow
@pytest.mark.parametrize("degrees, sigma_t, anisotropy, parts", [(30.0, 40.0, 0.857, 7), (90.0, 100.0, 0.0, 19)])
def test_joined_parts_look_as_each_alone_and_cost_less(degrees, sigma_t, anisotropy, parts):
    volumes, suns = [(cloud(), Medium(sigma_t, 0.98, anisotropy))], soft_sun((0.0, -1.0, 0.2), 1.0, np.radians(degrees))
    joined, each = (
        render(volumes, suns, camera(resolution=(24, 16)), Settings(8, optimizations=without))
        for without in (SEPARATE | {"soft_suns"}, SEPARATE)
    )
    shown = each.alpha > 0.02
    change = np.sqrt(np.mean((joined.rgb - each.rgb)[shown] ** 2)) / each.rgb[shown].mean()
    assert 0.0 < change < OPTIMIZATIONS["soft_suns"].budget
    np.testing.assert_array_equal(joined.single, each.single)
    predictions = each.report.counts["network points"] / joined.report.counts["network points"]
    assert predictions == pytest.approx(parts / (1 if parts == 7 else 7))


def test_a_soft_sun_is_linear_in_its_irradiance():
    volumes, settings = [(cloud(), Medium(30.0, 0.9, 0.5))], Settings(2, optimizations=ALL - {"shared_pixels"})
    one, four = (
        render(volumes, soft_sun(AXIS, light, 0.4), camera(resolution=(12, 8)), settings).multiple for light in (1, 4)
    )
    np.testing.assert_allclose(four, 4.0 * one, rtol=1e-5, atol=1e-9)


@pytest.mark.slow
def test_baked_light_joins_the_parts_too():
    volumes, suns = [(cloud(voxels=16), Medium(30.0, 0.98, 0.5))], soft_sun(AXIS, 1.0, np.radians(30.0))
    settings = (Settings(optimizations=without, directional=False) for without in (SEPARATE | {"soft_suns"}, SEPARATE))
    joined, each = (bake(volumes, suns, settings=one)[0].emission for one in settings)
    # Of voxels: pixels, for which the budget is stated, average over them.
    assert np.sqrt(np.mean((joined - each) ** 2)) < 0.025 * each.mean() and not np.array_equal(joined, each)


def test_suns_that_are_part_of_nothing_stay_apart():
    """Two suns are two predictions."""
    volumes, settings = [(cloud(), Medium(30.0, 0.9, 0.5))], Settings(1, optimizations=ALL - {"shared_pixels"})
    counts = [
        render(volumes, suns, camera(resolution=(12, 8)), settings).report.counts["network points"]
        for suns in ([Sun(AXIS)], [Sun(AXIS), Sun((0.0, 0.0, 1.0))])
    ]
    assert counts[1] == 2 * counts[0]
