# SPDX-License-Identifier: GPL-3.0-or-later
"""Pinhole cameras that sample lenses."""

from dataclasses import replace

import numpy as np
import pytest

from inference import Camera, Lens, Medium, SceneError, Settings, Sun, Surface, Volume, render
from inference.blur.eyes import BLOCK, aperture_points, find_eyes
from inference.scene.camera_rays import image_rays, pixel_rays, seen_at

PLACE = np.eye(4)
PLACE[:3, 3] = (0.2, -0.1, 4.0)


def rays_of_eyes(camera, rays, column, row):
    """Origins and directions (E, 3) of all eyes through one pixel."""
    eyes = find_eyes(camera, rays)
    pixel = np.array([column]), np.array([row])
    origins, directions, *_ = zip(*(pixel_rays(eye, *pixel) for eye in eyes.cameras))
    return np.concatenate(origins), np.concatenate(directions)


@pytest.mark.parametrize("lens", [Lens(0.2, 3.0), Lens(0.2, 3.0, blades=5, rotation=0.4, ratio=2.0)])
@pytest.mark.parametrize("projection", ["perspective", "orthographic", "equirectangular"])
def test_all_rays_of_a_pixel_meet_where_it_is_sharp(projection, lens):
    camera = Camera(PLACE, projection, resolution=(64, 32), fov=0.9, lens=lens)
    origins, directions = rays_of_eyes(camera, 4, 40, 9)
    [[origin], [direction], [cosine]] = image_rays(replace(camera, lens=None), np.array([40.5]), np.array([9.5]))
    sharp = origin + lens.focus / cosine * direction
    along = (directions * (sharp - origins)).sum(axis=1)
    missed = np.linalg.norm(origins + along[:, None] * directions - sharp, axis=1)
    pixel = {"perspective": 3.0 * 2.0 * np.tan(0.45) / 64, "orthographic": 6.0 / 64, "equirectangular": 0.0}[projection]
    assert missed.max() < pixel + 1e-9
    # And they begin all over the aperture.
    spread = np.linalg.norm(origins - origin, axis=1)
    assert spread.max() > 0.7 * lens.radius / lens.ratio and spread.max() < lens.radius + pixel


def test_the_aperture_is_sampled_evenly():
    u, v = np.random.default_rng(0).random((2, 20000))
    disk = aperture_points(Lens(2.0, 1.0), u, v)
    radius = np.linalg.norm(disk, axis=1)
    assert radius.max() <= 2.0 and (radius**2).mean() == pytest.approx(2.0, rel=0.02)
    hexagon = aperture_points(Lens(2.0, 1.0, blades=6, rotation=np.pi / 6.0), u, v)
    # A regular hexagon of circumradius R has a mean squared radius of 5 R^2 / 12.
    assert (hexagon**2).sum(axis=1).mean() == pytest.approx(4.0 * 5.0 / 12.0, rel=0.02)
    assert np.abs(hexagon.mean(axis=0)).max() < 0.03
    squeezed = aperture_points(Lens(2.0, 1.0, ratio=2.0), u, v)
    assert np.abs(squeezed[:, 0]).max() < 1.0 + 1e-9 < np.abs(squeezed[:, 1]).max()


def test_squares_of_pixels_share_out_the_lens_evenly():
    eyes = find_eyes(Camera(PLACE, "orthographic", resolution=(8, 8), lens=Lens(1.0, 1.0)), 4)
    columns, rows = (axis.ravel() for axis in np.meshgrid(np.arange(8), np.arange(8)))
    numbers = eyes.of_pixels(columns, rows).reshape(8, 8, 4)
    assert sorted(numbers[:BLOCK, BLOCK:].ravel()) == list(range(BLOCK**2 * 4))
    for number in (0, 7, 21, 63):
        x, y = eyes.pixels_of(number, (1, 2, 8, 8))
        there = {(c, r) for c, r in zip(columns, rows) if c >= 1 and r >= 2 and number in numbers[r, c]}
        assert there == {(c, r) for c in x for r in y}


def test_where_a_point_is_seen_is_where_its_ray_goes():
    for projection in ("perspective", "orthographic", "equirectangular"):
        camera = Camera(PLACE, projection, resolution=(64, 32), fov=0.9, shift=(0.1, -0.2), pixel_aspect=0.7)
        x, y = np.array([3.25, 60.0]), np.array([7.5, 20.0])
        origins, directions, _ = image_rays(camera, x, y)
        assert np.allclose(seen_at(camera, origins + 2.5 * directions), [x, y])


def ball(cells=24):
    axis = (np.arange(cells) + 0.5) / cells * 2.0 - 1.0
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    density = (x**2 + y**2 + z**2 < 0.8).astype(np.float32)
    frame = np.diag([0.1 / cells, 0.1 / cells, 0.1 / cells, 1.0])
    frame[:3, 3] = (0.5 - 0.5 * cells) * 0.1 / cells
    return Volume(density, frame, name="ball"), Medium(sigma_t=40.0, albedo=(0.0, 0.0, 0.0))


@pytest.mark.slow
def test_a_ball_out_of_focus_is_as_large_as_its_circle_of_confusion():
    place = np.eye(4)
    place[2, 3] = 2.0
    camera = Camera(place, resolution=(96, 96), fov=0.5)
    sharp = render([ball()], [], camera).alpha
    lens = Lens(radius=0.1, focus=1.0)
    blurred = render([ball()], [], replace(camera, lens=lens)).alpha
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=0.02)
    # The lens' image in the plane of the ball: half as large as the aperture is from 1 to 2 units behind it.
    pixels = 96 / (2.0 * 2.0 * np.tan(0.25))
    rows, columns = np.mgrid[:96, :96] - 47.5
    squared = (blurred * (rows**2 + columns**2)).sum() / blurred.sum() - (
        sharp * (rows**2 + columns**2)
    ).sum() / sharp.sum()
    assert squared == pytest.approx((lens.radius * pixels) ** 2 / 2.0, rel=0.12)
    # Without noise: as many eyes as there are pixels in a square are not told apart.
    many = render([ball()], [], replace(camera, lens=lens), Settings(blur_rays=64)).alpha
    assert np.sqrt(((blurred - many) ** 2).mean()) < 0.02 * many[many > 0.01].mean()


def test_a_lens_without_aperture_changes_nothing_but_the_pixels_filter():
    place = np.eye(4)
    place[2, 3] = 2.0
    camera = Camera(place, resolution=(48, 48), fov=0.2)
    found = render([ball()], [], replace(camera, lens=Lens(0.0, 1.0))).alpha
    fine = render([ball()], [], replace(camera, resolution=(192, 192))).alpha.reshape(48, 4, 48, 4).mean(axis=(1, 3))
    assert np.sqrt(((found - fine) ** 2).mean()) < 0.01


def test_surfaces_hide_what_each_ray_sees():
    """A plane in focus before a fog out of focus keeps its edge; out of focus it loses it."""
    place = np.eye(4)
    place[2, 3] = 2.0
    camera = Camera(place, resolution=(64, 64), fov=0.06)
    wall = Surface(np.array([[[0.0, -9.0, 0.5], [9.0, -9.0, 0.5], [0.0, 9.0, 0.5]]]))
    alphas = {}
    for focus in (1.5, 1.9):
        found = render([ball()], [], replace(camera, lens=Lens(0.02, focus)), surfaces=[wall]).alpha
        alphas[focus] = found[28:36].mean(axis=0)
    assert np.abs(np.diff(alphas[1.5])).max() > 0.9 * alphas[1.5].max()
    assert np.abs(np.diff(alphas[1.9])).max() < 0.3 * alphas[1.9].max()
    assert alphas[1.5][33:].max() < 1e-6 and alphas[1.9][33] > 0.1


@pytest.mark.parametrize("values", [(-1.0, 1.0), (1.0, 0.0), (np.nan, 1.0), (1.0, np.inf)])
def test_impossible_lenses_are_refused(values):
    with pytest.raises(SceneError, match="camera: the"):
        Lens(*values)


def test_outputs_of_one_ray_are_those_of_the_middle_of_the_lens_and_deep_samples_are_refused():
    place = np.eye(4)
    place[2, 3] = 2.0
    camera = Camera(place, resolution=(48, 48), fov=0.2)
    floor = Surface(np.array([[[-9.0, -9.0, -0.2], [9.0, -9.0, -0.2], [0.0, 9.0, -0.2]]]))
    blurred, sun = replace(camera, lens=Lens(0.02, 1.0)), [Sun((0.3, 0.2, 1.0), 1.0)]
    settings = Settings(outputs=frozenset({"median", "shadow", "coverage"}))
    sharp, found = (render([ball()], sun, seen, settings, surfaces=[floor]) for seen in (camera, blurred))
    assert np.array_equal(found.shadow, sharp.shadow) and sharp.shadow.min() < 0.5
    both = np.isfinite(found.median) & np.isfinite(sharp.median)
    assert both.sum() > 0.9 * np.isfinite(sharp.median).sum()
    assert np.allclose(found.median[both], sharp.median[both], rtol=1e-5)
    covered = np.bincount(found.coverage.pixel, found.coverage.share, 48 * 48)
    assert np.allclose(covered, found.alpha.ravel(), atol=1e-5)
    with pytest.raises(SceneError, match="deep EXR.*depth of field"):
        render([ball()], sun, blurred, Settings(outputs=frozenset({"deep"})))


@pytest.mark.slow
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_small_volumes_out_of_focus_are_seen_wherever_a_ray_meets_them(projection):
    """Many volumes, whose windows tell which of them each tile is marched through."""
    place = np.eye(4)
    place[2, 3] = 2.0
    camera = Camera(place, projection, resolution=(64, 64), fov=0.5, ortho_scale=1.0, lens=Lens(0.1, 1.0))
    volumes = []
    for number, (x, y) in enumerate(np.random.default_rng(3).uniform(-0.45, 0.45, (40, 2))):
        volume, medium = ball(8)
        frame = np.diag([0.3, 0.3, 0.3, 1.0])
        frame[:3, 3] = x, y, 0.0
        volumes.append((Volume(volume.density, frame @ volume.world_from_index, name=f"ball {number}"), medium))
    everything = Settings().optimizations
    found, whole = (
        render(volumes, [], camera, Settings(optimizations=names)).alpha
        for names in (everything, everything - {"missed_pixels"})
    )
    assert whole.max() > 0.05
    np.testing.assert_allclose(found, whole, atol=1e-4)
