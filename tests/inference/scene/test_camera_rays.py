# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays: which of them can hit a volume."""

import numpy as np
import pytest

from benchmarks.stability.scenes import camera, placed, rotation
from inference import Camera
from inference.grids.grid import Grid
from inference.scene.camera_rays import camera_rays, pixels_around, windows_around

SIZE = 60, 40


def hits(view, grid):
    """bool (H, W): pixels whose ray meets the grid, and (x0, y0, x1, y1), the view's window."""
    origins, directions, near, far = camera_rays(view)
    enter, leave = grid.interval(origins, directions)
    x0, y0, x1, y1 = view.window
    return (np.maximum(enter, near) < np.minimum(leave, far)).reshape(y1 - y0, x1 - x0), (x0, y0)


def random_view(random):
    """A camera near the origin, sheared, shifted and cropped, perhaps inside the volume or looking away."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(random.uniform(0, 6), random.normal(size=3)) + 0.2 * random.normal(size=(3, 3))
    matrix[:3, 3] = random.normal(size=3) * 1.5
    x0, y0 = random.integers(0, 20, 2)
    return Camera(
        matrix,
        projection=random.choice(["perspective", "orthographic"]),
        resolution=SIZE,
        fov=random.uniform(0.05, 2.8),
        ortho_scale=random.uniform(0.1, 5.0),
        shift=tuple(random.normal(size=2) * 0.2),
        pixel_aspect=random.choice([0.5, 1.0, 2.0]),
        region=(x0, y0, x0 + 38, y0 + 19),
    )


@pytest.mark.parametrize("seed", [5, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (6, 7, 8))])
def test_no_ray_that_hits_a_volume_is_skipped(seed):
    random, met = np.random.default_rng(seed), 0
    for _ in range(100):
        volume = placed(random.random((4, 3, 2), np.float32))
        volume.world_from_index[:3, :3] += 0.1 * random.normal(size=(3, 3))
        view, grid = random_view(random), Grid(volume)
        (left, top, right, bottom), (found, first) = windows_around(view, grid.corners()[None])[0], hits(view, grid)
        met += found.any()
        found[top - first[1] : bottom - first[1], left - first[0] : right - first[0]] = False
        assert not found.any()
    assert met > 12


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_the_window_is_little_larger_than_the_volume(projection):
    view = camera((1.7, -1.3, 6.0), pixels=200, projection=projection, ortho_scale=4.0)
    grid = Grid(placed(np.ones((4, 4, 4))))
    found, _ = hits(view, grid)
    rows, columns = np.nonzero(found)
    expected = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
    assert 0 < found.mean() < 0.5
    assert np.abs(np.subtract(windows_around(view, grid.corners()[None])[0], expected)).max() <= 3


@pytest.mark.parametrize("seed", [9, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (10, 11))])
def test_no_pixel_that_shows_density_is_skipped(seed):
    random, met, skipped = np.random.default_rng(seed), 0, 0
    for _ in range(70):
        volume = placed((random.random((9, 7, 8)) < 0.02).astype(np.float32))
        volume.density[tuple(random.integers(0, volume.density.shape))] = 1.0
        volume.world_from_index[:3, :3] += 0.1 * random.normal(size=(3, 3))
        view, grid = random_view(random), Grid(volume)
        origins, directions, near, far = camera_rays(view)
        enter, leave = grid.interval(origins, directions)
        enter, leave = np.maximum(enter, near), np.minimum(leave, far)
        seen = np.zeros(len(enter), bool)
        for place in random.random(100):
            position = origins + (enter + place * (leave - enter))[:, None] * directions
            seen |= (enter < leave) & (grid.sample_density(grid.index(position).T.astype(np.float32)) > 0.0)
        shown = pixels_around(view, *grid.support()).ravel()
        assert not (seen & ~shown).any()
        met, skipped = met + seen.any(), skipped + ((enter < leave) & ~shown).any()
    assert met > 5 and skipped > 3


def test_pixels_are_those_around_filled_cells():
    """Of two balls, not those in between."""
    axis = np.arange(60)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    balls = [(x - centre) ** 2 + (y - 30) ** 2 + (z - 30) ** 2 < 81 for centre in (11, 48)]
    view = camera((0.0, 0.0, 6.0), pixels=200, projection="orthographic", ortho_scale=1.2)
    grid = Grid(placed(np.logical_or(*balls).astype(np.float32)))
    seen = hits(view, grid)[0]
    shown = pixels_around(view, *grid.support())
    assert shown.sum() < 0.85 * seen.sum()
    assert not shown[:, 100].any() and shown[:, :100].any() and shown[:, 100:].any()
