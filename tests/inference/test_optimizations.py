"""What is left out changes the picture by no more than is said, and can be asked for all the same."""

import numpy as np
import pytest

from inference import RenderCache, Medium, SceneError, Settings, Sun, Surface, Volume, render
from inference.scene.optimizations import ALL, OPTIMIZATIONS

from tests.support.volumes import camera, cloud

# What a render does more of, when it no longer leaves something out.
COUNTED = {
    "missed_pixels": "camera rays", "empty_space": "steps evaluated", "behind_opaque": "steps evaluated",
    "needless_suns": "suns", "equal_channels": "rays marched", "equal_albedos": "network answers",
    "unread_fields": "cells of lookup fields", "faint_rays": "points", "shared_pixels": "network points",
}


@pytest.fixture(scope="module")
def draw():
    """A thick cloud in the sun and the shadow of a plate, and a black one beside it."""
    beside = np.diag([1 / 24, 1 / 24, 1 / 24, 1.0])
    beside[:3, 3] = 0.8, -0.5, -0.5
    black = Volume(cloud().density, beside, "black"), Medium(40.0, 0.0)
    volumes = [(cloud(voxels=64), Medium(200.0, (0.0, 0.9, 0.9), 0.5)), black]
    sun = Sun((0.4, 0.3, 0.8))
    suns = [sun, Sun(sun.direction, 0.5), Sun((0.0, -1.0, 0.2), 0.0), Sun((0.0, 0.0, -1.0))]
    a, b, c, d = ([x, y, -2.0] for x, y in ((-30, -30), (30, -30), (30, 30), (-30, 30)))
    plate = Surface([(a, b, c), (a, c, d)], covers=False)

    def draw(leave_out=ALL, cache=None):
        settings = Settings(8, leave_out=leave_out)
        return render(volumes, suns, camera(resolution=(72, 48)), settings, cache=cache, surfaces=[plate])

    return draw


@pytest.fixture(scope="module")
def usual(draw):
    return draw()


@pytest.fixture(scope="module")
def every_pixel(draw):
    return draw(ALL - {"shared_pixels"})


def change(layer, other):
    """Root mean square over the mean, where volumes are seen."""
    shown = other.alpha > 0.02
    return np.sqrt(np.mean((layer.rgb - other.rgb)[shown] ** 2)) / other.rgb[shown].mean()


@pytest.mark.parametrize("name", COUNTED)
def test_the_picture_stays_within_the_budget_and_the_switch_does_something(name, draw, usual, every_pixel):
    """Each omission alone is asked for."""
    before, left_out = (usual, ALL) if name == "shared_pixels" else (every_pixel, ALL - {"shared_pixels"})
    layer = every_pixel if name == "shared_pixels" else draw(left_out - {name})
    assert change(layer, before) <= max(OPTIMIZATIONS[name].budget, 1e-7)
    np.testing.assert_allclose(layer.alpha, before.alpha, atol=1e-6)
    assert layer.report.counts[COUNTED[name]] > before.report.counts[COUNTED[name]]


def test_nothing_is_kept_where_that_is_not_wanted(draw, every_pixel):
    """Fields that serve any view hold more cells, those of one view alone fewer."""
    cache, left_out = RenderCache(), ALL - {"shared_pixels"}
    first, again = draw(left_out, cache), draw(left_out - {"unchanged"}, cache)
    assert change(again, first) <= OPTIMIZATIONS["unchanged"].budget
    cells = [layer.report.counts["cells of lookup fields"] for layer in (every_pixel, again, first)]
    assert cells[0] == cells[1] < cells[2]


def test_everything_at_once(draw, every_pixel):
    layer = draw(frozenset())
    assert change(layer, every_pixel) <= sum(omission.budget for omission in OPTIMIZATIONS.values())
    assert layer.report.saved == {}


def test_the_report_tells_about_how_long_it_would_have_taken(usual, every_pixel):
    names = {"empty_space", "equal_channels", "needless_suns", "faint_rays", "shared_pixels"}
    # Of fewer samples on faint rays the image is too small to tell: less than a hundredth of a second.
    assert {"equal_channels", "needless_suns"} <= set(usual.report.saved) <= names
    assert "shared_pixels" not in every_pixel.report.saved
    assert all(seconds > 0.0 for seconds in usual.report.saved.values())
    # Two of three colours, each of which would have taken what the one did.
    seconds = usual.report.seconds
    assert usual.report.saved["equal_channels"] == pytest.approx(
        2.0 * (seconds["march"] + seconds["fields"] + seconds["network"]), abs=0.01)


def test_an_unknown_name_is_refused_with_those_there_are():
    with pytest.raises(SceneError, match="no 'noise' to leave out; there are: behind_opaque, .*unread_fields"):
        Settings(leave_out={"noise"})
