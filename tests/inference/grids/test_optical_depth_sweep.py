# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depth towards the sun against closed forms and brute-force marching."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from inference.grids.grid import Grid
from inference.grids.optical_depth_sweep import sun_optical_depth
from inference.scene import Volume

DIRECTIONS = [(0, 0, 1), (1, 1, 1), (0.3, -0.8, 0.5), (-0.9, 0.1, 0.2), (0.5, 0.45, -0.6)]


def march(density, direction, index, step=0.05):
    """Optical depth by small steps through the trilinear interpolant."""
    length = np.linalg.norm(density.shape) + 2
    t = (np.arange(int(length / step)) + 0.5) * step
    points = index[:, :, None] + direction[None, :, None] * t
    padded = np.pad(density, 1)
    values = map_coordinates(padded, points.transpose(1, 0, 2).reshape(3, -1) + 1, order=1, cval=0.0)
    return values.reshape(len(index), -1).sum(axis=1) * step


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_against_marching_in_smooth_density(direction):
    """Error below 4 % of the largest depth, 1 % in the mean square, for features six voxels wide."""
    direction = np.array(direction) / np.linalg.norm(direction)
    random = np.random.default_rng(0)
    density = gaussian_filter(random.normal(size=(40, 44, 36)), 3).astype(np.float32)
    density = np.maximum(density, 0) / density.max()
    depth = sun_optical_depth(density, direction)
    index = np.stack([random.integers(n, size=400) for n in density.shape], axis=1)
    expected = march(density, direction, index.astype(float))
    error = depth[tuple(index.T)] - expected
    assert np.abs(error).max() < 0.04 * expected.max()
    assert np.sqrt((error**2).mean()) < 0.01 * expected.max()


def test_slab_has_its_closed_form():
    """Inside a homogeneous slab the depth is the slanted path to its top, to a tenth of a voxel."""
    density = np.zeros((80, 80, 30), np.float32)
    density[:, :, 5:25] = 2.0
    direction = np.array([0.3, 0.2, 0.5]) / np.linalg.norm([0.3, 0.2, 0.5])
    depth = sun_optical_depth(density, direction)
    for k in range(5, 25):
        # The slab's top lies half a voxel above its last cell centre.
        expected = 2.0 * (24.5 - k) / direction[2]
        assert depth[30, 30, k] == pytest.approx(expected, abs=0.3)


def test_length_unit_follows_the_direction():
    """A direction given in index units per world unit yields depth in world units."""
    density = np.ones((8, 8, 8), np.float32)
    half_sized_voxels = sun_optical_depth(density, np.array([0.0, 0.0, 2.0]))
    np.testing.assert_allclose(half_sized_voxels, 0.5 * sun_optical_depth(density, np.array([0.0, 0.0, 1.0])))


def test_shadow_edges_stay_sharp_far_from_the_caster():
    """Interpolation errors do not accumulate: an edge is as sharp 100 voxels away as at the start."""
    density = np.zeros((160, 40, 60), np.float32)
    density[150:153, :, :30] = 1.0
    direction = np.array([1.0, 0.0, 0.0931])
    direction /= np.linalg.norm(direction)
    depth = sun_optical_depth(density, direction)
    for i in (145, 20):
        row = depth[i, 20]
        assert np.count_nonzero((row > 0.1 * row.max()) & (row < 0.9 * row.max())) <= 3


@pytest.mark.parametrize("thickness", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_points_outside_see_the_sun_through_the_whole_grid(direction, thickness):
    """Points of another volume may lie anywhere: their transmittance is that of marching through this grid."""
    direction = np.array(direction) / np.linalg.norm(direction)
    random = np.random.default_rng(0)
    density = gaussian_filter(random.normal(size=(24, 20, 28)), 3).astype(np.float32)
    density = np.maximum(density, 0) / density.max()
    grid = Grid(Volume(density, np.eye(4)))
    [depth] = grid.sun_depths([direction])
    points = random.uniform(-5.0, 30.0, size=(400, 3))
    found = np.exp(-depth(grid.index(points).astype(np.float32).T, thickness))
    expected = np.exp(-thickness * march(density, direction, points))
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.04


@pytest.mark.parametrize("direction", DIRECTIONS[2:])
def test_interpolation_does_not_darken_rough_density(direction):
    """Mean transmittance is right within a thousandth: blurred optical depths would transmit less."""
    direction = np.array(direction) / np.linalg.norm(direction)
    random = np.random.default_rng(0)
    density = (random.random((30, 28, 32)) ** 8).astype(np.float32)
    grid = Grid(Volume(density, np.eye(4)))
    [depth] = grid.sun_depths([direction])
    points = random.uniform(0.0, 27.0, size=(4000, 3))
    found = np.exp(-depth(grid.index(points).astype(np.float32).T, 1.0, may_be_outside=False))
    expected = np.exp(-march(density, direction, points))
    assert found.mean() == pytest.approx(expected.mean(), rel=1e-3)
