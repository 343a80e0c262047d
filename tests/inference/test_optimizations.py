# SPDX-License-Identifier: GPL-3.0-or-later
"""Optimizations stay within their stated error, and each can be turned off."""

import numpy as np
import pytest

from inference import Medium, RenderCache, SceneError, Settings, Sun, Surface, Volume, render
from inference.scene.optimizations import ALL, OPTIMIZATIONS
from tests.support.volumes import camera, cloud

# What a render does more of without each optimization.
COUNTED = {
    "missed_pixels": "camera rays",
    "empty_space": "steps evaluated",
    "behind_opaque": "steps evaluated",
    "needless_suns": "suns",
    "equal_channels": "rays marched",
    "equal_albedos": "network answers",
    "faint_rays": "points",
    "shared_pixels": "network points",
}
# Of each kind one in every run: fewer rays, steps and pixels.
QUICK = ("faint_rays", "behind_opaque", "shared_pixels")


@pytest.fixture(scope="module")
def draw():
    """A thick cloud partly in the shadow of a plate, and a black cloud beside it."""
    beside = np.diag([1 / 24, 1 / 24, 1 / 24, 1.0])
    beside[:3, 3] = 0.8, -0.5, -0.5
    black = Volume(cloud().density, beside, "black"), Medium(40.0, 0.0)
    volumes = [(cloud(voxels=64), Medium(200.0, (0.0, 0.9, 0.9), 0.5)), black]
    sun = Sun((0.4, 0.3, 0.8))
    suns = [sun, Sun(sun.direction, 0.5), Sun((0.0, -1.0, 0.2), 0.0), Sun((0.0, 0.0, -1.0))]
    a, b, c, d = ([x, y, -2.0] for x, y in ((-30, -30), (30, -30), (30, 30), (-30, 30)))
    plate = Surface([(a, b, c), (a, c, d)], covers=False)

    def draw(optimizations=ALL, cache=None):
        settings = Settings(8, optimizations=optimizations)
        return render(volumes, suns, camera(resolution=(108, 72)), settings, cache=cache, surfaces=[plate])

    return draw


@pytest.fixture(scope="module")
def usual(draw):
    return draw()


@pytest.fixture(scope="module")
def every_pixel(draw):
    return draw(ALL - {"shared_pixels"})


def change(layer, other):
    """Relative RMSE over the pixels that show volumes."""
    shown = other.alpha > 0.02
    return np.sqrt(np.mean((layer.rgb - other.rgb)[shown] ** 2)) / other.rgb[shown].mean()


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in COUNTED]
)
def test_each_optimization_stays_within_its_budget_and_has_an_effect(name, draw, usual, every_pixel):
    """Each is turned off alone."""
    before, optimizations = (usual, ALL) if name == "shared_pixels" else (every_pixel, ALL - {"shared_pixels"})
    layer = every_pixel if name == "shared_pixels" else draw(optimizations - {name})
    assert change(layer, before) <= max(OPTIMIZATIONS[name].budget, 1e-7)
    np.testing.assert_allclose(layer.alpha, before.alpha, atol=1e-6)
    assert layer.report.counts[COUNTED[name]] > before.report.counts[COUNTED[name]]


def test_a_render_cache_changes_nothing(draw, every_pixel):
    cache = RenderCache()
    for _ in range(2):
        np.testing.assert_array_equal(draw(ALL - {"shared_pixels"}, cache).rgb, every_pixel.rgb)


@pytest.mark.slow
def test_all_optimizations_together_stay_within_the_budget(draw, every_pixel):
    layer = draw(frozenset())
    assert change(layer, every_pixel) <= sum(omission.budget for omission in OPTIMIZATIONS.values())


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(SceneError, match="no optimization called 'noise'; there are: behind_opaque, .*unseen_voxels"):
        Settings(optimizations={"noise"})
