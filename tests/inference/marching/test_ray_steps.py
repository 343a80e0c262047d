# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays skip empty space only, and a ray does not depend on its batch."""

import numpy as np
import pytest

from inference import Medium, Volume
from inference.grids.bound_medium import BoundMedium
from inference.grids.dense_grid import DenseGrid
from inference.grids.grid import Grid
from inference.grids.occupancy import REACH, Occupancy
from inference.marching.ray_march import MarchOptions
from inference.marching.ray_steps import RayBatch
from inference.scene.sparse_grid import SparseGrid
from tests.reference.cells import near_filled, peaks_near
from tests.support.marches import march


def sparse(shape=(31, 24, 40), share=0.002):
    random = np.random.default_rng(0)
    return np.where(random.random(shape) < share, random.random(shape), 0.0).astype(np.float32)


@pytest.mark.parametrize("storage", [DenseGrid, SparseGrid.of_dense])
def test_empty_blocks_have_no_density_within_reach(storage):
    grid = storage(sparse())
    random = np.random.default_rng(1)
    index = random.uniform(-3.0, np.array(grid.shape) + 4.0, (4000, 3)).T.astype(np.float32)
    occupancy = Occupancy(grid.cells(), grid.cell_peaks(), grid.cell, grid.cells_first)
    near, peak = near_filled(occupancy, index), peaks_near(occupancy, index)
    assert 0.1 < near.mean() < 0.9
    assert np.all(peak[~near] == 0.0)
    for _ in range(20):
        moved = index + random.uniform(-REACH, REACH, index.shape).astype(np.float32)
        assert np.all(grid.sample(moved) <= peak)


def rays(count=60):
    random = np.random.default_rng(2)
    origins = random.normal(size=(count, 3))
    origins *= 3.0 / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = random.uniform(-0.4, 0.4, (count, 3)) - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def placed(density, sigma_t):
    matrix = np.diag([1.0 / max(density.shape)] * 3 + [1.0])
    matrix[:3, 3] = -0.5
    grid = Grid(Volume(density, matrix, "sparse"))
    return BoundMedium(grid, Medium(sigma_t), sigma_t, grid.sun_depths([np.array([0.0, 0.6, 0.8])]))


@pytest.mark.parametrize("sigma_t", [30.0, 400.0, 1e5])
def test_no_density_is_skipped(sigma_t):
    """Against marching each ray in steps of a fiftieth of a voxel, without skipping."""
    medium = placed(sparse(share=0.01), sigma_t)
    grid, (origins, directions) = medium.grid, rays()
    near, far = grid.interval(origins, directions)
    meets = near < far
    origins, directions, near, far = (a[meets] for a in (origins, directions, near, far))
    found = march([medium], RayBatch(origins, directions, near, far), MarchOptions(4))
    steps = 4000
    middle = near[:, None] + (far - near)[:, None] * (np.arange(steps) + 0.5) / steps
    places = origins[:, None] + middle[..., None] * directions[:, None]
    density = grid.sample_density(grid.index(places.reshape(-1, 3)).T.astype(np.float32)).reshape(middle.shape)
    tau = sigma_t * density.mean(axis=1) * (far - near)
    assert 0.05 < -np.expm1(-tau).mean() < 0.999
    np.testing.assert_allclose(found.alpha, -np.expm1(-tau), atol=0.01)


@pytest.mark.parametrize("sigma_t", [3.0, 1e5])
def test_a_ray_does_not_depend_on_its_neighbours(sigma_t):
    medium, (origins, directions) = placed(sparse(share=0.01), sigma_t), rays()
    batch = RayBatch(origins, directions, *medium.grid.interval(origins, directions))
    meets = np.flatnonzero(batch.near < batch.far)

    def marched(chosen):
        return march([medium], batch.take(chosen), MarchOptions(4))

    together = marched(meets)
    for number in (0, 7, len(meets) - 1):
        alone = marched(meets[number : number + 1])
        assert alone.alpha[0] == together.alpha[number]
        np.testing.assert_array_equal(alone.single[0], together.single[number])
        mine = together.sample_ray == number
        np.testing.assert_array_equal(alone.sample_distance, together.sample_distance[mine])


def test_finer_voxels_hold_the_same_interpolant():
    random = np.random.default_rng(7)
    values = random.random((5, 7, 3)).astype(np.float32)
    matrix = np.array([[0.1, 0.02, 0.0, 3.0], [0.0, 0.2, 0.05, -1.0], [0.03, 0.0, 0.3, 2.0], [0.0, 0.0, 0.0, 1.0]])
    grid = Grid(Volume(values, matrix, "few voxels"))
    assert max(grid.shape) > 100
    index = random.uniform(-1.5, 7.5, (2000, 3))
    world = index @ matrix[:3, :3].T + matrix[:3, 3]
    found = grid.sample_density(grid.index(world).T.astype(np.float32))
    expected = DenseGrid(values).sample(index.T.astype(np.float32))
    np.testing.assert_allclose(found, expected, atol=2e-5)
    # The support is the same box.
    corners = grid.corners()
    ends = (corners - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
    np.testing.assert_allclose(ends.min(axis=0), -1.0, atol=1e-9)
    np.testing.assert_allclose(ends.max(axis=0), values.shape, atol=1e-9)
