# SPDX-License-Identifier: GPL-3.0-or-later
"""What the scene description accepts and refuses, and the plan that is made of it."""

import numpy as np
import pytest

from inference import Camera, Medium, SceneError, Settings, Sun, Volume
from inference.plan.plan import make_plan
from inference.scene.camera_rays import camera_rays
from inference.scene.sparse_grid import SparseGrid

GRID = np.ones((2, 2, 2), np.float32)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Volume(np.ones((2, 2)), np.eye(4)), "3D grid"),
        (lambda: Volume(np.full((2, 2, 2), np.nan), np.eye(4)), "NaN"),
        (lambda: Volume(-GRID, np.eye(4)), "negative"),
        (lambda: Volume(GRID, np.diag([1.0, 0.0, 1.0, 1.0])), "scaled to nothing"),
        (lambda: Medium(-1.0), "negative"),
        (lambda: Medium(1.0, 1.5), "albedo"),
        (lambda: Medium(1.0, 1.0, 1.0), "anisotropy"),
        (lambda: Medium((1.0, 2.0)), "one number or three"),
        (lambda: Sun((0, 0, 0)), "not all zero"),
        (lambda: Sun((0, 0, 1), -1.0), "negative"),
        (lambda: Camera(np.eye(4), projection="fisheye"), "fisheye"),
        (lambda: Camera(np.eye(4), resolution=(0, 10)), "no pixels"),
        (lambda: Camera(np.eye(4), resolution=(10, 10), region=(5, 5, 5, 8)), "region"),
        (lambda: Camera(np.eye(4), fov=4.0), "field of view"),
        (lambda: Settings(depth_samples=0), "depth samples"),
    ],
)
def test_refused_with_a_reason(make, message):
    with pytest.raises(SceneError, match=message):
        make()


def test_scalars_and_tuples_are_rgb():
    medium = Medium(2, (0.1, 0.2, 0.3))
    np.testing.assert_array_equal(medium.sigma_t, [2, 2, 2])
    np.testing.assert_array_equal(Sun((0, 0, 2), (1, 2, 3)).direction, [0, 0, 1])


def test_perspective_rays_reach_the_window_edges():
    camera = Camera(np.eye(4), resolution=(200, 100), fov=1.0)
    origins, directions, _, _ = camera_rays(camera)
    corner = directions[0] / -directions[0, 2]
    assert corner[0] == pytest.approx(-np.tan(0.5) * 199 / 200)
    assert corner[1] == pytest.approx(np.tan(0.5) * 99 / 200)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert np.all(origins == 0.0)


def test_shift_moves_the_window_by_its_width():
    plain = camera_rays(Camera(np.eye(4), "orthographic", (10, 10), ortho_scale=4.0))[0]
    shifted = camera_rays(Camera(np.eye(4), "orthographic", (10, 10), ortho_scale=4.0, shift=(0.5, -0.25)))[0]
    np.testing.assert_allclose(shifted - plain, np.broadcast_to([2.0, -1.0, 0.0], plain.shape))


def placed(x):
    matrix = np.eye(4)
    matrix[0, 3] = x
    return matrix


def plan_of(media, suns):
    volumes = [(Volume(GRID, placed(10.0 * i), f"v{i}"), m) for i, m in enumerate(media)]
    return make_plan(volumes, suns, Camera(np.eye(4), resolution=(4, 4)), Settings())


def test_the_plan_skips_what_the_scene_does_not_need():
    suns = [Sun((0, 0, 1), 1.0, "a"), Sun((0, 0, 3), 2.0, "b"), Sun((0, 1, 0), 0.0, "dark")]
    plan = plan_of([Medium(1.0, 0.5), Medium(0.0, 0.5), Medium(1.0, 0.0)], suns)
    assert [v.name for v, _ in plan.volumes] == ["v0", "v2"]
    assert plan.multiple == [True, False]
    assert len(plan.suns) == 1 and plan.suns[0].irradiance[0] == pytest.approx(3.0)
    assert len(plan.channels) == 1
    text = " ".join(plan.left_out)
    for part in ("v1: its extinction is 0", "v2: multiple scattering", "dark: its irradiance is 0", "merged"):
        assert part in text


def test_channels_are_grouped_by_extinction():
    plan = plan_of([Medium((1.0, 2.0, 1.0), 0.5)], [Sun((0, 0, 1))])
    assert [group.indices for group in plan.channels] == [[0, 2], [1]]


def test_merging_suns_leaves_the_callers_suns_alone():
    first = Sun((0, 0, 1), 1.0)
    plan_of([Medium(1.0, 0.5)], [first, Sun((0, 0, 1), 2.0)])
    np.testing.assert_array_equal(first.irradiance, [1.0, 1.0, 1.0])


def test_the_filled_density_is_that_of_matter_whatever_surrounds_it():
    values = np.zeros((20, 9, 12), np.float32)
    values[3:8, 2:6, 4:9] = np.random.default_rng(0).uniform(0.5, 2.0, (5, 4, 5))
    matter = values[values > 0.0].astype(np.float64)
    expected = (matter**2).sum() / matter.sum()
    for density in (values, SparseGrid.of_dense(values)):
        assert Volume(density, np.eye(4)).filled == pytest.approx(expected, rel=1e-5)
    for scale in (1e-30, 1e30):
        extreme = Volume(values * np.float32(scale), np.eye(4))
        assert extreme.filled == extreme.peak
    assert Volume(np.zeros((2, 2, 2)), np.eye(4)).filled == 0.0
