# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps: what they give to points, and the laws that pictures lit by them obey."""

from dataclasses import replace

import numpy as np
import pytest

from inference import (
    AreaLight,
    Camera,
    Environment,
    Medium,
    PointLight,
    RenderCache,
    SceneError,
    Settings,
    SpotLight,
    Sun,
    Surface,
    predict_multiple,
    render,
)
from inference.features.density_reader import DensityReader
from inference.grids.grid import Grid
from inference.network.ray_predictor import RayPredictor
from inference.scene.camera_rays import camera_rays
from inference.scene.emitters import solid_angles
from inference.scene.optimizations import ALL, OPTIMIZATIONS
from tests.support.volumes import box, camera, cloud, integrals_of_density

FAINT = {"faint_lamps"}
CLOUD, CACHE = cloud(voxels=32), RenderCache()
TOWARDS = np.array([0.4, 0.3, 0.8]) / np.linalg.norm([0.4, 0.3, 0.8])
#: Everything exact, so that only the light differs.
EXACT = Settings(depth_samples=8, optimizations=frozenset({"empty_space", "equal_channels"}))


def placed(position, direction=(0.0, 0.0, -1.0), scale=1.0):
    """Matrix of an area light at a position that shines along a direction."""
    z = -np.array(direction) / np.linalg.norm(direction)
    x = np.cross([0.3, 1.0, 0.2], z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1) * scale, position
    return matrix


def picture(lights, sigma=8.0, albedo=1.0, anisotropy=0.4, surfaces=(), settings=EXACT, volume=CLOUD):
    return render(
        [(volume, Medium(sigma, albedo, anisotropy))], lights, camera(), settings, None, None, CACHE, surfaces
    )


LAMPS = {
    "point": lambda power=5.0: PointLight((0.9, 0.6, 0.5), power),
    "sphere": lambda power=5.0: PointLight((0.8, 0.4, 0.5), power, 0.3),
    "inside": lambda power=5.0: PointLight((0.1, -0.05, 0.12), power),
    "spot": lambda power=5.0: SpotLight((0.9, 0.6, 0.5), (-0.9, -0.6, -0.5), power, 0.5, 0.4),
    "area": lambda power=5.0: AreaLight(
        placed((0.7, 0.5, 0.6), (-0.7, -0.5, -0.6)), "rectangle", (0.6, 0.3), power, 2.0
    ),
}


FAR = 300.0
ASIDE = np.cross(TOWARDS, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(TOWARDS, [0.0, 0.0, 1.0]))
#: Of irradiance 2 in the middle: a point, and an area light that shines 60 degrees past the volume.
FAR_LAMPS = {
    "point": PointLight(FAR * TOWARDS, 8.0 * np.pi * FAR**2),
    "area light from the side": AreaLight(
        placed(FAR * TOWARDS, -0.5 * TOWARDS + np.sqrt(0.75) * ASIDE), "square", 1.0, 4.0 * np.pi * FAR**2
    ),
}


@pytest.mark.parametrize(
    "make, problem",
    [
        (lambda: PointLight((0, np.nan, 0), 1.0, name="bulb"), "position"),
        (lambda: PointLight((0, 0, 0), -1.0, name="bulb"), "power"),
        (lambda: PointLight((0, 0, 0), (1.0, np.inf, 1.0), name="bulb"), "power"),
        (lambda: PointLight((0, 0, 0), 1.0, -0.1, name="bulb"), "radius"),
        (lambda: PointLight((0, 0, 0), 1.0, np.nan, name="bulb"), "radius"),
        (lambda: SpotLight((0, 0, 0), (0, 0, 0), 1.0, 1.0, name="bulb"), "direction"),
        (lambda: SpotLight((0, 0, 0), (0, 0, 1), 1.0, 0.0, name="bulb"), "angle"),
        (lambda: SpotLight((0, 0, 0), (0, 0, 1), 1.0, 1.0, 1.5, name="bulb"), "blend"),
        (lambda: AreaLight(np.eye(4), "star", 1.0, 1.0, name="bulb"), "shape"),
        (lambda: AreaLight(np.eye(4), "disk", 0.0, 1.0, name="bulb"), "size"),
        (lambda: AreaLight(np.eye(4), "disk", 1.0, 1.0, -1.0, name="bulb"), "spread"),
        (lambda: AreaLight(np.diag([1.0, 0.0, 1.0, 1.0]), "disk", 1.0, 1.0, name="bulb"), "scaled to nothing"),
    ],
)
def test_bad_lamps_are_refused_by_name(make, problem):
    with pytest.raises(SceneError, match=f"bulb.*{problem}"):
        make()


def fluence(lamp, points, low=-0.5, high=0.5):
    emitters = lamp.emitters(np.full(3, low), np.full(3, high))
    return sum(emitter.fluence(np.atleast_2d(np.array(points, float))) for emitter in emitters)


def test_a_point_light_obeys_the_inverse_square():
    points = np.array([[0.0, 0.0, 2.0], [3.0, 0.0, 0.0]])
    assert fluence(PointLight((0, 0, 0), 1.0), points) == pytest.approx([1 / (16 * np.pi), 1 / (36 * np.pi)])


def test_a_sphere_appears_under_its_solid_angle():
    # Radiance I / (pi r^2) from the solid angle 2 pi (1 - cos a); all around within.
    radiance = 1.0 / (4 * np.pi) / (np.pi * 0.5**2)
    found = fluence(PointLight((0, 0, 0), 1.0, 0.5), [[0.0, 0.8, 0.0], [0.1, 0.2, 0.0]])
    outside = 2 * np.pi * (1 - np.sqrt(1 - (0.5 / 0.8) ** 2)) * radiance
    assert found == pytest.approx([outside, 4 * np.pi * radiance])


@pytest.mark.parametrize(
    "shape, size", [("square", 0.8), ("rectangle", (0.9, 0.4)), ("disk", 0.8), ("ellipse", (1, 0.5))]
)
@pytest.mark.parametrize("spread", [np.pi, 1.0])
def test_area_lights_give_what_their_points_give(shape, size, spread):
    lamp = AreaLight(placed((0.1, 0.2, 0.9), scale=1.1), shape, size, 1.0, spread)
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (40, 3))
    expected = _sum_over_points(lamp, points, spread)
    assert fluence(lamp, points) == pytest.approx(
        expected, rel=0.02 if spread > 3 else 0.2, abs=(0.01 if spread > 3 else 0.05) * expected.max()
    )
    behind = fluence(lamp, [[0.1, 0.2, 1.2]])
    assert behind == 0.0


def _sum_over_points(lamp, points, spread, count=200):
    place = (np.arange(count) + 0.5) / count - 0.5
    x, y = (values.ravel() for values in np.meshgrid(place, place))
    if lamp.shape in ("disk", "ellipse"):
        x, y = (values[x**2 + y**2 < 0.25] for values in (x, y))
    local = np.stack([x * lamp.size[0], y * lamp.size[1], 0 * x, 1 + 0 * x])
    source = (lamp.world_matrix @ local)[:3].T
    axis = -lamp.world_matrix[:3, 2] / np.linalg.norm(lamp.world_matrix[:3, 2])
    found = []
    for point in points:
        away = point - source
        distance = np.linalg.norm(away, axis=1)
        cosine = away @ axis / distance
        radiance = np.maximum(cosine, 0.0) / np.pi
        if spread < np.pi:
            tangent = np.sqrt(1 - cosine**2) / cosine
            half = np.tan(spread / 2)
            radiance = radiance * np.maximum(half - tangent, 0.0) / (half - spread / 2)
        found.append((radiance / distance**2).mean())
    return np.array(found)


@pytest.mark.parametrize("shape", ["rectangle", "disk"])
def test_solid_angles_from_four_edges_on_are_those_of_the_corners(shape):
    lamp = AreaLight(placed((0.0, 0.0, 0.0)), shape, (0.9, 0.6), 1.0)
    points = np.random.default_rng(1).normal(size=(200, 3))
    points[:, 2] = -np.abs(points[:, 2])
    for emitter in lamp.emitters(np.full(3, -3.0), np.full(3, -2.0)):
        away = points / np.linalg.norm(points, axis=1)[:, None] * np.sqrt(1.001 * emitter.far) + emitter.position
        corners = emitter.corners - away[:, None]
        exact = solid_angles(corners[:, :3]) + solid_angles(corners[:, [0, 2, 3]])
        assert emitter.fluence(away) == pytest.approx(emitter.radiance * exact, rel=5e-4)


@pytest.mark.parametrize("shape", ["square", "disk"])
@pytest.mark.parametrize("size, parts", [(0.04, 1), (0.2, 4), (0.6, 9), (2.0, 16)])
def test_area_lights_have_more_parts_the_larger_they_appear(shape, size, parts):
    lamp = AreaLight(placed((0.0, 0.0, 1.5)), shape, size, 1.0)
    emitters = lamp.emitters(np.full(3, -0.5), np.full(3, 0.5))
    assert len(emitters) == parts
    assert [emitter.area for emitter in emitters] == pytest.approx([lamp.area / parts] * parts)
    given = sum(emitter.radiance * emitter.area for emitter in emitters)
    assert given == pytest.approx(1.0 / np.pi)


def test_a_narrow_spread_makes_the_axis_brighter():
    # Of 60 degrees: tan(30) / (tan(30) - 30 degrees in radians).
    matrix, point = placed((0.0, 0.0, 1000.0)), [[0.0, 0.0, 0.0]]
    wide, narrow = (fluence(AreaLight(matrix, "disk", 1.0, 1.0, spread), point) for spread in (np.pi, np.pi / 3))
    assert narrow / wide == pytest.approx(10.74, abs=0.01)


def test_a_far_disk_is_a_point_of_its_intensity():
    # power / pi along the axis, four times that of a point light.
    disk = AreaLight(placed((0.0, 0.0, 50.0)), "disk", 0.5, 1.0)
    points = np.random.default_rng(2).uniform(-0.5, 0.5, (20, 3))
    assert fluence(disk, points) == pytest.approx(4.0 * fluence(PointLight((0, 0, 50.0), 1.0), points), rel=1e-3)


def test_a_spot_shines_as_bright_as_a_point_within_its_cone():
    spot = SpotLight((0, 0, 1), (0, 0, -1), 1.0, 0.8, 0.5)
    point = PointLight((0, 0, 1), 1.0)
    inside, outside = [[0.1, 0.0, 0.0]], [[0.5, 0.0, 0.0]]
    assert fluence(spot, inside) == pytest.approx(fluence(point, inside))
    assert fluence(spot, outside) == 0.0


@pytest.mark.parametrize("name", LAMPS)
@pytest.mark.parametrize("anisotropy", [0.0, 0.857])
def test_single_scattering_is_the_integral(name, anisotropy):
    lamp, sigma = LAMPS[name](), 8.0
    medium = Medium(sigma, 0.9, anisotropy)
    # Pixels around a lamp show means over their rays; small ones pass it at a distance.
    view = camera(resolution=(6, 4), fov=0.003 if name == "inside" else 0.3)
    layer = render([(CLOUD, medium)], [lamp], view, Settings(multiple=False))
    origins, directions, *_ = camera_rays(view)
    grid, expected = Grid(CLOUD), []
    for origin, direction in zip(origins, directions):
        distance = 2.3 + 1.4 * (np.arange(240) + 0.5) / 240
        points = origin + distance[:, None] * direction
        sigma_t = sigma * grid.sample_density(grid.index(points).T.astype(np.float32))
        before = np.cumsum(sigma_t) - 0.5 * sigma_t
        some = np.flatnonzero(sigma_t > 0.0)
        total = np.zeros(240)
        for source, power in _points_of(lamp):
            away = source - points[some]
            square = (away**2).sum(axis=1)
            cosine = away @ direction / np.sqrt(square)
            passed = np.exp(-sigma * integrals_of_density(grid, points[some], source, 60))
            total[some] += passed * medium.scattered(cosine) * power(points[some])
        expected.append((0.9 * sigma_t * np.exp(-before * 1.4 / 240) * total).sum() * 1.4 / 240)
    expected = np.array(expected)
    error = np.abs(layer.single.reshape(-1, 3)[:, 0] - expected).max() / expected.max()
    assert error < (0.02 if name in ("point", "inside", "spot") else 0.06)


def _points_of(lamp):
    """Points that stand for a lamp, with the fluence of each: the centres of its emitters where these are small."""
    if not isinstance(lamp, AreaLight):
        count = 20 if lamp.radius else 1
        height = 1 - 2 * (np.arange(count) + 0.5) / count
        angle = np.pi * (1 + 5**0.5) * np.arange(count)
        flat = np.sqrt(1 - height**2)
        sphere = np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)
        whole = lamp.emitters(np.full(3, -0.5), np.full(3, 0.5))
        # A cap of the sphere shines at a point; as the disk as which it appears, of the same mean position.
        for offset in sphere if lamp.radius else [np.zeros(3)]:
            yield (
                lamp.position + lamp.radius * np.sqrt(0.75) * offset,
                lambda points: sum(part.fluence(points) for part in whole) * lamp.power[0] / count,
            )
        return
    count = 4
    place = (np.arange(count) + 0.5) / count - 0.5
    axis = -lamp.world_matrix[:3, 2]
    for x in place * lamp.size[0]:
        for y in place * lamp.size[1]:
            source = (lamp.world_matrix @ [x, y, 0, 1])[:3]

            def power(points, source=source):
                away = points - source
                distance = np.linalg.norm(away, axis=1)
                cosine = away @ axis / distance
                half, tangent = np.tan(lamp.spread / 2), np.sqrt(1 - cosine**2) / cosine
                radiance = np.maximum(half - tangent, 0.0) / (half - lamp.spread / 2) / np.pi
                return lamp.power[0] * np.where(cosine > 0, radiance * cosine / distance**2, 0.0) / count**2

            yield source, power


def test_pixels_around_a_lamp_show_the_mean_of_their_light():
    # That of smaller pixels. The rays through the middles of pixels are 37 % wrong.
    lamp = PointLight((0.05, 0.02, 0.1), 5.0)
    volume, medium, settings = box(voxels=16), Medium(4.0, 0.9, 0.6), Settings(multiple=False)
    coarse, fine = (
        render([(volume, medium)], [lamp], camera(resolution=(size, size), fov=0.5), settings).single[..., 0]
        for size in (8, 80)
    )
    mean = fine.reshape(8, 10, 8, 10).mean(axis=(1, 3))
    assert np.abs(coarse - mean).max() < 0.03 * mean.max()


def test_a_lamp_in_its_step_leaves_no_spike():
    # A ray that passes closer to the lamp than its steps are long: the integral of the inverse square is pi / height.
    layer = render(
        [(box(voxels=32), Medium(1e-3, 1.0))],
        [PointLight((0.0, 1e-4, 0.0), 4 * np.pi)],
        Camera(camera().world_matrix, resolution=(1, 1), fov=1e-6),
        Settings(multiple=False),
    )
    assert layer.single[0, 0, 0] == pytest.approx(1e-3 * np.pi / 1e-4 / (4 * np.pi), rel=0.01)


@pytest.mark.parametrize("anisotropy", [0.0, 0.857])
@pytest.mark.parametrize("lamp", FAR_LAMPS.values(), ids=FAR_LAMPS)
def test_a_far_lamp_is_a_sun(lamp, anisotropy):
    sun = Sun(TOWARDS, 2.0)
    a, b = (picture([light], anisotropy=anisotropy) for light in (sun, lamp))
    for name in ("single", "multiple"):
        one, other = getattr(a, name), getattr(b, name)
        assert other.mean() == pytest.approx(one.mean(), rel=0.003)
        assert np.abs(one - other).max() < 0.02 * one.max()
    points = np.random.default_rng(4).normal(size=(60, 3)) * 0.15
    directions = np.tile([0.0, 0.0, -1.0], (60, 1))
    medium = Medium(8.0, 1.0, anisotropy)
    one, other = (predict_multiple(CLOUD, medium, light, points, directions) for light in (sun, lamp))
    assert np.abs(one - other).max() < 0.01 * one.max()


@pytest.mark.slow
@pytest.mark.parametrize("name", LAMPS)
def test_light_is_linear_in_power(name):
    one, other = (picture([LAMPS[name](power)]) for power in (3.0, 3.0 * 1024.0))
    assert one.rgb.max() > 0.0
    assert other.single == pytest.approx(1024.0 * one.single, rel=1e-6)
    assert other.multiple == pytest.approx(1024.0 * one.multiple, rel=1e-5, abs=1e-6 * other.multiple.max())


@pytest.mark.slow
def test_lights_add_up():
    settings = Settings(depth_samples=4, optimizations=frozenset({"empty_space", "equal_channels"}))
    lights = [
        Sun(TOWARDS, 0.5),
        LAMPS["inside"](),
        LAMPS["spot"](),
        Environment(np.full((2, 4, 3), 0.05, np.float32)),
    ]
    alone = sum(picture([light], settings=settings).rgb for light in lights)
    together = picture(lights, settings=settings).rgb
    assert np.abs(alone - together).max() < 1e-4 * together.max()


@pytest.mark.parametrize(
    "lamp",
    [PointLight((0.1, 0.05, 0.2), 3.0), LAMPS["inside"](), SpotLight((0.0, 0.0, 0.45), (0.2, 0.1, -1.0), 5.0, 0.6)],
)
def test_few_depth_samples_suffice_for_lamps_nearby(lamp):
    """Their light varies along rays within a fraction of what the samples of a sun's are apart."""
    few, many = (picture([lamp], anisotropy=0.8, settings=Settings(samples)).multiple for samples in (4, 128))
    assert np.sqrt(((few - many) ** 2).mean()) < 0.1 * many.mean()


def test_lamps_nearby_do_not_change_where_the_light_of_suns_is_sampled():
    sun, settings = Sun(TOWARDS, 0.5), Settings(depth_samples=4)
    dark = LAMPS["inside"](1e-30)
    # Beside lamps, no light is computed on larger cells.
    kept = replace(settings, optimizations=settings.optimizations - {"faint_lamps", "level_of_detail"})
    alone, beside = (picture(lights, settings=kept).multiple for lights in ([sun], [sun, dark]))
    np.testing.assert_allclose(beside, alone, rtol=1e-6, atol=1e-7 * alone.max())


def test_a_small_sphere_is_a_point():
    position = (0.9, 0.6, 0.5)
    point, sphere = (picture([PointLight(position, 5.0, radius)]).rgb for radius in (0.0, 1e-3))
    assert np.abs(point - sphere).max() < 1e-3 * point.max()


@pytest.mark.parametrize(
    "lamp",
    [
        SpotLight((1.5, 1.0, 0.8), (0.0, -1.0, 0.5), 5.0, 0.3, 0.1),
        AreaLight(placed((1.5, 1.0, 0.8), (1.5, 1.0, 0.8)), "square", 0.3, 5.0),
    ],
)
def test_a_lamp_that_shines_past_smoke_gives_it_nothing(lamp):
    layer = picture([lamp], sigma=1500.0, anisotropy=0.95, settings=Settings(4))
    assert not layer.rgb.any() and np.isfinite(layer.uncertainty).all()


def test_colours_follow_the_power():
    layer = picture([PointLight((0.9, 0.6, 0.5), (1.0, 0.5, 0.0))])
    assert layer.rgb[..., 1] == pytest.approx(0.5 * layer.rgb[..., 0], rel=1e-5)
    assert not layer.rgb[..., 2].any()


def test_a_lamp_without_power_is_left_out():
    layer = picture([PointLight((0.9, 0.6, 0.5), 1.0), PointLight((0.0, 0.9, 0.0), 0.0, name="bulb")])
    assert "bulb: its power is 0" in layer.report.left_out
    assert layer.report.counts["lamps"] == 1


@pytest.mark.parametrize("light", ["sun", "lamp", "environment"])
def test_faint_lamps_are_left_out_by_name(light):
    key = {
        "sun": Sun(TOWARDS, 1.0),
        "lamp": LAMPS["point"](),
        "environment": Environment(np.full((2, 4, 3), 0.1, np.float32)),
    }[light]
    lights = [
        key,
        PointLight((200.0, 0.0, 50.0), 9.0, name="far"),
        SpotLight((1, 0, 0), (-1, 0, 0), 1e-5, 1.0, name="weak"),
    ]
    optimizations = ALL - {"shared_pixels"}
    without, every = (
        picture(lights, settings=Settings(8, optimizations=names)) for names in (optimizations, optimizations - FAINT)
    )
    assert [text.partition(":")[0] for text in without.report.left_out if "too weak or too far" in text] == [
        "far",
        "weak",
    ]
    assert every.report.counts["lamps"] == without.report.counts["lamps"] + 2
    shown = every.alpha > 0.02
    change = np.sqrt(((without.rgb - every.rgb)[shown] ** 2).mean()) / every.rgb[shown].mean()
    assert 0.0 < change < OPTIMIZATIONS["faint_lamps"].budget


def test_faint_lamps_alone_are_not_left_out():
    faint = [PointLight((200.0, 0.0, 50.0), 9.0), PointLight((0.9, 0.6, 0.5), 1e-5)]
    assert picture(faint, settings=Settings(2, multiple=False)).report.counts["lamps"] == 2


@pytest.mark.filterwarnings("error")
def test_a_lamp_that_gives_the_middle_of_the_volume_nothing_is_not_faint():
    beside = SpotLight((0.3, 0.3, 2.0), (0.0, 0.0, -1.0), 1e10, 0.05)
    assert picture([beside], settings=Settings(2, multiple=False)).report.counts["lamps"] == 1


def test_surfaces_shadow_lamps():
    lamp = PointLight((0.0, 0.0, 1.5), 20.0)
    plate = np.array([[[-1, -2, 1.0], [0, -2, 1.0], [0, 2, 1.0]], [[-1, -2, 1.0], [0, 2, 1.0], [-1, 2, 1.0]]])
    lit = picture([lamp]).single
    shadowed = picture([lamp], surfaces=[Surface(plate, covers=False)]).single
    left, right = shadowed[:, :11], shadowed[:, 13:]
    assert left.max() < 0.02 * lit.max()
    assert right == pytest.approx(lit[:, 13:], rel=1e-5)


@pytest.mark.slow
def test_the_light_of_a_lamp_changes_steadily_as_it_enters_smoke():
    volume, settings, means = box(voxels=16), Settings(depth_samples=8), []
    for height in (0.54, 0.52, 0.50, 0.48, 0.46):
        layer = picture([PointLight((0.0, height, 0.0), 5.0)], 5.0, 0.9, 0.0, (), settings, volume)
        means.append(layer.multiple.mean())
    assert np.abs(np.diff(np.log(means))).max() < 0.3


def test_networks_read_nothing_of_lamps_inside(monkeypatch):
    volume, settings = box(voxels=16), Settings(depth_samples=4)
    medium, view = Medium(8.0, 0.9, 0.4), camera()
    expected = render([(volume, medium)], [LAMPS["inside"]()], view, settings).multiple
    for owner, unneeded in ((RayPredictor, "_solver"), (DensityReader, "lattices")):
        monkeypatch.delattr(owner, unneeded)
    np.testing.assert_array_equal(render([(volume, medium)], [LAMPS["inside"]()], view, settings).multiple, expected)
    assert expected.mean() > 0.0
    with pytest.raises(AttributeError):
        render([(volume, medium)], [LAMPS["point"]()], view, settings)


def test_what_a_lamp_inside_dark_smoke_scatters_is_little():
    # No more than once: multiple scattering vanishes with the albedo, faster than single scattering.
    lamp, settings = PointLight((0.0, 0.0, 0.0), 5.0), Settings(depth_samples=8)
    grey, dark = (picture([lamp], 20.0, albedo, 0.0, settings=settings) for albedo in (0.5, 0.05))
    assert dark.single.mean() == pytest.approx(0.1 * grey.single.mean(), rel=1e-4)
    assert dark.multiple.mean() < 0.02 * grey.multiple.mean()


def test_a_lamp_deep_inside_smoke_is_named():
    lamp = PointLight((0.0, 0.0, 0.0), 1.0, name="bulb")
    settings = Settings(depth_samples=1)
    for sigma, named in ((2.0, False), (300.0, True)):
        warnings = picture([lamp], sigma, settings=settings).report.warnings
        assert any("bulb: it lies deep inside cloud" in warning for warning in warnings) == named
    outside = picture([PointLight((0.9, 0.6, 0.5), 1.0, name="bulb")], 300.0, settings=settings)
    assert not any("bulb" in warning for warning in outside.report.warnings)
