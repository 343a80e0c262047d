# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that hide a volume while they move."""

from dataclasses import replace

import numpy as np
import pytest

from inference import Camera, Medium, Motion, SceneError, Settings, Shutter, Sun, Surface, Volume, render
from inference.blur.shutter import corners_at, surface_frames

CORNERS = np.array([[(-2, -1, 0), (0, -1, 0), (0, 1, 0)], [(-2, -1, 0), (0, 1, 0), (-2, 1, 0)]], float)
SIZE = 48


def moved(x, turn=0.0):
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    matrix[:3, 3] = x, 0.0, 1.0
    return matrix


def wall(*places):
    """Its right edge is at x in the frame, and at each of the places in the shutter."""
    triangles = CORNERS + [0.0, 0.0, 1.0]
    return Surface(triangles, motion=Motion(np.array([moved(x) for x in places]), moved(0.0)))


def alpha(surface, **settings):
    """Along x, of a slab of fog before an orthographic camera that sees x from -0.5 to 0.5."""
    frame = np.diag([1.0 / 8, 1.0 / 8, 1.0 / 8, 1.0])
    frame[:3, 3] = -0.5 + 0.5 / 8
    fog = Volume(np.ones((8, 8, 8), np.float32), frame), Medium(sigma_t=1.0, albedo=0.0)
    world = np.eye(4)
    world[2, 3] = 3.0
    camera = Camera(
        world, projection="orthographic", resolution=(SIZE, SIZE), ortho_scale=1.0, shutter=Shutter(curve=(1.0, 1.0))
    )
    lights = [Sun((0.0, 0.0, 1.0), 1.0)]
    layer = render([fog], lights, camera, Settings(depth_samples=1, **settings), surfaces=[surface])
    return layer.alpha[SIZE // 4 : -SIZE // 4].astype(np.float64)


@pytest.mark.parametrize(("rays", "most"), [(4, 0.1), (16, 0.04)])
def test_a_surface_hides_a_pixel_for_a_part_of_the_time(rays, most):
    """The edge goes from -0.25 to 0.25: what is before it is hidden from then on."""
    free = alpha(replace(wall(-5.0, -5.0), name="gone"), blur_rays=rays)
    found = alpha(wall(-0.25, 0.25), blur_rays=rays)
    x = (np.arange(SIZE) + 0.5) / SIZE - 0.5
    expected = free * np.clip((x + 0.25) / 0.5, 0.0, 1.0)
    inside = np.abs(x) < 0.4
    assert np.sqrt(np.mean((found - expected)[:, inside] ** 2)) < most * free[:, inside].mean()
    assert np.abs(found - expected)[:, inside].mean(axis=0).max() < 3.0 * most


def test_a_shape_that_changes_is_that_of_its_corners():
    at = [CORNERS + [x, 0.0, 1.0] for x in (-0.25, 0.25)]
    changing = Surface(CORNERS + [0.0, 0.0, 1.0], deformed=at)
    assert np.allclose(corners_at(changing, 0.25), corners_at(wall(-0.25, 0.25), 0.25))
    assert np.allclose(alpha(changing, blur_rays=4), alpha(wall(-0.25, 0.25), blur_rays=4), atol=0.02)


def test_frames_of_surfaces_are_places_at_the_frame():
    matrices, times = np.array([moved(-0.3, -0.2), moved(0.3, 0.4)]), np.array([0.0, 0.3, 1.0])
    rigid = Surface(CORNERS + [0.0, 0.0, 1.0], motion=Motion(matrices, moved(0.0)))
    changing = replace(rigid, motion=None, deformed=[corners_at(rigid, time) for time in np.linspace(0.0, 1.0, 65)])
    for surface in (rigid, changing):
        for frame, time in zip(surface_frames(surface, times), times):
            assert np.allclose(corners_at(rigid, time) @ frame[:, :3].T + frame[:, 3], rigid.triangles, atol=2e-3)
            assert abs(np.linalg.det(frame[:, :3])) > 0.1


def test_deformed_corners_are_checked():
    with pytest.raises(SceneError, match="all corners"):
        Surface(CORNERS, deformed=[CORNERS])
    with pytest.raises(SceneError, match="NaN"):
        Surface(CORNERS, deformed=[CORNERS, np.nan * CORNERS])
