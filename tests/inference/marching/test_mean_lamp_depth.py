# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depths of all of a lamp's light at voxels: what they are, what they change, and where they are not used."""

import numpy as np
import pytest

from inference import AreaLight, Medium, PointLight, RenderCache, Settings, Surface, render
from inference.grids.bound_medium import BoundMedium
from inference.grids.grid import Grid
from inference.marching.lamp_in_media import place_lamp
from inference.marching.mean_lamp_depth import mean_lamp_depth
from inference.runtime.tasks import SERIAL
from inference.scene.optimizations import ALL, OPTIMIZATIONS
from tests.support.volumes import camera, cloud

COUNT = "lamps whose shadows are averaged at voxels"
CACHE = RenderCache()
CLOUD = cloud(voxels=96)


def panel(size=0.6, distance=1.4, **options):
    """A square that shines at the cloud from the side."""
    towards = np.array([0.7, 0.2, 0.68])
    towards /= np.linalg.norm(towards)
    across = np.cross(towards, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([across, np.cross(towards, across), towards], axis=1)
    matrix[:3, 3] = distance * towards
    return AreaLight(matrix, options.pop("shape", "square"), size, 30.0, **options)


@pytest.mark.parametrize("lamp", [panel(), PointLight((0.05, 0.1, 0.0), 1.0, 0.1)], ids=["panel", "sphere inside"])
def test_depths_at_voxels_are_those_of_the_mean_transmittance(lamp):
    """Against the depths of the parts, at voxels that are not near the lamp."""
    grid = Grid(CLOUD)
    placed, sigma_t = place_lamp(lamp, [grid]), 20.0
    found = mean_lamp_depth(placed, BoundMedium(grid, Medium(sigma_t), sigma_t, []), SERIAL)
    filled = np.argwhere(grid.density.padded[1:-2, 1:-2, 1:-2] > 0.0)
    index = filled[np.random.default_rng(3).permutation(len(filled))[:60]].T
    voxels = (index - grid.offset[:, None]).T @ np.linalg.inv(grid.linear).T
    far = np.linalg.norm(voxels - placed.centre, axis=1) > found.start
    assert far.sum() > 20
    light, passed = np.zeros((2, len(voxels)))
    for emitter, [depth] in zip(placed.emitters, placed.depths):
        given = emitter.fluence(voxels)
        passed += given * np.exp(-depth(index.astype(np.float32), sigma_t))
        light += given
    error = np.exp(-found.grid.sample(index.astype(np.float32) + np.float32(1.0))) - passed / light
    assert np.sqrt((error[far] ** 2).mean()) < 0.02 * np.sqrt(((passed / light)[far] ** 2).mean())


def picture(lamp, optimizations, density=20.0, surfaces=(), size=(384, 256), anisotropy=0.857):
    medium = Medium(density, (0.99, 0.9, 0.9), anisotropy)
    settings = Settings(8, optimizations=optimizations)
    return render([(CLOUD, medium)], [lamp], camera(resolution=size), settings, None, None, CACHE, surfaces)


@pytest.mark.slow
@pytest.mark.parametrize(
    "lamp, anisotropy",
    [
        (panel(), 0.0),
        (panel(1.2, shape="disk", spread=1.5), 0.857),
        (PointLight((0.05, 0.1, 0.0), 9.0, 0.04), 0.857),
    ],
    ids=["panel", "wide disk", "sphere inside"],
)
def test_averaged_shadows_change_the_picture_within_the_budget(lamp, anisotropy):
    names = ALL - {"shared_pixels"}
    averaged, each = (picture(lamp, left_out, anisotropy=anisotropy) for left_out in (names, names - {"soft_shadows"}))
    shown = each.alpha > 0.02
    error = np.sqrt(((averaged.rgb - each.rgb)[shown] ** 2).mean()) / each.rgb[shown].mean()
    assert 0.0 < error < OPTIMIZATIONS["soft_shadows"].budget
    np.testing.assert_array_equal(averaged.alpha, each.alpha)
    assert averaged.report.counts[COUNT] == 1 and COUNT not in each.report.counts


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        dict(size=(24, 16)),
        dict(density=2000.0),
        dict(surfaces=[Surface([[[0, -4, 0.7], [4, -4, 0.7], [0.4, 4, 0.7]]], covers=False)]),
    ],
    ids=["few rays", "thick voxels", "a plate that shadows the lamp"],
)
def test_shadows_are_not_averaged_where_that_is_dearer_or_wrong(changes):
    assert picture(panel(), ALL, **changes).report.counts[COUNT] == 0
    assert picture(PointLight((1.0, 1.0, 1.0), 9.0), ALL, **changes).report.counts[COUNT] == 0


@pytest.mark.slow
def test_a_floor_that_shadows_nothing_does_not_matter():
    """Nor do walls behind the cloud, behind the lamp and beside both; a roof in between does."""
    names, lamp = ALL - {"shared_pixels"}, panel()
    x, y = 20.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]).T
    flat = np.stack([x, y, np.zeros(4)], axis=1)[[[0, 1, 2], [0, 2, 3]]]
    walls = [flat + [0, 0, -0.5], flat[..., [2, 0, 1]] - [0.6, 0, 0], flat[..., [2, 0, 1]] + [1.7, 0, 0]]
    alone, walled = (
        picture(lamp, names, surfaces=[Surface(wall, covers=False, stops=False) for wall in some])
        for some in ([], walls)
    )
    assert walled.report.counts[COUNT] == 1
    np.testing.assert_allclose(walled.single, alone.single, rtol=1e-5)
    roof = Surface(0.05 * flat + 0.8 * np.array([0.7, 0.2, 0.68]), covers=False, stops=False)
    assert picture(lamp, names, surfaces=[roof]).report.counts[COUNT] == 0
