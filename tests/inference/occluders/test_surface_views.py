# SPDX-License-Identifier: GPL-3.0-or-later
"""What places in volumes see of surfaces, against closed forms."""

import numpy as np
import pytest

from inference import Surface
from inference.occluders.seen_surfaces import see_surfaces
from inference.occluders.surface_views import VIEWPOINTS, SurfaceViews
from inference.scene.environment import PlaceLattice
from tests.support.surfaces import rectangle

CORNERS = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
EYE = np.array([0.02, 0.01, 0.03])
ONES = np.ones(3)


def places():
    axes = [np.linspace(-0.5, 0.5, VIEWPOINTS)] * 3
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def corner_angle(x, y, height):
    """Solid angle of a rectangle from above one of its corners, with a sign."""
    return np.arctan(x * y / (height * np.sqrt(x**2 + y**2 + height**2)))


def solid_angles(points, left, right, z):
    """Of a square from left to right along x and y, from points (N, 3) above it."""
    (x, y), height = points[:, :2].T, points[:, 2] - z
    return sum(
        sx * sy * corner_angle(x1 - x, y1 - y, height)
        for sx, x1 in ((-1, left), (1, right))
        for sy, y1 in ((-1, left), (1, right))
    )


def test_endless_ground_fills_half_of_what_every_place_sees():
    seen = see_surfaces([rectangle(-1e3, 1e3, -1e3, 1e3, -0.7)], EYE)
    views = SurfaceViews(seen, EYE, CORNERS)
    assert views.fluence(np.tile(ONES, (len(seen.points), 1))) == pytest.approx(2.0 * np.pi * ONES, rel=0.01)
    sky = views.environment(np.tile(ONES, (len(seen.points), 1)), "ground")
    assert sky.weight.values == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("z", [-0.7, -0.2])
def test_places_see_a_square_as_large_as_it_is(z):
    """Ground that places would see from behind is seen from just before it."""
    seen = see_surfaces([rectangle(-2.0, 2.0, -2.0, 2.0, z)], EYE)
    sky = SurfaceViews(seen, EYE, CORNERS).environment(np.tile(ONES, (len(seen.points), 1)), "ground")
    points = places()
    points[:, 2] = np.maximum(points[:, 2], z + 0.01)
    fluence = sky.fluence().mean() * sky.weight(places())
    assert fluence == pytest.approx(solid_angles(points, -2.0, 2.0, z), rel=0.1)
    assert fluence.mean() == pytest.approx(solid_angles(points, -2.0, 2.0, z).mean(), rel=0.03)


def test_places_see_a_small_panel_that_is_elsewhere_from_each_of_them():
    seen = see_surfaces([rectangle(-0.2, 0.2, -0.2, 0.2, -0.6)], EYE)
    sky = SurfaceViews(seen, EYE, CORNERS).environment(np.tile(ONES, (len(seen.points), 1)), "panel")
    fluence = sky.fluence().mean() * sky.weight(places())
    expected = solid_angles(places(), -0.2, 0.2, -0.6)
    assert fluence.mean() == pytest.approx(expected.mean(), rel=0.1)
    assert np.abs(fluence - expected).mean() < 0.25 * expected.mean()


def test_places_near_bright_ground_see_more_light():
    bright, dark = rectangle(0.0, 9.0, -9.0, 9.0, -0.6), rectangle(-9.0, 0.0, -9.0, 9.0, -0.6)
    seen = see_surfaces([Surface(bright.triangles, "bright", reflectance=1.0), dark], EYE)
    sky = SurfaceViews(seen, EYE, CORNERS).environment(seen.reflectance, "ground")
    fluence = sky.fluence().mean() * sky.weight(np.array([[-0.4, 0.0, -0.4], [0.4, 0.0, -0.4]]))
    # The plane x = 0 divides what is seen below at the angle of its slope.
    slope = np.arctan2(0.4, 0.2)
    assert fluence == pytest.approx([np.pi - 2.0 * slope, np.pi + 2.0 * slope], rel=0.15)


def test_black_surfaces_are_no_light():
    seen = see_surfaces([rectangle(-1.0, 1.0, -1.0, 1.0, -0.7)], EYE)
    assert SurfaceViews(seen, EYE, CORNERS).environment(seen.emission, "ground") is None


def test_a_lattice_of_weights_is_linear_within_and_constant_beyond():
    x, y, z = np.meshgrid(*[np.arange(4.0)] * 3, indexing="ij")
    low, high = np.array([-1.0, 0.0, 2.0]), np.array([2.0, 6.0, 5.0])
    weight = PlaceLattice(low, high, (1.0 + x + 2.0 * y - 0.5 * z).astype(np.float32))
    points = np.array([[0.3, 1.4, 3.7], [-1.0, 6.0, 5.0], [9.0, 6.5, 5.5]])
    index = (np.clip(points, low, high) - low) / (high - low) * 3.0
    assert weight(points) == pytest.approx(1.0 + index @ [1.0, 2.0, -0.5], rel=1e-5)
    again = PlaceLattice(low.copy(), high.copy(), weight.values.copy())
    assert again == weight and hash(again) == hash(weight)
    assert PlaceLattice(low, high, 2.0 * weight.values) != weight
