# SPDX-License-Identifier: GPL-3.0-or-later
"""The working frame and its level 0."""

import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from inference.features.mip_lattices import density_pyramid
from inference.grids.working_cube import active_bounds, fit_cube, mean_density
from inference.runtime.cancellation import CancelToken
from inference.scene import Cancelled, SceneError, Volume


def random_volume(linear, seed=0, shape=(20, 31, 12)):
    density = np.random.default_rng(seed).random(shape, np.float32)
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    matrix[:3, 3] = (5.0, -3.0, 7.0)
    return Volume(density, matrix)


TRANSFORMS = {
    "plain": np.diag([0.1, 0.1, 0.1]),
    "anisotropic": np.diag([0.1, 0.04, 0.3]),
    "rotated": Rotation.from_rotvec([0.4, 0.2, -1.0]).as_matrix() @ np.diag([0.1, 0.2, 0.15]),
    "mirrored": np.diag([-0.1, 0.1, 0.1]),
    "sheared": np.array([[0.1, 0.06, 0.0], [0.0, 0.1, 0.02], [0.0, 0.0, 0.1]]),
}
EACH_TRANSFORM = [pytest.param(name, marks=pytest.mark.slow) if name == "sheared" else name for name in TRANSFORMS]


@pytest.mark.parametrize("name", EACH_TRANSFORM)
def test_mass_is_kept(name):
    """The integral of the density over world space equals its sum over voxels."""
    volume = random_volume(TRANSFORMS[name])
    cube = fit_cube(volume)
    level0 = mean_density(volume, cube)
    mass = volume.density.sum(dtype=np.float64) * abs(np.linalg.det(TRANSFORMS[name]))
    assert level0.sum(dtype=np.float64) * (cube.edge / 256) ** 3 == pytest.approx(mass, rel=2e-3)
    assert np.linalg.det(cube.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("name", EACH_TRANSFORM)
def test_cells_hold_the_density_at_their_centres(name):
    """A linear ramp of density is reproduced at the cells' centres in the world."""
    volume = random_volume(TRANSFORMS[name])
    index = np.stack(np.meshgrid(*[np.arange(n) for n in volume.density.shape], indexing="ij"), -1)
    volume.density = (1.0 + index @ [0.1, 0.05, 0.2]).astype(np.float32)
    cube = fit_cube(volume)
    level0 = mean_density(volume, cube)
    cells = np.random.default_rng(1).integers(256, size=(4000, 3))
    world = ((cells + 0.5) / 256 - 0.5) * cube.edge @ cube.rotation.T + cube.centre
    at = (world - volume.world_from_index[:3, 3]) @ np.linalg.inv(volume.world_from_index[:3, :3]).T
    inside = np.all((at > 1) & (at < np.array(volume.density.shape) - 2), axis=1)
    assert inside.sum() > 20
    expected = 1.0 + at[inside] @ [0.1, 0.05, 0.2]
    np.testing.assert_allclose(level0[tuple(cells[inside].T)], expected, rtol=1e-3)


def test_cube_is_the_smallest_around_the_active_voxels():
    density = np.zeros((30, 30, 30), np.float32)
    density[10:14, 5:25, 8:10] = 1.0
    cube = fit_cube(Volume(density, np.diag([0.5, 0.5, 0.5, 1.0])))
    # 20 voxels and the interpolation's reach of one more: 21 times 0.5.
    assert cube.edge == pytest.approx(10.5)
    np.testing.assert_allclose(cube.centre, [5.75, 7.25, 4.25])


def test_positions_and_directions_follow_the_object():
    volume = random_volume(TRANSFORMS["rotated"])
    cube = fit_cube(volume)
    corner = volume.world_from_index @ [-1, -1, -1, 1]
    assert np.abs(cube.positions(corner[:3])).max() == pytest.approx(0.5, abs=1e-9)
    assert np.linalg.norm(cube.directions(np.array([0.6, 0.0, 0.8]))) == pytest.approx(1.0)


def test_empty_grid_is_refused():
    with pytest.raises(SceneError, match="zero everywhere"):
        active_bounds(np.zeros((4, 4, 4), np.float32))


def test_pyramid_keeps_the_mean():
    level0 = np.random.default_rng(2).random((256, 256, 256), np.float32)
    pyramid = density_pyramid(level0)
    assert [level.shape[0] for level in pyramid] == [256, 128, 64, 32, 16, 8, 4, 2, 1]
    assert pyramid[-1].item() == pytest.approx(level0.mean(dtype=np.float64), rel=1e-5)
    np.testing.assert_allclose(pyramid[3][1, 2, 3], level0[8:16, 16:24, 24:32].mean(), rtol=1e-5)


@pytest.mark.parametrize("sheared", [False, True])
def test_coarser_cells_are_the_means_of_finer_ones(sheared):
    linear = np.array([[0.1, 0.03 * sheared, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.2]])
    volume = random_volume(linear)
    cube = fit_cube(volume)
    levels = density_pyramid(mean_density(volume, cube))
    for level in levels[1:3]:
        coarse = mean_density(volume, cube, out=np.zeros_like(level))
        np.testing.assert_allclose(coarse, level, atol=1e-5 * level.max())


@pytest.mark.parametrize("shear", [0.0, 0.2])
def test_level_0_of_a_large_grid_polls_for_cancellation(shear):
    """80 million voxels, and a sheared grid: seconds of work, stopped at once."""
    shape = (420, 440, 440) if shear == 0.0 else (40, 40, 40)
    matrix = np.diag([1.0, 1.0, 1.0, 1.0])
    matrix[0, 1] = shear
    volume = Volume(np.ones(shape, np.float32), matrix)
    asked = []

    def cancelled():
        asked.append(time.perf_counter())
        return len(asked) > 20

    cube = fit_cube(volume)
    with pytest.raises(Cancelled):
        mean_density(volume, cube, CancelToken(cancelled))
    assert np.median(np.diff(asked)) < 0.2
