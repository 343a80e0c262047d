# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive interpolation: pixels that take their multiple scattering from their neighbours."""

from dataclasses import replace

import numpy as np
import pytest

from inference import Camera, Environment, Medium, SceneError, Settings, Sun, Volume, render
from inference.image.adaptive_interpolation import FAINT, LEVELS, Guide, Squares, interpolable
from inference.plan.plan import make_plan, make_tiles
from inference.plan.resolution import BAND
from inference.scene.optimizations import ALL
from tests.support.volumes import SUN, camera, cloud

WINDOWS = [(0, 0, 40, 70), (3, 5, 31, 62), (0, 0, 4, 4), (7, 30, 8, 90), (0, 33, 5, 38)]


STRIDES = [stride for stride, _ in LEVELS]


@pytest.mark.parametrize("stride", STRIDES)
@pytest.mark.parametrize("window", WINDOWS)
def test_pixels_are_evaluated_or_lie_between_evaluated_ones(window, stride):
    squares = Squares(window, stride)
    shared = np.ones(squares.known.shape[1], bool)
    look, between = squares.known_pixels(), squares.interior(shared)
    inside = np.zeros(squares.size, bool)
    inside[squares.pixels] = True
    np.testing.assert_array_equal(look ^ between, inside)
    assert not np.any(look & between)
    # No square leaves the window, its band, or its place in the whole image.
    width = window[2] - window[0]
    row, column = squares.pixels // width + window[1], squares.pixels % width + window[0]
    assert np.all(np.ptp(column, axis=0) == stride) and np.all(np.ptp(row, axis=0) == stride)
    assert np.all(np.ptp(row // BAND, axis=0) == 0) and np.all(np.ptp(column // BAND, axis=0) == 0)
    assert np.all(column[0] % BAND % stride == 0)


def test_pixels_outside_interpolated_squares_are_evaluated():
    """So are those on an edge between an interpolated square and one that is not."""
    squares = Squares((0, 0, 9, 9), 4)
    between = squares.interior(np.array([True, False, True, True])).reshape(9, 9)
    assert between[1:4, 4].sum() == 0 and between[4, 5:8].sum() == 0
    assert between[4, 1:4].all() and between[1, 1:4].all() and not between[:4, 5:].any()


def test_squares_with_known_corners_or_middles_are_skipped():
    squares = Squares((0, 0, 9, 9), 4)
    settled = np.zeros(81, bool)
    # A corner of two squares, another's middle, and a pixel on an edge.
    settled[[4, 6 * 9 + 2, 5 * 9 + 4]] = True
    np.testing.assert_array_equal(squares.without(settled).pixels, squares.pixels[:, 3:])


@pytest.mark.parametrize("stride", STRIDES)
def test_linear_functions_are_interpolated_exactly(stride):
    squares = Squares((2, 3, 45, 60), stride)
    y, x = np.mgrid[3:60, 2:45].astype(np.float32)
    values = (5.0 + 0.25 * x - 0.5 * y + 40.0).ravel()
    shared = np.ones(squares.known.shape[1], bool)
    between = squares.interior(shared)
    found = np.where(between, np.float32(np.nan), values)
    squares.fill(found, between)
    np.testing.assert_allclose(found, values, rtol=1e-6)
    assert squares.centre_error(values).max() < 1e-4
    assert squares.deviation(Guide(values, values), np.ones_like(values)).max() < 1e-6


def test_only_squares_whose_middles_are_predicted_are_interpolated():
    squares = Squares((0, 0, 21, 21), 4)
    ones = np.ones(21 * 21, np.float32)
    mean, dark = ones.copy(), 0.0 * ones
    mean[squares.known[4, 7]] = 1.2
    shared, surprise = interpolable(squares, mean, dark, ones, dark, Guide(ones, ones), 0.03 * ones)
    assert list(np.flatnonzero(~shared)) == [7] and surprise[7] == pytest.approx(0.2)
    # Differences at low opacity, beside much more light, or within the noise do not count.
    assert interpolable(squares, mean, dark, 0.1 * ones, ones, Guide(ones, ones), 0.03 * ones)[0].all()
    assert interpolable(squares, mean, 0.25 * ones, ones, dark, Guide(ones, ones), 0.07 * ones)[0].all()
    assert not interpolable(squares, mean, 9.0 * ones, ones, dark, Guide(ones, ones), 0.03 * ones)[0].all()
    mean[squares.known[4, 7]] = 1.02
    assert interpolable(squares, mean, dark, ones, dark, Guide(ones, ones), 0.03 * ones)[0].all()
    assert not interpolable(squares, mean, dark, ones, dark, Guide(ones, ones), 0.01 * ones)[0].all()
    # A shadow's edge between evaluated pixels.
    ahead = ones.copy()
    ahead[squares.pixels[2, 3]] = 0.3
    shadow = Guide(ahead, ones)
    assert list(np.flatnonzero(~interpolable(squares, ones, dark, ones, dark, shadow, 0.03 * ones)[0])) == [3]
    # A centre that does not show the volume tells nothing.
    opacity = ones.copy()
    opacity[squares.known[4, 12]] = 0.0
    shown, even = squares.of(opacity > 0.0), Guide(ones, ones)
    assert list(np.flatnonzero(~interpolable(shown, ones, dark, opacity, dark, even, 0.03 * ones)[0])) == [12]


def test_squares_that_show_no_volume_are_left_out():
    random = np.random.default_rng(6)
    shown = np.zeros((60, 45), bool)
    shown[20:31, 3:18] = random.random((11, 15)) < 0.1
    for stride in STRIDES:
        squares = Squares((2, 3, 47, 63), stride)
        found = squares.of(shown.ravel())
        np.testing.assert_array_equal(found.pixels, squares.pixels[:, squares.any(shown.ravel())])
        np.testing.assert_array_equal(found.seen, shown.ravel()[found.known])


def test_corners_beside_a_silhouette_count_as_the_mean_of_the_others():
    squares = Squares((0, 0, 9, 9), 4)
    shown = np.ones((9, 9), bool)
    shown[:, 7:] = False
    values = np.where(shown, 3.0, 99.0).ravel()
    squares = squares.of(shown.ravel())
    np.testing.assert_allclose(squares.known_values(values)[:, squares.judged()], 3.0)
    # Two corners and the centre of a square on the silhouette are seen.
    assert squares.judged().all() and not squares.seen.all()
    squares.fill(values, shown.ravel())
    np.testing.assert_allclose(values[shown.ravel()], 3.0)
    shown[:, 5:] = shown[:3, :] = False
    assert not Squares((0, 0, 9, 9), 4).of(shown.ravel()).judged()[0]


def test_faint_pixels_may_be_as_wrong_as_less_faint_ones():
    squares = Squares((0, 0, 21, 21), 4)
    ones = np.ones(21 * 21, np.float32)
    mean, dark = ones.copy(), 0.0 * ones
    mean[squares.known[4, 7]] = 1.2
    for alpha, smooth in ((1.0, False), (FAINT, False), (0.1 * FAINT, True)):
        assert interpolable(squares, mean, dark, alpha * ones, dark, Guide(ones, ones), 0.1 * ones)[0][7] == smooth


@pytest.fixture(scope="module")
def close():
    """A view of a cloud in which a voxel covers many pixels."""
    return [(cloud(), Medium(30.0, (0.9, 0.95, 1.0), 0.5))], [SUN], camera(resolution=(150, 110), fov=0.3)


@pytest.mark.slow
def test_interpolation_saves_predictions_and_keeps_the_picture(close):
    """Two thirds of them here; its error is below that of so few depth samples, and reported."""
    every = render(*close, Settings(4, optimizations=ALL - {"shared_pixels"}))
    shared = render(*close, Settings(4))
    many = render(*close, Settings(32, optimizations=ALL - {"shared_pixels"}))
    assert shared.report.counts["network points"] < 0.35 * every.report.counts["network points"]
    for name in ("single", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(shared, name), getattr(every, name))
    shown = every.alpha > 0.02

    def error(a, b):
        return np.sqrt(np.mean((a - b)[shown] ** 2)) / many.rgb[shown].mean()

    assert error(shared.rgb, many.rgb) < 1.1 * error(every.rgb, many.rgb)
    assert error(shared.rgb, many.rgb) < error(shared.sampling_error, 0.0)
    assert abs((shared.rgb - every.rgb)[shown].mean()) < 0.003 * every.rgb[shown].mean()


@pytest.mark.parametrize("tolerance", [0.5, 17.0, np.nan])
def test_tolerances_out_of_range_are_refused(tolerance):
    with pytest.raises(SceneError, match="the tolerance must be from 1 to 16"):
        Settings(tolerance=tolerance)


def test_more_pixels_are_interpolated_the_more_error_is_tolerated():
    scene = [(cloud(), Medium(30.0, 0.9, 0.5))], [SUN], camera(resolution=(66, 66), fov=0.3)
    whole = replace(Settings(4), optimizations=ALL - {"level_of_detail"})
    layers = [render(*scene, replace(whole, tolerance=tolerance)) for tolerance in (1.0, 2.0, 4.0)]
    points = [layer.report.counts["network points"] for layer in layers]
    assert points == sorted(points, reverse=True) and points[2] < 0.8 * points[0]
    usual, shown = layers[0], layers[0].alpha > 0.02
    for layer in layers[1:]:
        assert np.sqrt(np.mean((layer.rgb - usual.rgb)[shown] ** 2)) < 0.05 * usual.rgb[shown].mean()


def test_light_of_an_environment_is_interpolated_where_distances_are_smooth():
    """Towards a sphere before a wall, of a density at which a voxel is opaque."""
    x, y, z = np.indices((48, 48, 48)) / 47.0 - 0.5
    density = ((x**2 + y**2 + (z - 0.3) ** 2 < 0.03) | (z < -0.3)).astype(np.float32)
    matrix = np.diag([1 / 48] * 3 + [1.0])
    matrix[:3, 3] = 0.5 / 48 - 0.5
    height = np.linspace(1.0, -1.0, 16)[:, None, None] * np.ones((1, 32, 3))
    sky = Environment(np.maximum(1.0 + height, 0.1).astype(np.float32))
    scene = [(Volume(density, matrix, "sphere"), Medium(400.0, 0.9, 0.8))], [sky], camera(resolution=(160, 160))
    every, shared = (
        render(*scene, Settings(4, optimizations=optimizations)) for optimizations in (ALL - {"shared_pixels"}, ALL)
    )
    assert shared.report.counts["network points"] < 0.8 * every.report.counts["network points"]
    shown = every.alpha > 0.02
    off = np.sqrt(np.mean((shared.rgb - every.rgb)[shown] ** 2))
    assert off < 0.03 * every.rgb[shown].mean()


def test_pixels_larger_than_voxels_are_all_evaluated():
    scene = [(cloud(), Medium(30.0, 0.9, 0.5))], [SUN]
    small, large = (render(*scene, camera(resolution=(n, n)), Settings(2)).report.counts for n in (12, 120))
    assert small["network points"] == small["network points wanted"]
    assert large["network points"] < large["network points wanted"]


def test_a_region_shows_what_the_whole_image_shows(close):
    """Squares lie where they lie in the whole image; those cut by the region's border are evaluated."""
    volumes, suns, whole = close
    picture = render(*close, Settings(4)).rgb
    part = render(volumes, suns, replace(whole, region=(33, 33, 132, 99)), Settings(4)).rgb
    np.testing.assert_array_equal(part, picture[33:99, 33:132])


def test_a_sharp_step_in_a_volume_stays_sharp():
    """A dense and a thin half of a box, whose border lies between evaluated pixels."""
    density = np.full((32, 32, 32), 0.05, np.float32)
    density[16:] = 1.0
    matrix = np.diag([1 / 32] * 3 + [1.0])
    matrix[:3, 3] = 0.5 / 32 - 0.5
    view = Camera(
        np.array([[1, 0, 0, 0.01], [0, 1, 0, 0], [0, 0, 1, 3.0], [0, 0, 0, 1]]),
        "orthographic",
        (101, 101),
        ortho_scale=1.1,
    )
    scene = [(Volume(density, matrix, "halves"), Medium(40.0, 1.0, 0.5))], [Sun((0.3, 0.5, 0.8))], view
    every, shared = (
        render(*scene, Settings(8, optimizations=optimizations)) for optimizations in (ALL - {"shared_pixels"}, ALL)
    )
    assert shared.report.counts["network points"] < 0.6 * every.report.counts["network points"]
    off = np.abs(shared.rgb - every.rgb).mean(axis=2)
    assert off.max() < 0.1 * every.rgb[every.alpha > 0.02].mean()


def test_a_thread_that_renders_alone_has_the_largest_tiles():
    alone, shared = (
        make_plan([(cloud(), Medium(30.0))], [SUN], camera(resolution=(128, 128)), Settings(threads=threads)).tiles
        for threads in (1, 2)
    )
    assert len(alone) == 1 < len(shared)


@pytest.mark.parametrize("window", [(0, 0, 500, 300), (7, 40, 500, 41), (32, 33, 100, 66)])
@pytest.mark.parametrize("bands", [1, 2, 50])
def test_tiles_are_whole_bands(window, bands):
    x0, y0, x1, y1 = window
    times = np.zeros((y1, x1), int)
    for left, top, right, bottom in make_tiles(window, bands):
        times[top:bottom, left:right] += 1
        assert left in (x0, left // BAND * BAND) and top in (y0, top // BAND * BAND)
        assert right - left <= bands * BAND and bottom - top <= bands * BAND
    assert np.all(times[y0:, x0:] == 1) and times.sum() == (x1 - x0) * (y1 - y0)
