# SPDX-License-Identifier: GPL-3.0-or-later
"""Distant lamps whose multiple scattering is predicted at once: which these are, and what it changes."""

from dataclasses import replace

import numpy as np
import pytest

from inference import AreaLight, Medium, PointLight, RenderCache, Settings, SpotLight, Sun, Surface, render
from inference.plan.joined_lamps import joined_lamps
from inference.scene.optimizations import ALL, OPTIMIZATIONS
from tests.support.volumes import camera, cloud

#: The corners of a cube of edge 1 around the origin.
BOX = {"smoke": np.array(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij")).reshape(3, -1).T}
JOINED = ALL - {"shared_pixels"}
CLOUD, CACHE = cloud(voxels=32), RenderCache()


def along(*direction, distance=3.0):
    return distance * np.array(direction) / np.linalg.norm(direction)


def row(count=5, towards=(0.4, 0.3, 0.8), **changes):
    """Spots side by side that shine at the cloud."""
    places = [along(*towards) + 0.2 * k * np.array([0.6, -0.8, 0.0]) for k in range(count)]
    return [SpotLight(place, -place, 20.0 + 9.0 * k, 0.5, 0.3, 0.03, **changes) for k, place in enumerate(places)]


def picture(lights, optimizations=JOINED, surfaces=()):
    medium = Medium(40.0, (0.99, 0.9, 0.9), 0.857)
    return render(
        [(CLOUD, medium)], lights, camera(), Settings(4, optimizations=optimizations), None, None, CACHE, surfaces
    )


def change(layer, other):
    shown = other.alpha > 0.02
    return np.sqrt(((layer.rgb - other.rgb)[shown] ** 2).mean()) / other.rgb[shown].mean()


@pytest.mark.slow
@pytest.mark.parametrize("surfaces", [[], [Surface([[[0, -4, 1.2], [4, -4, 1.2], [0.4, 4, 1.2]]], covers=False)]])
def test_joined_lamps_change_the_picture_within_the_budget(surfaces):
    lights = row()
    joined, each = (picture(lights, names, surfaces) for names in (JOINED, JOINED - {"distant_lamps"}))
    assert 0.0 < change(joined, each) < OPTIMIZATIONS["distant_lamps"].budget
    np.testing.assert_allclose(joined.single, each.single, rtol=1e-4, atol=1e-6 * each.single.max())
    assert joined.report.counts["network points"] < 0.5 * each.report.counts["network points"]
    assert any("predictions of lamps" in sentence for sentence in joined.report.left_out)


def test_joined_lamps_keep_the_single_scattering_of_each():
    places = [along(0.4, 0.3, 0.8) + 0.3 * k * np.array([0.6, -0.8, 0.0]) for k in range(4)]
    lamps = [PointLight(place, 20.0 + 9.0 * k, 0.02 * k) for k, place in enumerate(places)]
    settings = [Settings(4, optimizations=names, multiple=False) for names in (JOINED, JOINED - {"distant_lamps"})]
    medium = Medium(40.0, (0.99, 0.9, 0.9), 0.857)
    joined, each = (render([(CLOUD, medium)], lamps, camera(), one, cache=CACHE).single for one in settings)
    np.testing.assert_allclose(joined, each, rtol=1e-4, atol=1e-6 * each.max())


@pytest.mark.slow
def test_lamps_beside_brighter_ones_need_fewer_points():
    def seen(lamps, optimizations=ALL):
        settings, medium = Settings(4, optimizations=optimizations), Medium(40.0, 0.9, 0.857)
        return render([(CLOUD, medium)], lamps, camera(resolution=(150, 100)), settings, cache=CACHE)

    around = [PointLight(along(*way), power) for way, power in (((1, 0, 0.5), 40.0), ((0, 1, 0.2), 4.0))]
    points = [seen(lamps).report.counts["network points"] for lamps in (around[:1], around[1:], around)]
    assert points[2] - points[0] < 0.8 * points[1]
    assert change(seen(around), seen(around, JOINED)) < OPTIMIZATIONS["shared_pixels"].budget


@pytest.mark.parametrize(("count", "bound"), [(2, 2e-3), (30, 0.01)])
def test_lamps_at_one_place_join_as_one(count, bound):
    whole, parts = (picture([PointLight(along(1, 1, 2), 80.0 / n)] * n) for n in (1, count))
    # The transport samples several lamps in fewer places of each cell, which are large in a small picture; and columns
    # of many lamps are further apart.
    assert change(parts, whole) < bound
    assert parts.report.counts["network points"] == whole.report.counts["network points"]


def test_lamps_at_one_place_inside_give_the_light_of_one():
    whole, parts = (picture([PointLight((0.05, 0.1, 0.0), 80.0 / n, 0.02)] * n) for n in (1, 8))
    assert change(parts, whole) < 0.01


@pytest.mark.slow
def test_joined_panels_give_the_sum_of_what_each_gives():
    """Each has fewer emitters than alone."""
    lamps = []
    for x, y in np.ndindex(3, 3):
        matrix = np.eye(4)
        matrix[:3, 3] = 0.4 * (x - 1.0), 0.4 * (y - 1.0), 2.5
        lamps.append(AreaLight(matrix, "square", 0.6, 20.0))
    joined, each = picture(lamps), [picture([lamp]) for lamp in lamps]
    total = replace(each[0], rgb=sum(layer.rgb for layer in each))
    assert change(joined, total) < OPTIMIZATIONS["distant_lamps"].budget


def test_lamps_of_about_the_same_direction_are_joined():
    beside = [PointLight(along(1, 0, 0.1 * k), 1.0) for k in range(3)]
    assert joined_lamps(beside, [], BOX) == [[0, 1, 2]]
    across = [PointLight(along(0, 1, 0.1 * k), 1.0) for k in range(3)]
    assert joined_lamps([beside[0], *across, *beside[1:]], [], BOX) == [[0, 4, 5], [1, 2, 3]]


@pytest.mark.parametrize(
    "other",
    [
        PointLight(along(0, 1, 0), 1.0),
        PointLight(along(1, 0, 0), (1.0, 0.5, 0.5)),
        PointLight(along(1, 0, 0), 1.0, receivers=frozenset({"smoke"})),
        PointLight(along(1, 0, 0, distance=0.7), 1.0),
        PointLight((0.0, 0.0, 0.1), 1.0),
    ],
    ids=["direction", "colour", "linking", "near", "inside"],
)
def test_lamps_whose_light_differs_are_not_joined(other):
    assert joined_lamps([PointLight(along(1, 0, 0), 1.0), other], [], BOX) == [[0], [1]]


def test_weak_lamps_are_joined_from_further_apart():
    lamps = [PointLight(along(1, 0, 0), 10.0), PointLight(along(1, 0.5, 0), 10.0)]
    assert len(joined_lamps(lamps, [], BOX)) == 2
    assert joined_lamps(lamps, [Sun((0, 0, 1), 10.0)], BOX) == [[0, 1]]
    assert len(joined_lamps(lamps, [Sun((0, 0, 1), 10.0, receivers=frozenset({"other"}))], BOX)) == 2


def test_lamps_that_light_nothing_here_do_not_count():
    lamps = [PointLight(along(1, 0, 0), 10.0), PointLight(along(1, 0.5, 0), 10.0)]
    elsewhere = PointLight(along(0, 0, 1), 500.0, receivers=frozenset({"other"}))
    assert joined_lamps([*lamps, elsewhere], [], BOX) == [[0], [1], [2]]
