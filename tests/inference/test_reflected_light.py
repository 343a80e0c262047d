# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that surfaces throw back or emit into volumes."""

import numpy as np
import pytest

import training.rpnn  # noqa: F401  Lets settings name it.
from inference import (
    Environment,
    Medium,
    PointLight,
    RenderCache,
    SceneError,
    Settings,
    SpotLight,
    Sun,
    Surface,
    render,
)
from inference.image.reflected_light import open_volume
from inference.occluders.seen_surfaces import open_sky, see_surfaces, vantage
from inference.scene.environment import PlaceLattice
from tests.support.surfaces import rectangle, room
from tests.support.volumes import box, camera, cloud

CLOUD, CACHE = cloud(voxels=32), RenderCache()
MEDIUM, SETTINGS = Medium(8.0, 0.9, 0.4), Settings(depth_samples=4)
DOWN = Sun((0.0, 0.0, 1.0), 2.0)


def ground(reflectance=0.0, emission=0.0, z=-0.7, size=8.0):
    """A square below the cloud, seen from above."""
    triangles = rectangle(-size, size, -size, size, z).triangles
    return Surface(triangles, "ground", reflectance=reflectance, emission=emission)


def picture(lights, surfaces, settings=SETTINGS):
    return render([(CLOUD, MEDIUM)], lights, camera(), settings, None, None, CACHE, surfaces)


@pytest.mark.parametrize(
    "values", [{"reflectance": -0.1}, {"reflectance": 1.2}, {"reflectance": np.nan}, {"emission": -1.0}]
)
def test_bad_surfaces_are_refused_by_name(values):
    with pytest.raises(SceneError, match=f"wall: {next(iter(values))}"):
        Surface(np.zeros((1, 3, 3)), "wall", **values)


def test_all_directions_below_show_the_ground():
    seen = see_surfaces([ground(0.3, z=-1.0, size=100.0)], np.array([0.2, 0.1, 0.0]))
    assert seen.points[:, 2] == pytest.approx(-1.0)
    assert seen.normals == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(seen.points), 1)))
    assert seen.solid_angles.sum() == pytest.approx(2.0 * np.pi, rel=0.03)
    assert np.all(seen.reflectance == 0.3)


def test_the_nearest_of_several_surfaces_is_seen():
    near, far = ground(0.2, z=-1.0, size=1.0), ground(0.7, z=-2.0, size=100.0)
    seen = see_surfaces([far, near], np.zeros(3))
    under = np.abs(seen.points[:, :2]).max(axis=1) < 0.99
    assert np.all(seen.reflectance[under & (seen.points[:, 2] > -1.5)] == 0.2)
    assert set(np.unique(seen.reflectance)) == {0.2, 0.7}
    assert not np.any(under & (seen.points[:, 2] < -1.5) & (np.abs(seen.points[:, :2]).max(axis=1) < 0.9))


def test_glowing_ground_is_an_environment_from_below():
    half = np.zeros((16, 32, 3), np.float32)
    half[8:] = 0.5
    glow = picture([], [ground(emission=0.5, size=1000.0)])
    dome = picture([Environment(half)], [])
    for name in ("single", "multiple"):
        one, other = getattr(glow, name), getattr(dome, name)
        assert one.mean() == pytest.approx(other.mean(), rel=0.03)


def test_black_surfaces_throw_nothing_back():
    black, plain = (picture([DOWN], [ground(reflectance)]) for reflectance in (0.0, 0.5))
    assert black.report.counts["environments"] == 0 and plain.report.counts["environments"] == 1
    assert plain.rgb.mean() > 1.1 * black.rgb.mean()


def test_a_spot_that_shines_away_throws_no_light_back():
    down, up = (
        [picture([SpotLight((0.0, 0.0, 1.0), (0.0, 0.0, z), 50.0, 0.5)], [ground(value)]) for value in (0.5, 0.0)]
        for z in (-1.0, 1.0)
    )
    assert down[0].rgb.mean() > 1.01 * down[1].rgb.mean()
    np.testing.assert_array_equal(up[0].rgb, up[1].rgb)


def test_a_sun_on_a_closed_roof_throws_no_light_below():
    walls = room((-3.0, -3.0, -0.8), (3.0, 3.0, 2.0), reflectance=0.8, covers=False)
    below = picture([DOWN], [walls])
    assert below.rgb.max() < 1e-3 * picture([DOWN], [ground(0.8)]).rgb.max()


def test_light_of_surfaces_is_linear_in_the_suns():
    one, three = (picture([Sun(DOWN.direction, power)], [ground((0.5, 0.2, 0.1))]).rgb for power in (1.0, 3.0))
    assert three == pytest.approx(3.0 * one, rel=1e-4, abs=1e-5 * three.max())


@pytest.mark.slow
def test_light_of_surfaces_adds_up():
    lights = [DOWN, PointLight((0.3, 0.2, 0.9), 5.0), Environment(np.full((8, 16, 3), 0.1, np.float32))]
    alone = sum(picture([light], [ground(0.6)]).rgb for light in lights)
    together = picture(lights, [ground(0.6)]).rgb
    assert np.abs(alone - together).max() < 0.01 * together.max()


@pytest.mark.parametrize("half", [1.5, 0.8, 0.6])
def test_a_closed_room_is_as_bright_as_its_walls_throw_light_at_one_another(half):
    # In a furnace all radiance is what walls emit over what they take; smoke that takes nothing is that bright, too.
    walls = room((-half,) * 3, (half,) * 3, reflectance=0.6, emission=0.2, covers=False)
    layer = render([(CLOUD, Medium(8.0, 1.0, 0.4))], [], camera(), SETTINGS, None, None, CACHE, [walls])
    seen = layer.alpha > 0.5
    assert (layer.rgb[seen] / layer.alpha[seen][:, None]).mean() == pytest.approx(0.2 / (1.0 - 0.6), rel=0.05)


@pytest.mark.parametrize("window", [0.3, 0.9])
def test_a_room_is_as_bright_as_what_enters_by_its_window(window):
    """The power that walls absorb and that leaves is what an even World of radiance 1 sends in."""
    half, reflectance = 1.5, 0.5
    closed = room((-half,) * 3, (half,) * 3).triangles
    walls = closed[~np.all(closed[:, :, 2] == half, axis=1)]
    beside = [
        rectangle(*ends, half).triangles
        for ends in (
            (-half, -window, -half, half),
            (window, half, -half, half),
            (-window, window, -half, -window),
            (-window, window, window, half),
        )
    ]
    triangles, smoke = np.concatenate([walls, *beside]), [(CLOUD, Medium(0.5, 1.0))]
    sky, lit = Environment(np.ones((8, 16, 3), np.float32)), []
    for value in (0.0, reflectance):
        surface = Surface(triangles, "room", reflectance=value, covers=False)
        lit.append(render(smoke, [sky], camera(), SETTINGS, None, None, CACHE, [surface]))
    black, grey = lit
    seen = grey.alpha > 0.05
    found = ((grey.rgb - black.rgb)[seen] / grey.alpha[seen][:, None]).mean()
    hole, whole = (2.0 * window) ** 2, 6.0 * (2.0 * half) ** 2
    expected = reflectance * hole / ((whole - hole) * (1.0 - reflectance) + hole)
    # As a mean over the walls; the middle sees where the light falls first a little brighter.
    assert 0.7 < found / expected < 1.6


def test_ground_reflects_its_colour():
    layer = picture([DOWN], [ground((1.0, 0.5, 0.0))])
    black = picture([DOWN], [ground()])
    more = (layer.rgb - black.rgb).mean(axis=(0, 1))
    assert more[0] > 1.8 * more[1] > 0.0 and more[2] == pytest.approx(0.0, abs=1e-3 * more[0])


def test_a_network_that_knows_suns_alone_names_what_it_leaves_out():
    layer = picture([DOWN], [ground(0.5)], Settings(model="rpnn", depth_samples=1))
    assert any("light of ground" in sentence for sentence in layer.report.left_out)


def test_even_light_over_a_mirror_of_itself_is_even_light():
    """White ground far below in an even World: as bright as the World, but for what the cloud takes."""
    even = Environment(np.ones((8, 16, 3), np.float32))
    with_ground = picture([even], [ground(1.0, z=-40.0, size=4000.0)])
    without = picture([even], [])
    assert with_ground.rgb.mean() == pytest.approx(without.rgb.mean(), rel=0.01)


@pytest.mark.parametrize("z", [-0.7, -0.2])
def test_white_ground_and_white_smoke_in_even_light_are_even_light(z):
    """The white furnace: nothing absorbs, so that every place is as bright as the World."""
    even, white = Environment(np.ones((8, 16, 3), np.float32)), Medium(20.0, 1.0, 0.4)
    white_ground = [ground(1.0, z=z, size=100.0)]
    layer = render([(CLOUD, white)], [even], camera(), SETTINGS, None, None, CACHE, white_ground)
    shown = layer.alpha > 0.1
    assert layer.rgb[shown].sum() / (3.0 * layer.alpha[shown].sum()) == pytest.approx(1.0, abs=0.05)


def test_smoke_is_brighter_over_the_bright_part_of_the_ground():
    bright, dark = rectangle(0.0, 8.0, -8.0, 8.0, -0.2), rectangle(-8.0, 0.0, -8.0, 8.0, -0.2)
    black = picture([DOWN], [ground(z=-0.2)]).rgb
    added = picture([DOWN], [Surface(bright.triangles, "bright", reflectance=0.8), dark]).rgb - black
    left, right = np.array_split(added.sum(axis=2), 2, axis=1)
    assert right.sum() > 1.5 * left.sum() > 0.0


def test_flat_ground_does_not_shade_itself():
    """But a wall that stands on it does, below a sun behind the wall."""
    slant, wall = Sun((-1.0, 0.0, 1.0), 2.0), rectangle(-9.0, 9.0, -9.0, 9.0, -0.8)
    upright = Surface(np.roll(wall.triangles, 1, axis=2), "wall")
    lit, shaded = (picture([slant], [ground(0.8), *more]).rgb.mean() for more in ((), (upright,)))
    black = picture([slant], [ground(), upright]).rgb.mean()
    assert shaded - black < 0.2 * (lit - black)


def test_ground_hides_the_sky_below_it():
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    sky = open_sky([ground(size=1000.0)], corners, np.zeros(3))
    assert sky.visibility is None
    assert sky.fraction[:15].min() == 1.0 and sky.fraction[17:].max() == 0.0
    hidden = sky.behind(Environment(np.ones((4, 8, 3), np.float32)))
    assert np.all(hidden.radiance[:2] == 1.0) and np.all(hidden.radiance[2:] == 0.0)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_ground_above_the_middle_is_seen_from_the_cameras_side(projection):
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    view = camera(projection=projection)
    assert vantage([ground(z=-0.1)], corners, view) == pytest.approx(np.zeros(3))
    assert vantage([ground(z=0.1)], corners, view)[2] == pytest.approx(0.25)
    assert vantage([ground(z=0.6)], corners, view) is None


def test_even_light_passes_a_mesh_in_the_middle():
    even = Environment(np.ones((8, 16, 3), np.float32))
    cube = Surface(
        np.concatenate(
            [rectangle(-0.05, 0.05, -0.05, 0.05, z).triangles for z in (-0.05, 0.05)]
            + [
                np.roll(rectangle(-0.05, 0.05, -0.05, 0.05, z).triangles, k, axis=2)
                for k in (1, 2)
                for z in (-0.05, 0.05)
            ]
        ),
        "cube",
    )
    with_cube, without = picture([even], [cube]), picture([even], [])
    assert with_cube.rgb.mean() == pytest.approx(without.rgb.mean(), rel=0.15)


def test_places_below_the_edge_of_a_roof_see_different_skies():
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    roof = rectangle(-9.0, 0.0, -9.0, 9.0, 0.6)
    visibility = open_sky([roof], corners, np.zeros(3)).visibility
    places = np.array([[-0.25, 0.0, 0.25], [0.25, 0.0, 0.25], [0.25, 0.0, -0.25]])
    above = visibility.directions[:, 2] > 0.0
    open_to = visibility.towards(places)[:, above].mean(axis=1)
    # Of the upper half of the sphere, the angle between the roof's edge and the opposite horizon.
    assert open_to == pytest.approx(0.5 + np.arctan2(places[:, 0], 0.6 - places[:, 2]) / np.pi, abs=0.06)
    assert visibility.towards(places)[:, ~above].min() > 0.999
    assert visibility(places) == pytest.approx(0.5 * (1.0 + open_to), abs=1e-6)


def test_light_that_reaches_places_in_parts_is_the_same_light():
    light = np.random.default_rng(0).uniform(0.0, 1.0, (8, 16, 3)).astype(np.float32)
    low, high, ends = np.full(3, -0.3), np.full(3, 0.2), np.float32([[1.0, 0.0], [0.0, 1.0]])
    weights = [x[:, None, None] * z * np.ones((1, 2, 1), np.float32) for x in ends for z in ends]
    parts = [Environment(light, weight=PlaceLattice(low, high, weight)) for weight in weights]
    settings = Settings(depth_samples=4, light_paths=False)
    whole, divided = picture([Environment(light)], [], settings), picture(parts, [], settings)
    assert divided.rgb == pytest.approx(whole.rgb, rel=2e-3, abs=2e-3 * whole.rgb.max())
    half = picture(parts[:2], []).rgb.sum(axis=2)
    left, right = np.array_split(half, 2, axis=1)
    assert min(left.sum(), right.sum()) < 0.6 * max(left.sum(), right.sum())


def test_volumes_are_opened_where_surfaces_hide_them():
    volume = box(voxels=16)
    opened = open_volume(volume, [ground(z=-0.2, size=9.0)], np.zeros(3))
    heights = (np.arange(16) + 0.5) / 16 - 0.5
    assert not opened.density[:, :, heights < -0.22].any()
    assert opened.density[:, :, heights > -0.1].min() > 0.9
