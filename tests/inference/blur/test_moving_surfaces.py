# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that hide a volume while they move."""

from dataclasses import replace

import numpy as np
import pytest

from inference import Camera, Medium, Motion, SceneError, Settings, Shutter, Sun, Surface, Volume, render
from inference.blur.eyes import find_eyes
from inference.blur.shutter import corners_at
from inference.occluders.depth_buffer import eye_distances

CORNERS = np.array([[(-2, -1, 0), (0, -1, 0), (0, 1, 0)], [(-2, -1, 0), (0, 1, 0), (-2, 1, 0)]], float)
SIZE = 48
# Sees x and y from -0.5 to 0.5.
EYE, EVEN = np.eye(4), Shutter(curve=(1.0, 1.0))
EYE[2, 3] = 3.0


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
    camera = Camera(EYE, projection="orthographic", resolution=(SIZE, SIZE), ortho_scale=1.0, shutter=EVEN)
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


def test_rays_know_how_places_of_surfaces_move():
    """A wall that turns, the same as a shape that changes, and a wall beside it that stands still."""
    turning = Surface(CORNERS + [0.0, 0.0, 1.0], motion=Motion(np.array([moved(0.0), moved(0.1, 0.2)]), moved(0.0)))
    still = Surface(CORNERS + [2.3, 0.0, 1.0])
    eyes = find_eyes(Camera(EYE, projection="orthographic", resolution=(SIZE, SIZE), ortho_scale=1.0, shutter=EVEN), 4)
    x, y = (np.arange(SIZE) + 0.5) / SIZE - 0.5, 0.5 - (np.arange(SIZE) + 0.5) / SIZE
    for surface in (turning, replace(turning, motion=None, deformed=[corners_at(turning, t) for t in (0.0, 1.0)])):
        found = eye_distances([still, surface], eyes, (0, 0, SIZE, SIZE))
        row, column, _ = np.nonzero(found.moving >= 0)
        assert 0.3 * SIZE**2 * 4 < len(row) < 0.7 * SIZE**2 * 4
        turned = (corners_at(surface, 1.0) - corners_at(surface, 0.0)).reshape(-1, 3)
        linear, *_ = np.linalg.lstsq(np.c_[surface.triangles.reshape(-1, 3)[:, :2], np.ones(6)], turned, rcond=None)
        expected = np.stack([x[column], y[row], np.ones(len(row))], axis=1) @ linear
        # Rays lie beside the middles of pixels, and meet what has moved.
        assert np.abs(found.velocities[found.moving[found.moving >= 0]] - expected).max() < 0.06
        assert np.isfinite(found.distances).sum() > len(row) and found.moving[:, -1].max() == -1


@pytest.mark.parametrize("rays", [4, 16])
def test_an_edge_that_stands_still_is_sharp_though_the_other_one_moves(rays):
    """A wall grows to the left; its right edge does not move."""
    at = [
        np.where(CORNERS[..., :1] < -1.0, [left, 0, 1], [0.15, 0, 1]) + CORNERS * [0, 1, 0] for left in (-0.15, -0.45)
    ]
    found, still = (alpha(Surface(at[0], **shape), blur_rays=rays) for shape in ({"deformed": at}, {}))
    right = slice(SIZE // 2 + 4, SIZE // 2 + 11)
    assert np.abs(found - still)[:, right].max() < 0.05 * still.max()
    assert np.abs(found - still).max() > 0.3 * still.max()


def test_deformed_corners_are_checked():
    with pytest.raises(SceneError, match="all corners"):
        Surface(CORNERS, deformed=[CORNERS])
    with pytest.raises(SceneError, match="NaN"):
        Surface(CORNERS, deformed=[CORNERS, np.nan * CORNERS])
