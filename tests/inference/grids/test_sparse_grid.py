# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse grids render as the dense ones do."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from benchmarks.fidelity.views import independent_density
from inference import Camera, Medium, SceneError, Settings, Sun, Volume, render
from inference.grids.dense_grid import DenseGrid
from inference.grids.grid import Grid
from inference.grids.sun_optical_depth import SunOpticalDepth
from inference.grids.working_cube import active_bounds, fit_cube, mean_density
from inference.plan.sun_columns import column_bytes
from inference.scene.optimizations import ALL
from inference.scene.sparse_grid import SparseGrid
from tests.support.paths import ROOT

# More voxels than are refined.
SHAPE = (53, 110, 41)
DIRECTIONS = [(0.0, 0.0, 1.0), (0.3, -0.9, 0.2), (-0.8, 0.5, 0.45), (0.6, 0.6, 0.6), (-0.6, -0.6, 0.6)]
SHEARED = np.array([[1.0, 0.3, 0.0, 0.0], [0.0, 0.9, 0.2, 0.0], [-0.1, 0.0, 1.1, 0.0], [0.0, 0.0, 0.0, 1.0]])


def puffs(seed=0, shape=SHAPE, count=5, size=9):
    """A few boxes of noise, not at the grid's ends."""
    random = np.random.default_rng(seed)
    density = np.zeros(shape, np.float32)
    for _ in range(count):
        low = [random.integers(2, n - size - 2) for n in shape]
        density[tuple(slice(a, a + size) for a in low)] = random.random((size,) * 3)
    return density


def placed(density, turn=None, emission=None):
    matrix = np.diag([1.0 / max(density.shape)] * 3 + [1.0])
    matrix[:3, 3] = -0.5 * np.array(density.shape) / max(density.shape)
    return Volume(density, matrix if turn is None else turn @ matrix, "puffs", emission)


def kept_sparsely(volume):
    density = SparseGrid.of_dense(volume.density)
    emission = volume.emission
    if emission is not None:
        # Every channel in the blocks of any of them.
        density = SparseGrid.of_dense(volume.density + np.abs(emission).sum(axis=3))
        emission = tuple(in_blocks_of(density, channel) for channel in volume.emission_channels())
        density = in_blocks_of(density, volume.density)
    return Volume(density, volume.world_from_index, volume.name, emission)


def in_blocks_of(grid, dense):
    values = np.zeros_like(grid.values)
    padded = np.pad(dense, [(8, 16)] * 3)
    for x, y, z in np.argwhere(grid.table):
        values[grid.table[x, y, z]] = padded[8 * x : 8 * x + 8, 8 * y : 8 * y + 8, 8 * z : 8 * z + 8]
    return grid.with_values(values)


@pytest.mark.parametrize("seed", range(4))
def test_samples_equal_those_of_the_dense_grid(seed):
    density = puffs(seed)
    grid = SparseGrid.of_dense(density)
    np.testing.assert_array_equal(grid.dense(), density)
    low, high = active_bounds(density)
    for found, expected in zip(active_bounds(grid), (low, high)):
        np.testing.assert_array_equal(found, expected)
    cropped = grid.crop(low, high)
    index = np.random.default_rng(seed).uniform(-3.0, np.array(cropped.shape) + 3.0, (20000, 3)).T.astype(np.float32)
    expected = map_coordinates(density.astype(float), index + low[:, None], order=1, mode="constant")
    assert (expected > 0.0).mean() > 0.02
    np.testing.assert_allclose(cropped.sample(index), expected, atol=2e-5)


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("sigma_t", [0.02, 0.6, 30.0])
def test_shadows_equal_those_of_the_dense_grid(direction, sigma_t):
    density, direction = puffs(), np.array(direction)
    low, high = active_bounds(density)
    dense = SunOpticalDepth(DenseGrid(density[tuple(map(slice, low, high))]), direction)
    sparse = SunOpticalDepth(SparseGrid.of_dense(density).crop(low, high), direction)
    index = np.random.default_rng(0).uniform(0.0, high - low - 1.0, (20000, 3)).T.astype(np.float32)
    expected = dense(index, sigma_t)
    assert (expected > 1e-3).mean() > 0.05
    np.testing.assert_allclose(np.exp(-sparse(index, sigma_t)), np.exp(-expected), atol=1e-3 * sigma_t**0.5)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_memory_of_shadows_is_known_beforehand(direction):
    grid = SparseGrid.of_dense(puffs())
    columns = SunOpticalDepth(grid, np.array(direction)).columns
    assert column_bytes(grid, np.array(direction)) == columns.tiles.nbytes + columns.table.nbytes


def test_the_pyramid_equals_that_of_the_dense_grid():
    dense = placed(puffs())
    sparse = kept_sparsely(dense)
    expected = mean_density(dense, fit_cube(dense))
    assert expected.max() > 0.1
    np.testing.assert_allclose(mean_density(sparse, fit_cube(sparse)), expected, atol=1e-5 * expected.max())


def rendered(pairs, suns):
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    matrix[:3, :3] *= np.linalg.det(matrix[:3, :3])
    matrix[:3, 3] = 3.0 * matrix[:3, 2]
    # Which pixels are interpolated can depend on the last digit.
    settings = Settings(2, threads=1, optimizations=ALL - {"shared_pixels"})
    return render(pairs, suns, Camera(matrix, resolution=(24, 24), fov=0.3), settings)


def compare(found, expected):
    assert (expected.alpha > 0.05).mean() > 0.1
    # Rays are cut by the densest place in cells near, which begin elsewhere in a sparse grid.
    np.testing.assert_allclose(found.alpha, expected.alpha, atol=5e-3)
    for part in ("single", "emission"):
        image = getattr(expected, part)
        np.testing.assert_allclose(getattr(found, part), image, rtol=0.01, atol=0.01 * max(image.max(), 1e-9))
    # The network reads the nearest cells, and rounding may choose another one.
    difference = found.multiple - expected.multiple
    assert np.sqrt((difference**2).mean()) < 5e-3 * np.sqrt((expected.multiple**2).mean())
    assert np.abs(difference).max() < 0.02 * expected.multiple.max()


@pytest.mark.parametrize(
    "sigma_t",
    [pytest.param(20.0, id="thin"), pytest.param((100.0, 300.0, 900.0), id="three colours", marks=pytest.mark.slow)],
)
def test_a_layer_equals_that_of_the_dense_grid(sigma_t):
    dense, medium = placed(puffs(count=20)), Medium(sigma_t, 0.9, 0.6)
    suns = [Sun((0.4, 0.3, 0.8)), Sun((-0.7, 0.5, -0.4), 0.5)]
    compare(rendered([(kept_sparsely(dense), medium)], suns), rendered([(dense, medium)], suns))


def test_a_grid_so_long_that_its_cells_are_blocks_equals_the_dense_one():
    shape = np.array((1100, 30, 30))
    matrix = np.diag([*(1.0 / shape), 1.0])
    matrix[:3, 3] = -0.5
    dense = Volume(puffs(shape=tuple(shape), count=80), matrix, "long")
    sparse, short = kept_sparsely(dense), SparseGrid.of_dense(dense.density[:1000])
    assert Grid(sparse).occupancy.cell == 8 > short.cell
    medium, sun = Medium(20.0, 0.9, 0.6), [Sun((0.4, 0.3, 0.8))]
    compare(rendered([(sparse, medium)], sun), rendered([(dense, medium)], sun))


@pytest.mark.slow
def test_emissive_and_overlapping_volumes_equal_dense_ones():
    glow = np.stack([puffs(seed) for seed in (3, 4, 5)], axis=3)
    first, second = placed(puffs(1, count=20), emission=glow), placed(puffs(2, count=20), SHEARED)
    media, sun = [Medium(40.0, 0.8, 0.3), Medium(60.0, 0.9, 0.7)], [Sun((0.4, -0.3, 0.8))]
    expected = rendered(list(zip((first, second), media)), sun)
    assert expected.emission.max() > 0.01
    compare(rendered(list(zip(map(kept_sparsely, (first, second)), media)), sun), expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cumulus", "smoke"])
def test_real_volumes_equal_dense_ones(name):
    dense = placed(independent_density(name))
    medium, sun = Medium(100.0, 1.0, 0.857), [Sun((0.3, 0.8, -0.4))]
    compare(rendered([(kept_sparsely(dense), medium)], sun), rendered([(dense, medium)], sun))


def test_densities_far_from_one_equal_dense_ones():
    density = puffs(count=20)
    sparse, dense = SparseGrid.of_dense(density * np.float32(1e9)), density
    sun = [Sun((0.4, 0.3, 0.8))]
    expected = rendered([(placed(dense), Medium(20.0, 0.9))], sun)
    volume = Volume(sparse, placed(dense).world_from_index, "bright")
    compare(rendered([(volume, Medium(20.0e-9, 0.9))], sun), expected)


def test_a_large_grid_with_few_blocks_fits_in_memory():
    """As an array it would have 1200^3 voxels."""
    blocks = np.random.default_rng(0).random((3, 8, 8, 8)).astype(np.float32)
    blocks[0] = 0.0
    count = (150, 150, 150)
    grid = SparseGrid.of_blocks((1200,) * 3, (0, 0, 0), count, np.ravel_multi_index([[0, 149]] * 3, count), blocks)
    found = Grid(placed(grid))
    assert grid.nbytes + found.occupancy.filled.nbytes < 1e8
    assert found.sample_density(np.full((3, 1), 1.0, np.float32))[0] == blocks[1, 1, 1, 1]


MEASURED = """
import numpy as np
from inference import Camera, Medium, Settings, SparseGrid, Sun, Volume, render
from inference.plan.plan import make_plan
from inference.runtime.report import process_peak_memory

random, count = np.random.default_rng(0), (64,) * 3
middle = np.linalg.norm(np.indices(count) - 31.5, axis=0)
numbers = np.flatnonzero((middle < 31.0) & (random.random(count) < 0.06))
values = random.random((len(numbers) + 1, 8, 8, 8), np.float32)
values[0] = 0.0
matrix = np.diag([1 / 512] * 3 + [1.0])
matrix[:3, 3] = -0.5
pairs = [(Volume(SparseGrid.of_blocks((512,) * 3, (0, 0, 0), count, numbers, values), matrix), Medium(20.0, 0.9, 0.5))]
suns, view = [Sun((0.5, 0.6, 0.7)), Sun((-0.1, 0.2, 0.9))], np.eye(4)
view[2, 3] = 2.0
camera, settings = Camera(view, resolution=(64, 64), fov=0.6), Settings(2, threads=2)
before = process_peak_memory()
render(pairs, suns, camera, settings)
print(make_plan(pairs, suns, camera, settings).memory, process_peak_memory() - before, values.nbytes)
"""


def test_the_plan_knows_the_memory_of_a_sparse_grid():
    """Of a grid of scattered blocks, rendered by a process of its own."""
    output = subprocess.run([sys.executable, "-c", MEASURED], cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout
    planned, used, values = map(int, output.split())
    # Blocks that touch no other change up to nine tiles of columns on each slice.
    assert used <= planned < 2e9 + 16 * values


def test_wrong_values_are_refused():
    grid = SparseGrid.of_dense(puffs())
    for value, words in ((np.nan, "NaN"), (-1.0, "negative")):
        values = grid.values.copy()
        values[1, 2, 3, 4] = value
        with pytest.raises(SceneError, match=words):
            placed(grid.with_values(values))
    with pytest.raises(SceneError, match="zero everywhere"):
        rendered([(placed(grid.with_values(0.0 * grid.values)), Medium(1.0))], [Sun((0.0, 0.0, 1.0))])
