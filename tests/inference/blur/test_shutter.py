# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of cameras that move while the shutter is open."""

from dataclasses import replace

import numpy as np
import pytest

from inference import Camera, Lens, Medium, Motion, SceneError, Settings, Shutter, Sun, Volume, render
from inference.blur.eyes import find_eyes
from inference.blur.shutter import camera_at, matrix_at, shutter_times


def placed(x=0.0, turn=0.0, scale=1.0):
    """A transform 2 units above the origin, turned about z."""
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    matrix[:3, :3] *= scale
    matrix[:3, 3] = x, 0.0, 2.0
    return matrix


def ball(cells=24):
    axis = (np.arange(cells) + 0.5) / cells * 2.0 - 1.0
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    frame = np.diag([0.2 / cells, 0.2 / cells, 0.2 / cells, 1.0])
    frame[:3, 3] = (0.5 - 0.5 * cells) * 0.2 / cells
    volume = Volume((x**2 + y**2 + z**2 < 0.8).astype(np.float32), frame, name="ball")
    return volume, Medium(sigma_t=20.0, albedo=(0.0, 0.0, 0.0))


CAMERA = Camera(placed(), resolution=(64, 64), fov=0.5)


def test_transforms_between_two_are_on_the_way():
    ends = np.array([placed(-1.0, 0.2, 1.0), placed(1.0, 1.4, 3.0)])
    assert np.allclose(matrix_at(ends, 0.0), ends[0]) and np.allclose(matrix_at(ends, 1.0), ends[1])
    assert np.allclose(matrix_at(ends, 0.25), placed(-0.5, 0.5, 1.5))
    # A mirror stays one: no time in between is singular.
    mirrored = ends @ np.diag([-1.0, 1.0, 1.0, 1.0])
    assert all(np.linalg.det(matrix_at(mirrored, time)[:3, :3]) < -0.9 for time in np.linspace(0.0, 1.0, 9))
    # Half a turn, whose axis is not told.
    half = matrix_at(np.array([placed(), placed(turn=np.pi)]), 0.5)
    assert np.isfinite(half).all() and np.linalg.det(half[:3, :3]) == pytest.approx(1.0)
    three = np.array([placed(0.0), placed(1.0), placed(5.0)])
    assert matrix_at(three, 0.75)[0, 3] == pytest.approx(3.0)


def test_a_zoom_moves_the_edges_of_the_picture_evenly():
    camera = replace(CAMERA, shutter=Shutter(fovs=(0.4, 0.8)))
    middle = np.tan(0.5 * camera_at(camera, 0.5).fov)
    assert middle == pytest.approx(0.5 * (np.tan(0.2) + np.tan(0.4)))


def test_times_follow_the_shutter_curve():
    u = (np.arange(1000) + 0.5) / 1000
    assert np.array_equal(shutter_times(Shutter(), u), u)
    # A triangle: the density of times is its height.
    times = shutter_times(Shutter(curve=(0.0, 1.0, 0.0)), u)
    counts = np.histogram(times, np.linspace(0.0, 1.0, 11))[0]
    assert np.allclose(counts, [20, 60, 100, 140, 180, 180, 140, 100, 60, 20], atol=4)


def test_each_pixel_looks_at_times_all_over_the_shutter():
    eyes = find_eyes(replace(CAMERA, shutter=Shutter([placed(-1.0), placed(1.0)])), 4)
    for times in eyes.times.reshape(-1, 4):
        assert sorted((times * 4).astype(int)) == [0, 1, 2, 3]
    assert np.allclose([eye.world_matrix[0, 3] for eye in eyes.cameras], 2.0 * eyes.times - 1.0)


@pytest.mark.parametrize("rays", [2, 4, 6, 16])
def test_rows_columns_and_squares_of_pixels_look_at_times_all_over_the_shutter(rays):
    """Pixels are joined along the way of what moves."""
    eyes = find_eyes(replace(CAMERA, shutter=Shutter([placed(-1.0), placed(1.0)])), rays)
    columns, rows = (axis.ravel() for axis in np.meshgrid(np.arange(8), np.arange(8)))
    times = eyes.times[eyes.of_pixels(columns, rows)].reshape(8, 8, rays)
    squares = times.reshape(4, 2, 4, 2, rays).swapaxes(1, 2).reshape(16, -1)
    for group in (*times[:, :4].reshape(8, -1), *times[2:6].swapaxes(0, 1).reshape(8, -1), *squares):
        assert sorted((group * 4 * rays).astype(int)) == list(range(4 * rays))
    assert sorted((eyes.times * 16 * rays).astype(int)) == list(range(16 * rays))


@pytest.mark.parametrize("across", [0, 1])
def test_few_rays_show_smoke_that_moves_along_pixels_without_noise(across):
    ends = np.tile(placed(), (2, 1, 1))
    ends[:, across, 3] += -0.1, 0.1
    rng = np.random.default_rng(4)
    density = np.kron(rng.random((6, 6, 6)), np.ones((4, 4, 4))).astype(np.float32)
    smoke = replace(ball()[0], density=density), Medium(sigma_t=10.0, albedo=(0.0, 0.0, 0.0))
    moving = replace(CAMERA, shutter=Shutter(ends))
    few, many = (render([smoke], [], moving, Settings(blur_rays=rays)).alpha for rays in (4, 64))
    assert np.sqrt(((few - many) ** 2).mean()) < 0.025 * many[many > 0.01].mean()


@pytest.mark.slow
@pytest.mark.parametrize("projection", ["perspective", "orthographic", "equirectangular"])
@pytest.mark.parametrize("curve", [(), (0.0, 1.0)])
def test_a_picture_is_the_mean_of_pictures_at_many_times(projection, curve):
    camera = replace(CAMERA, projection=projection, ortho_scale=1.0, longitude=(-0.3, 0.3), latitude=(-1.8, -1.2))
    if projection == "equirectangular":
        camera = replace(camera, latitude=(-0.3, 0.3))
    matrices = [placed(-0.2), placed(0.2, 0.3)]
    moving = replace(camera, shutter=Shutter(matrices, curve=curve))
    found = render([ball()], [], moving, Settings(blur_rays=8)).alpha
    times = (np.arange(96) + 0.5) / 96
    weight = np.interp(times, [0.0, 1.0], curve) if curve else np.ones(96)
    still = [render([ball()], [], replace(camera, world_matrix=matrix_at(matrices, time))).alpha for time in times]
    expected = np.average(still, axis=0, weights=weight)
    sharp = render([ball()], [], camera).alpha
    size = expected[expected > 0.01].mean()
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.032 * size
    assert np.sqrt(((sharp - expected) ** 2).mean()) > 0.15 * size


def test_deep_samples_are_refused_and_impossible_shutters():
    moving = replace(CAMERA, shutter=Shutter([placed(-0.2), placed(0.2)]))
    with pytest.raises(SceneError, match="deep EXR.*motion blur"):
        render([ball()], [], moving, Settings(outputs=frozenset({"deep"})))
    for values in ({"world_matrices": [placed()]}, {"fovs": (0.5, 4.0)}, {"curve": (0.0, 0.0)}):
        with pytest.raises(SceneError, match="camera: "):
            Shutter(**values)


def moved_ball(offset, matrices, name="ball"):
    """A ball at an offset, that moves by matrices."""
    volume, medium = ball()
    frame = np.eye(4)
    frame[:3, 3] = offset
    place = frame @ volume.world_from_index
    return Volume(volume.density, place, name=name, motion=Motion(matrices, np.eye(4))), medium


def still_at(pair, time):
    """A moving volume where it is at a time."""
    volume, medium = pair
    place = matrix_at(volume.motion.world_matrices, time) @ volume.world_from_index
    return replace(volume, world_from_index=place, motion=None), medium


def at(x=0.0, y=0.0, turn=0.0, scale=1.0):
    """As `placed`, at the origin."""
    matrix = placed(x, turn, scale)
    matrix[:3, 3] = x, y, 0.0
    return matrix


@pytest.mark.slow
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_volumes_are_seen_where_they_are_at_each_time(projection):
    """One passes behind another that grows while it turns; lit, and from a camera that moves too."""
    camera = replace(CAMERA, projection=projection, ortho_scale=1.0)
    camera = replace(camera, shutter=Shutter([placed(-0.05), placed(0.05)]))
    volumes = [
        moved_ball((0.1, 0.0, 0.2), [at(scale=0.8), at(turn=0.8, scale=1.3)], "turning"),
        moved_ball((0.0, 0.05, -0.2), [at(-0.2), at(0.2, 0.1)], "passing"),
    ]
    lights = [Sun((0.3, 0.2, 1.0), 1.0)]
    volumes = [(volume, replace(medium, albedo=np.full(3, 0.5))) for volume, medium in volumes]
    settings = Settings(blur_rays=8, multiple=False)
    found = render(volumes, lights, camera, settings)
    pictures = []
    for time in (np.arange(64) + 0.5) / 64:
        seen = [still_at(pair, time) for pair in volumes]
        pictures.append(render(seen, lights, camera_at(camera, time), settings))
    sharp = render(volumes, lights, replace(camera, shutter=None), settings)
    for name, most in (("alpha", 0.05), ("rgb", 0.05)):
        expected = np.mean([getattr(picture, name) for picture in pictures], axis=0)
        size = expected[expected > 0.01 * expected.max()].mean()
        assert np.sqrt(((getattr(found, name) - expected) ** 2).mean()) < most * size
        assert np.sqrt(((getattr(sharp, name) - expected) ** 2).mean()) > 0.15 * size


def test_a_volume_that_moves_with_the_camera_is_as_sharp_as_one_that_stands_still():
    """Both by the same; multiple scattering is predicted where it was."""
    lights, settings = [Sun((0.3, 0.2, 1.0), 1.0)], Settings(blur_rays=4)
    (volume, _), medium = ball(), Medium(sigma_t=20.0, albedo=(0.9, 0.9, 0.9))
    ride = replace(volume, motion=Motion([at(-0.7, 0.2), at(0.6, -0.3)], np.eye(4)))
    path = [at(*place) @ placed() for place in ((-0.7, 0.2), (0.6, -0.3))]
    still = replace(CAMERA, shutter=Shutter([placed(), placed()]))
    found, expected = (
        render([(one, medium)], lights, replace(still, shutter=Shutter(matrices)), settings)
        for one, matrices in ((ride, path), (volume, still.shutter.world_matrices))
    )
    assert expected.multiple.max() > 0.01
    for name in ("alpha", "single", "multiple", "depth"):
        a, b = getattr(found, name), getattr(expected, name)
        assert np.allclose(a, b, atol=2e-3 * np.nanmax(np.where(np.isfinite(b), b, 0.0)), equal_nan=True)


@pytest.mark.parametrize(
    "case", ["1e6 voxels", "1e-9 voxels", "past the camera", "behind it", "through zero, almost", "lens in it"]
)
def test_extreme_motion_leaves_sound_pictures(case):
    volume, medium = ball()
    medium, camera = replace(medium, sigma_t=2000.0, albedo=np.full(3, 0.9)), replace(CAMERA, shutter=Shutter())
    voxel = 0.2 / 24
    ends = {
        "1e6 voxels": [at(-1e6 * voxel), at(1e6 * voxel)],
        "1e-9 voxels": [at(-1e-9 * voxel), at(1e-9 * voxel)],
        "through zero, almost": [at(scale=1e-6), at(scale=1e3)],
    }.get(case, [at(), at()])
    if case in ("past the camera", "behind it"):
        ends[1][2, 3] = 4.0
    if case == "behind it":
        ends[0][2, 3] = 3.0
    if case == "lens in it":
        camera = replace(camera, world_matrix=np.eye(4), lens=Lens(0.05, 0.05), shutter=Shutter([at(), at(0.3)]))
    moving = replace(volume, motion=Motion(ends, np.eye(4)))
    found = render([(moving, medium)], [Sun((0.3, 0.2, 1.0), 1.0)], replace(camera, resolution=(24, 24)))
    for image in (found.rgb, found.alpha, found.multiple, found.uncertainty):
        assert np.isfinite(image).all() and image.min() >= 0.0
    assert found.alpha.max() <= 1.0 + 1e-6
    assert found.alpha.max() > 0.0 or case in ("1e6 voxels", "behind it")
