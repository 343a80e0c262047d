# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a panorama in which a volume is seen."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from inference import Camera, Medium, Settings, render
from inference.numerics.intersection import box_interval
from inference.scene.camera_rays import camera_rays, windows_around
from inference.scene.optimizations import ALL
from tests.support.volumes import SUN, cloud

WHOLE = {"resolution": (64, 32)}
PART = {"resolution": (60, 40), "longitude": (-0.5, 2.0), "latitude": (-0.3, 1.2)}
MIRRORED = {"resolution": (64, 32), "longitude": (np.pi, -np.pi), "region": (8, 4, 60, 30)}


def panorama(seed=0, **options):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    return Camera(matrix, projection="equirectangular", **options)


@pytest.mark.parametrize("options", [WHOLE, PART, MIRRORED])
def test_windows_hold_every_ray_that_meets_a_box(options):
    """Boxes behind the camera, at its poles and around it, too; and small ones have small windows."""
    random, view = np.random.default_rng(0), panorama(**options)
    centres, sizes = 3.0 * random.normal(size=(200, 3)), 10.0 ** random.uniform(-2.0, 0.5, 200)
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    windows = windows_around(view, centres[:, None] + sizes[:, None, None] * corners)
    origins, directions, *_ = camera_rays(view)
    x0, y0, x1, y1 = view.window
    for centre, size, (left, top, right, bottom) in zip(centres, sizes, windows):
        enter, leave = box_interval(origins - centre, directions, np.full(3, -size), np.full(3, size))
        hit = ((enter < leave) & (leave > 0.0)).reshape(y1 - y0, x1 - x0)
        within = np.zeros_like(hit)
        within[max(top - y0, 0) : bottom - y0, max(left - x0, 0) : right - x0] = True
        assert within[hit].all()
    share = ((windows[:, 2:] - windows[:, :2]).prod(axis=1) / ((x1 - x0) * (y1 - y0)))[sizes < 0.1]
    assert np.median(share) < 0.1


@pytest.mark.slow
def test_a_panorama_of_clouds_is_the_same_with_every_pixel_marched():
    volumes = []
    for number, direction in enumerate(np.random.default_rng(1).normal(size=(12, 3))):
        volume = cloud(number, 16)
        matrix = volume.world_from_index.copy()
        matrix[:3, 3] += 4.0 * direction / np.linalg.norm(direction)
        volumes.append((volume.instance(matrix, f"cloud {number}"), Medium(20.0, 0.9, 0.5)))
    view = panorama(seed=3, resolution=(96, 48))
    few = render(volumes, [SUN], view)
    every = render(volumes, [SUN], view, Settings(optimizations=ALL - {"missed_pixels"}))
    np.testing.assert_allclose(few.rgb, every.rgb, atol=1e-4 * every.rgb.max())
    assert few.report.counts["camera rays"] < 0.5 * every.report.counts["camera rays"]
