# SPDX-License-Identifier: GPL-3.0-or-later
"""The fluence that lights of every kind state is what a picture of thin fog shows."""

from dataclasses import replace

import numpy as np

from inference import Medium, Settings, render
from inference.plan.lights import brightest_light
from tests.support.lights import one_of_each
from tests.support.volumes import box, camera

FOG = box(voxels=8), Medium(0.02, (1.0, 0.8, 0.6))
VIEW = camera(projection="orthographic", ortho_scale=1.0, resolution=(8, 8))


def test_the_brightest_light_is_that_of_the_brightest_picture():
    lights = one_of_each()
    single = Settings(multiple=False, depth_samples=16)
    pictures = np.array([render([FOG], [light], VIEW, single).rgb.mean() for light in lights])
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (512, 3))
    fluences = np.array([light.fluence_at(points) @ FOG[1].albedo for light in lights]).mean(axis=1)
    np.testing.assert_allclose(pictures / pictures[0], fluences / fluences[0], rtol=0.05)
    order = np.argsort(pictures)
    assert [brightest_light([lights[n] for n in order[:k]], [FOG])[0] for k in (1, 2, 3, 4, 5)] == [
        lights[n] for n in order
    ]


def test_a_light_that_is_linked_to_other_objects_is_not_the_brightest():
    sun, point, spot, area, environment = one_of_each()
    elsewhere = replace(area, receivers=frozenset({"wall"}))
    assert brightest_light([elsewhere, environment], [FOG]) == [environment]
    assert brightest_light([elsewhere], [FOG]) == []
    assert brightest_light([], [FOG]) == []
