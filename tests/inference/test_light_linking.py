# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights that light some volumes or surfaces only."""

from dataclasses import replace

import numpy as np
import pytest

from inference import Medium, PointLight, RenderCache, Settings, Sun, Surface, Volume, bake, render
from tests.support.surfaces import rectangle
from tests.support.volumes import camera, cloud

CACHE = RenderCache()
# What interpolates pixels depends on the light.
EXACT = Settings(depth_samples=4, optimizations=frozenset({"empty_space", "equal_channels"}))
SUN, LAMP = Sun((0.4, 0.3, 0.8), 2.0, "key"), PointLight((0.1, 0.9, 0.6), 8.0, name="bulb")


def clouds(apart=1.0):
    """Two clouds side by side, "left" and "right", as many units apart."""
    one, medium = cloud(voxels=16), Medium(6.0, 0.9, 0.4)
    found = []
    for name, shift in (("left", -0.5 * apart), ("right", 0.5 * apart)):
        matrix = one.world_from_index.copy()
        matrix[:3] *= 0.5
        matrix[0, 3] += shift
        found.append((Volume(one.density, matrix, name), medium))
    return found


def picture(lights, volumes=None, surfaces=()):
    return render(volumes or clouds(), lights, camera(), EXACT, None, None, CACHE, surfaces)


def only(light, *names):
    return replace(light, receivers=frozenset(names))


@pytest.mark.slow
@pytest.mark.parametrize("light", [SUN, LAMP], ids=["sun", "lamp"])
def test_a_light_is_the_sum_of_what_lights_each_volume(light):
    whole = picture([light])
    left, right = (picture([only(light, name)]) for name in ("left", "right"))
    assert np.abs(left.rgb + right.rgb - whole.rgb).max() < 1e-4 * whole.rgb.max()
    # Volumes that it does not light still hide and shade the others.
    assert np.array_equal(left.alpha, whole.alpha)
    middle = whole.alpha.shape[1] // 2
    assert left.multiple[:, :middle].max() > 0.0 and not left.rgb[:, middle:].any()
    assert right.multiple[:, middle:].max() > 0.0 and not right.rgb[:, :middle].any()


def test_volumes_that_a_light_does_not_light_are_baked_black():
    left, right = bake(clouds(), [only(SUN, "left"), only(LAMP, "left")], settings=Settings(directional=False))
    assert left.scattered.max() > 0.0 and not right.scattered.any()


@pytest.mark.slow
def test_ground_that_a_light_does_not_light_returns_nothing():
    ground = Surface(rectangle(-8.0, 8.0, -8.0, 8.0, -0.7).triangles, "ground", reflectance=0.8)
    black = replace(ground, reflectance=0.0)
    bright, linked, below, dark = (
        picture([light], surfaces=[surface])
        for light, surface in (
            (LAMP, ground),
            (only(LAMP, "left", "right"), ground),
            (only(LAMP, "ground"), ground),
            (LAMP, black),
        )
    )
    assert bright.rgb.mean() > 1.05 * dark.rgb.mean()
    # It still returns the light of the clouds.
    assert linked.rgb.mean() == pytest.approx(dark.rgb.mean(), rel=0.03)
    assert below.rgb.mean() == pytest.approx((bright.rgb - linked.rgb).mean(), rel=0.1)


def test_parallel_suns_with_other_links_stay_apart():
    lights = [only(SUN, "left"), replace(only(SUN, "right"), irradiance=np.array([0.0, 0.0, 2.0]))]
    layer, middle = picture(lights), camera().resolution[0] // 2
    assert layer.report.counts["suns"] == 2
    assert layer.rgb[:, :middle, 0].any() and not layer.rgb[:, middle:, 0].any()
    assert layer.rgb[:, middle:, 2].any()


def test_lights_of_nothing_are_left_out_by_name():
    layer = picture([SUN, only(LAMP, "ceiling")])
    assert "bulb: it lights nothing that is rendered" in layer.report.left_out
    assert layer.report.counts["lamps"] == 0


def test_lights_of_some_overlapping_volumes_are_named():
    layer = picture([only(SUN, "left")], clouds(0.2))
    assert [text for text in layer.report.warnings if "key: it lights only some of left and right" in text]
    assert not picture([SUN], clouds(0.2)).report.warnings


def test_many_overlapping_volumes_are_named_in_a_few_words():
    """Instances share a name, and a scatter of clouds has hundreds."""
    many = [
        (volume.instance(volume.world_from_index, f"puff{n // 2}"), medium)
        for n, (volume, medium) in enumerate(clouds(0.2) * 8)
    ]
    (warning,) = picture([only(SUN, "puff0")], many).report.warnings
    assert "it lights only some of puff0 and 7 more, which overlap" in warning
