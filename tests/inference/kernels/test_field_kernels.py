# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels that prepare fields, against the same in numpy: ordinary, extreme and random contents."""

import itertools
import time

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from inference import Medium, PointLight, Surface, Volume
from inference.baking.kriging import krige
from inference.baking.light_ahead import light_ahead
from inference.environments.open_depths import OpenDepths, direction_depths
from inference.features.final_gather import FinalGather
from inference.features.mip_lattices import (
    density_lattices,
    density_pyramid,
    padded_pyramid,
)
from inference.grids import working_cube
from inference.grids.dense_grid import DenseGrid
from inference.grids.grid import Grid
from inference.grids.lamp_optical_depth import LampOpticalDepth
from inference.grids.merge import merge, resampled
from inference.grids.occupancy import Occupancy
from inference.grids.optical_depth_sweep import sun_optical_depth
from inference.grids.resampling import INNER, Placement
from inference.grids.sun_optical_depth import SunOpticalDepth
from inference.grids.working_cube import Cube, fit_cube, mean_density
from inference.kernels import library
from inference.kernels.library import Kernels
from inference.marching.lamp_in_media import LEAST_FACING, place_lamp, softened
from inference.marching.ray_steps import Boxes, RayBatch
from inference.network.network import load_network
from inference.occluders.lamp_shadow_map import LampShadowMap
from inference.paper.sun_lattices import SunLevels, sun_lattices, unit_optical_depths
from inference.runtime.cancellation import Cancelled, CancelToken
from inference.scene.emitters import LampSource
from inference.scene.sparse_grid import SparseGrid
from inference.source_terms.cell_sources import LampBeam, SunBeam
from inference.source_terms.lamp_beam import LampInCube
from inference.source_terms.lamp_cells import LampCells, light_in_cells
from inference.transport.diffusion import couple, solve
from inference.transport.discrete_ordinates import CELLS, DiscreteOrdinates
from inference.transport.radiance_sweep import sweep_radiance
from tests.reference.boxes import crossed
from tests.reference.cells import halved, mean_cells, resampled_values
from tests.reference.final_gather import gathered
from tests.reference.sun_columns import cell_depths, dense_depths, depth_at, sparse_tiles
from tests.reference.transport import in_numpy, open_depths
from tests.support.kernels import VARIANTS, variant
from tests.support.marches import LAMPS, random_density, random_lamp
from tests.support.volumes import SUN

# Largest difference over the largest value.
TOLERANCE, BETWEEN_VARIANTS = 1e-5, 1e-6
DIRECTIONS = [(0.0, 0.0, -1.0), (0.3, -0.8, 0.5), (-0.9, 0.2, 0.1), (0.5, 0.4, 0.75), (-0.577, 0.577, -0.577)]
KINDS = ("lumps", "solid", "voxels", "magnitudes")
MATRICES = {
    "along the axes": np.diag([1.0, 1.5, 0.7, 1.0]),
    "mirrored": np.diag([1.0, -1.0, 1.0, 1.0]),
    "sheared": np.array([[1.0, 0.3, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.2, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]),
}
# Seconds of processor time that one call may take: Esc must work within a second, on slow and busy machines too.
CALL = 0.3


def assert_close(expected, found, tolerance=TOLERANCE):
    """Equal within a part of the largest value."""
    expected = np.asarray(expected, np.float64)
    assert expected.shape == np.shape(found)
    assert np.abs(expected - found).max(initial=0.0) <= tolerance * np.abs(expected).max(initial=0.0)


def every_variant(function):
    """What a function returns with the kernels for every kind of processor that this one can stand in for."""
    found = []
    for number in VARIANTS:
        with variant(number):
            found.append(function())
    return found


def some_density(kind="lumps", shape=(40, 33, 27), seed=0):
    return random_density(np.random.default_rng(seed), shape, kind)


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_sun_columns(kind, direction):
    direction, density = np.array(direction) * 3.0, some_density(kind)
    dense, sparse = DenseGrid(density), SparseGrid.of_dense(density)
    expected, tiles = dense_depths(dense.padded, direction), sparse_tiles(sparse, direction)
    points = np.random.default_rng(1).uniform(-8.0, 45.0, (3, 500)).astype(np.float32)
    for of_dense, of_sparse in every_variant(lambda: [SunOpticalDepth(grid, direction) for grid in (dense, sparse)]):
        assert_close(expected, of_dense.columns.depths)
        assert_close(tiles, of_sparse.columns.tiles)
        for depth in (of_dense, of_sparse):
            for sigma_t in (1e-3, 0.5, 50.0):
                inside = points.clip(-1.0, np.array(density.shape, np.float32)[:, None])
                found = depth(inside, sigma_t, may_be_outside=False)
                assert_close(np.exp(-depth_at(depth, inside, sigma_t)), np.exp(-found))
    assert_close(cell_depths(density, direction, 0.5), sun_optical_depth(density, direction, 0.5))


POINTS = [(0.9, 0.6, 0.5), (0.52, 0.0, 0.1), (0.1, -0.05, 0.12), (-7.0, 3.0, 0.4)]
SPHERES = [
    LampSource(np.array([0.1, -0.05, 0.12]), np.array([0.1, -0.05, 0.12]), 0.2),
    LampSource(np.array([0.1, -0.05, 0.3]), np.array([0.1, -0.05, 0.12]), 0.2),
    LampSource(np.array([0.1, -0.05, 0.3]), np.array([0.1, -0.05, 0.12]), 0.2, soft_falloff=True),
]


@pytest.mark.parametrize("lamp", [*(LampSource(np.array(at), np.array(at)) for at in POINTS), *SPHERES])
@pytest.mark.parametrize("kind", KINDS)
def test_optical_depths_around_lamps(kind, lamp):
    """Of points, against sums along the ways from them; of spheres, from one kind of processor to the next."""
    matrix, density = np.linalg.inv(MATRICES["sheared"])[:3, :3], some_density(kind)
    linear, offset = 30.0 * matrix, np.array([19.0, 16.0, 13.0])
    points = np.random.default_rng(1).uniform(-5.0, 45.0, (3, 500)).astype(np.float32)
    cases = list(itertools.product((1e-3, 50.0), (0.0, 0.7)))
    for grid in (DenseGrid(density), SparseGrid.of_dense(density)):
        found = every_variant(lambda grid=grid: LampOpticalDepth(grid, linear, offset, lamp))
        for other in found[1:]:
            for one, same in zip(found[0].pyramids, other.pyramids, strict=True):
                assert_close(one.depths, same.depths)
        depths = every_variant(lambda depth=found[0]: [depth(points, *case) for case in cases])
        for other in depths[1:]:
            for one, same in zip(depths[0], other):
                assert_close(one, same)
        if lamp.radius or kind in ("voxels", "magnitudes"):
            continue
        way = points - (linear @ lamp.position + offset)[:, None]
        parts = (np.arange(2000) + 0.5) / 2000
        places = points[:, :, None] - way[:, :, None] * parts
        mean = grid.sample(places.reshape(3, -1).astype(np.float32)).reshape(500, -1).mean(axis=1)
        expected = mean * np.linalg.norm(np.linalg.inv(linear) @ way, axis=0)
        # Columns between which depths are interpolated are a voxel apart.
        assert np.abs(depths[0][0] / 1e-3 - expected).mean() < 0.1 * expected.mean()


@pytest.mark.parametrize("kind", LAMPS)
@pytest.mark.parametrize("shadows", [False, True])
def test_light_of_lamps_in_cells(kind, shadows):
    """Means over points in cells, behind the depths towards each emitter."""
    random, roof = np.random.default_rng(12), [Surface(np.random.default_rng(4).normal(size=(4, 3, 3)) * 0.2)]
    emitters = random_lamp(random, kind).emitters(np.full(3, -0.5), np.full(3, 0.5), 4)
    maps = [LampShadowMap(roof, emitter.position, 64) if shadows else None for emitter in emitters]
    linear, offset, grid = 32.0 * np.eye(3), np.full(3, 15.5), DenseGrid(some_density("lumps", (32,) * 3))
    depths = [LampOpticalDepth(grid, linear, offset, emitter.source) for emitter in emitters]
    parts, radius = list(zip(emitters, depths, maps)), 0.01
    cells = LampCells((32,) * 3, np.eye(3) / 32.0, np.full(3, 0.5 / 32 - 0.5), np.zeros(3, int), 20.0, 0.3)
    numbers = random.permutation(32**3)[:300]
    inside = np.stack(np.meshgrid(*[[-0.25, 0.25]] * 3, indexing="ij")).reshape(3, 1, -1)
    index = np.stack(np.unravel_index(numbers, cells.shape))[:, :, None] + inside
    points, expected = (index.reshape(3, -1).T - 15.5) / 32.0, np.zeros((2, 300 * 8))
    for emitter, depth, shadow_map in parts:
        light = softened(emitter.fluence(points), radius)
        visible = 1.0 if shadow_map is None else shadow_map.visibility(points)
        passed = np.exp(-depth(index.reshape(3, -1).astype(np.float32), 20.0, 0.3))
        expected += light * np.stack([visible * passed, np.ones(len(points))])
    expected = expected.reshape(2, 300, 8).mean(axis=2)
    assert expected.max() > 0.0
    for found in every_variant(lambda: light_in_cells(parts, cells, (numbers, 2, radius))):
        assert_close(expected, found, 1e-4)


@pytest.mark.parametrize("kind", LAMPS)
def test_light_of_lamps_at_points(kind):
    random, grid = np.random.default_rng(9), Grid(Volume(some_density("lumps", (12,) * 3), np.eye(4) / 12.0))
    points = np.concatenate([random.normal(size=(301, 3)) * size for size in (0.3, 1.0, 20.0)])
    lamp = place_lamp(random_lamp(random, kind), [grid])
    fluence, brightest = (
        np.sum([getattr(emitter, name)(points) for emitter in lamp.emitters], axis=0)
        for name in ("fluence", "brightest")
    )
    for light, reference in every_variant(lambda: (lamp.fluence(points), lamp.reference(points))):
        np.testing.assert_allclose(light, fluence, 1e-3, 1e-9)
        np.testing.assert_allclose(reference, np.maximum(fluence, LEAST_FACING * brightest), 1e-4)


def in_numpy_and_compiled(function):
    """What a function returns with sweeps in numpy, and with the kernels for every kind of processor."""
    with in_numpy():
        expected = function()
    return expected, every_variant(function)


@pytest.mark.parametrize("albedo", [0.9, "varies"])
def test_lamps_light(albedo):
    random, cube = np.random.default_rng(8), Cube(np.eye(3), np.zeros(3), 1.0, np.zeros(3), np.ones(3))
    emitters = PointLight((0.1, -0.2, 0.05), 1.0).emitters(np.full(3, -0.5), np.full(3, 0.5), 4)
    lamp, density = LampInCube(emitters, cube, None, b"", np.array([0.1, -0.2, 0.05])), some_density("lumps", (16,) * 3)
    if albedo == "varies":
        albedo = random.uniform(0.2, 1.0, density.shape).astype(np.float32)
    triangles = np.array([[[-0.2, -0.5, -0.5], [-0.2, 0.5, -0.5], [-0.2, 0.0, 0.5]]])
    expected, found = in_numpy_and_compiled(
        lambda: DiscreteOrdinates(density, 20.0, 0.4, triangles, albedo).solve(LampBeam([(lamp, 1.0)]))
    )
    assert expected.shape == (4, 16, 16, 16) and expected[0].max() > 0.0
    for light in found:
        assert_close(expected, light)


@pytest.mark.parametrize("sigma_hat, anisotropy", [(1e-3, 0.0), (20.0, 0.857), (300.0, -0.4), (2000.0, 0.857)])
def test_light_gathered_around_camera_rays(sigma_hat, anisotropy):
    """Even light and smooth density: after rounding, a place may lie in another cell."""
    random, density = np.random.default_rng(6), gaussian_filter(some_density("lumps", (64,) * 3), 3.0)
    depth = sun_optical_depth(density, DIRECTIONS[2], 1.0 / 64.0)
    light = np.broadcast_to(np.array([0.7, 0.1, -0.05, 0.02], np.float32), (32, 32, 32, 4))
    points, turned = random.uniform(-0.55, 0.55, (300, 3)), np.linalg.qr(random.normal(size=(300, 3, 3)))[0]
    gather = FinalGather.of(density, depth, light, (sigma_hat, anisotropy))
    expected, found = gathered(gather, points, turned), every_variant(lambda: gather(points, turned))
    for values in found:
        for value in range(expected.shape[2]):
            assert_close(expected[:, :, value], values[:, :, value])
        assert_close(found[0], values, BETWEEN_VARIANTS)


@pytest.mark.parametrize("sigma_hat, anisotropy", [(1e-3, 0.0), (20.0, 0.857), (300.0, -0.4), (1e5, 0.857)])
def test_discrete_ordinates(sigma_hat, anisotropy):
    density, sun = some_density("lumps", (CELLS,) * 3), np.array([0.48, 0.6, 0.64])
    expected, found = in_numpy_and_compiled(
        lambda: DiscreteOrdinates(density, sigma_hat, anisotropy).solve(SunBeam(sun))
    )
    for light in found:
        assert_close(expected, light)
        assert_close(found[0], light, BETWEEN_VARIANTS)


def test_discrete_ordinates_beside_surfaces():
    density, sun = some_density("solid", (CELLS // 2,) * 3), np.array([-0.8, 0.0, 0.6])
    triangles = np.random.default_rng(1).normal(size=(5, 3, 3)) * 0.3
    visibility = np.random.default_rng(2).random(density.shape).astype(np.float32)
    solver = DiscreteOrdinates(density, 30.0, 0.5, triangles)
    assert solver.boundaries is not None
    expected, (*_, found) = in_numpy_and_compiled(lambda: solver.solve(SunBeam(sun, visibility)))
    assert_close(expected, found)


def test_open_depths():
    random = np.random.default_rng(8)
    fine = random_density(random, (64, 64, 64), "lumps")
    # Levels as they lie in their padded arrays; points in the cube, on its faces and beyond.
    padded = [np.pad(level, 3) for level in density_pyramid(fine)[:3]]
    levels = [level[3:-3, 3:-3, 3:-3] for level in padded]
    lattice = direction_depths(np.ascontiguousarray(levels[2]))
    positions = np.concatenate([random.uniform(-0.5, 0.5, (500, 3)), random.choice([-0.5, 0.5], (8, 3)), [[0.7, 0, 0]]])
    depths = OpenDepths(levels[:2], lattice)
    for found in every_variant(lambda: depths(positions)):
        assert_close(open_depths(depths, positions), found, 1e-4)


@pytest.mark.parametrize("shape", [(12, 20, 9), (1, 1, 7), (16, 16, 16)])
def test_swept_emission(shape):
    random = np.random.default_rng(0)
    extinction, emission = 10.0 ** random.uniform(-9.0, 4.0, shape), random.random(shape)
    expected, variants = in_numpy_and_compiled(lambda: sweep_radiance(extinction, emission, 0.1, 6))
    for found in variants:
        for one, other in zip(expected, found):
            assert_close(one, other)


@pytest.mark.parametrize("shape", [(12, 20, 9), (1, 1, 7), (16, 16, 16)])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_light_ahead(direction, shape):
    random = np.random.default_rng(0)
    extinction = (10.0 ** random.uniform(-9.0, 3.0, shape)).astype(np.float32)
    sources = random.random((2, *shape)).astype(np.float32)
    expected, variants = in_numpy_and_compiled(lambda: light_ahead(extinction, sources, np.array(direction) * 3.0))
    for found in variants:
        for one, other in zip(expected, found):
            assert_close(one, other)


@pytest.mark.parametrize("shape, known", [((12, 20, 9), 300), ((1, 1, 7), 2), ((8, 8, 8), 0), ((3, 4, 5), 60)])
def test_kriging(shape, known):
    random, cells = np.random.default_rng(0), int(np.prod(shape))
    places, values = random.choice(cells, known, replace=False), random.normal(size=(known, 2))
    expected, variants = in_numpy_and_compiled(
        lambda: krige(shape, places, values, np.array([0.3, 7.0]), np.arange(cells))
    )
    for found in variants:
        assert_close(expected, found)


def test_diffusion():
    """The operator, in full, applied to the solution gives the source."""
    random, shape = np.random.default_rng(0), (5, 7, 6)
    diagonal, couplings = couple(10.0 ** random.uniform(-4.0, 0.0, shape), 0.1)
    operator, numbers = np.diag(diagonal.ravel()), np.arange(diagonal.size).reshape(shape)
    for axis in range(3):
        here, there = (np.delete(numbers, end, axis).ravel() for end in (-1, 0))
        coupling = np.delete(couplings[axis], -1, axis).ravel()
        operator[here, there], operator[there, here] = -coupling, -coupling
    source = random.normal(size=shape)
    found = solve((diagonal, couplings), source, -np.inf, 1e-12, 4000)
    assert_close(source.ravel(), operator @ found.ravel(), 1e-6)


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("placed", MATRICES)
def test_mean_density_of_cells(placed, sparse, monkeypatch):
    monkeypatch.setattr(working_cube, "LEVEL0_CELLS", 48)
    density = some_density("lumps", (60, 44, 37))
    volume = Volume(SparseGrid.of_dense(density) if sparse else density, MATRICES[placed], "cloud")
    cube = fit_cube(volume)
    if placed == "sheared":
        index_from_world = np.linalg.inv(volume.world_from_index)
        linear = index_from_world[:3, :3] @ cube.rotation * cube.edge / 48
        offset = index_from_world[:3, :3] @ cube.centre + index_from_world[:3, 3] + linear @ np.full(3, 0.5 - 24)
        grid = DenseGrid(density)
        occupancy = Occupancy(grid.cells(), grid.cell_peaks(), grid.cell, grid.cells_first)
        expected = resampled_values(grid, 1, occupancy, Placement(linear, offset, INNER @ linear.T), (48,) * 3)
    else:
        expected = mean_cells(density, volume, cube, 48)
    assert expected.max() > 0.0
    for found in every_variant(lambda: mean_density(volume, cube)):
        assert_close(expected, found)


def test_pyramid():
    levels = density_pyramid(np.random.default_rng(0).random((256, 256, 256), np.float32))
    for fine, found in zip(levels, levels[1:]):
        np.testing.assert_array_equal(found, halved(fine))


@pytest.mark.parametrize("sigma_hat", [0.5, 100.0, 1e5])
@pytest.mark.parametrize("model", ["mrpnn", "mrpnn-paper"])
def test_lattices(model, sigma_hat):
    """Rounding may move a value to the next of 65536 steps."""
    stencil, volume = load_network(model).points, Volume(some_density("lumps", (30, 30, 30)), np.eye(4), "cloud")
    padded = padded_pyramid(volume, fit_cube(volume), stencil)
    depths = unit_optical_depths(padded, np.array([0.48, 0.6, 0.64]))
    visible = [np.random.default_rng(m).random(depth.shape, np.float32) for m, depth in enumerate(depths)]
    medium = sigma_hat, stencil, (-0.05, 0.04)

    def lattices():
        return density_lattices(padded, *medium), sun_lattices(SunLevels(depths, visible), *medium)

    with in_numpy():
        expected = [lattice.values.astype(int) for lattice in lattices()]
    for found in every_variant(lattices):
        for kernel, numpy in zip(found, expected):
            assert numpy.max() > 30000 and np.abs(kernel.values - numpy).max() <= 1
            assert np.mean(kernel.values != numpy) < 0.002


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("scale", [0.4, 2.3])
def test_grids_at_the_voxels_of_others(scale, sparse):
    density = some_density("lumps")
    emission = np.repeat((density**2)[..., None], 3, axis=3)
    volume = Volume(density, np.diag([1.0, 0.8, 1.2, 1.0]), "fire", emission, 4)
    if sparse:
        volume = Volume(SparseGrid.of_dense(density), np.diag([1.0, 0.8, 1.2, 1.0]), "smoke")
    grid, matrix = Grid(volume), np.diag([scale, scale, scale, 1.0])
    matrix[:3, :3] = matrix[:3, :3] @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    shape = np.array([30, 25, 28])
    matrix[:3, 3] = grid.corners().mean(axis=0) - matrix[:3, :3] @ (shape / 2)
    linear, offset = grid.linear @ matrix[:3, :3], grid.linear @ matrix[:3, 3] + grid.offset
    places = INNER @ linear.T if scale > 1.0 else np.zeros((1, 3))
    for values, power in ((grid.density, 1), *((values, 4) for values in grid.emission[:1])):
        expected = resampled_values(values, power, grid.occupancy, Placement(linear, offset, places), tuple(shape))
        assert expected.max() > 0.0
        assert_close(expected, resampled(grid, values, matrix, shape, power=power))


def test_merged_volumes():
    """The extinction of a merged volume is the sum of both at its voxels."""
    volumes = [Volume(some_density(seed=seed, shape=(20, 24, 18)), np.eye(4), "puff") for seed in (1, 2)]
    grids, media = [Grid(volume) for volume in volumes], [Medium(3.0, 0.9, 0.2), Medium(5.0, 0.5, 0.7)]
    both, medium = merge(grids, media, "both")
    index = np.indices(both.density.shape).reshape(3, -1)
    world = (both.world_from_index[:3, :3] @ index).T + both.world_from_index[:3, 3]
    expected = sum(
        m.sigma_t[0] * grid.sample_density(grid.index(world).T.astype(np.float32)) for grid, m in zip(grids, media)
    )
    assert_close(expected, medium.sigma_t[0] * both.density.ravel())


class Timed(Kernels):
    """Notes how long each call takes."""

    def __init__(self, path):
        super().__init__(path)
        self.longest: dict[str, float] = {}

    def call(self, name, data):
        start = time.thread_time()
        found = super().call(name, data)
        self.longest[name] = max(self.longest.get(name, 0.0), time.thread_time() - start)
        return found


@pytest.mark.slow
def test_no_call_lasts_long(monkeypatch):
    kernels = Timed(library.load_kernels().path)
    monkeypatch.setattr(library, "load_kernels", lambda: kernels)
    volume = Volume(np.ones((250, 400, 300), np.float32), np.eye(4), "large")
    blocks = Volume(SparseGrid.of_dense(volume.density), MATRICES["sheared"], "large")
    for one in (volume, blocks):
        padded_pyramid(one, fit_cube(one), load_network("mrpnn").points)
        Grid(one).sun_depths([np.array([0.0, 0.6, 0.8])])
    merge([Grid(blocks), Grid(volume)], [Medium(1.0), Medium(1.0)], "both")
    DiscreteOrdinates(np.ones((CELLS,) * 3, np.float32), 1e3, 0.857).solve(SunBeam(np.array([0.0, 0.6, 0.8])))
    assert len(kernels.longest) == 9
    assert max(kernels.longest.values()) < CALL, kernels.longest


@pytest.mark.parametrize("work", ["columns", "blocks", "transport", "means", "resampling", "diffusion"])
def test_work_that_is_cancelled_ends(work):
    asked = []

    def cancelled():
        asked.append(work)
        return len(asked) > 1

    cancel, density = CancelToken(cancelled), np.ones((180, 180, 180), np.float32)
    cube, thin = np.ones((CELLS,) * 3, np.float32), np.full((9, 9, 9), 1e-6)
    sheared = Volume(density, MATRICES["sheared"], "cloud")
    todo = {
        "columns": lambda: SunOpticalDepth(DenseGrid(density), np.array([0.0, 0.6, 0.8]), cancel),
        "blocks": lambda: SunOpticalDepth(SparseGrid.of_dense(density), np.array([0.0, 0.6, 0.8]), cancel),
        "transport": lambda: DiscreteOrdinates(cube, 5.0, 0.5).solve(SunBeam(SUN.direction, 1.0), cancel),
        "means": lambda: mean_density(Volume(density, np.eye(4), "cloud"), fit_cube(sheared), cancel),
        "resampling": lambda: mean_density(sheared, fit_cube(sheared), cancel),
        "diffusion": lambda: solve(couple(thin, 1.0), thin, 0.0, 0.0, 10**9, cancel),
    }
    with pytest.raises(Cancelled):
        todo[work]()
    assert len(asked) == 2


@pytest.mark.parametrize("seed", range(3))
def test_where_rays_meet_boxes(seed):
    """Some rays run along faces, some within them, and some meet nothing."""
    random = np.random.default_rng(seed)
    volumes, count = 12, 3000
    linear = np.where(random.random((volumes, 1, 1)) < 0.5, np.eye(3), random.normal(size=(volumes, 3, 3)))
    low = random.integers(-2, 2, (volumes, 3)).astype(float)
    shape = random.integers(1, 300, (volumes, 3)).astype(float)
    boxes = Boxes(linear, np.zeros((volumes, 3)), shape, low, low + random.integers(1, 3, (volumes, 3)))
    directions = random.normal(size=(count, 3)) * (random.random((count, 3)) < 0.7) + [1e-9, 0.0, 0.0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = random.integers(-3, 4, (count, 3)).astype(float)
    near = random.uniform(0.0, 3.0, count)
    rays = RayBatch(origins, directions, near, near + random.uniform(0.0, 20.0, count))
    expected = crossed(boxes, rays, 32.0)
    assert 0.1 < np.isinf(expected[0]).mean() < 0.9
    for found in every_variant(lambda: boxes.crossed(rays, 32.0)):
        met = np.isfinite(expected[0])
        np.testing.assert_array_equal(np.isfinite(found[0]), met)
        for values, known in zip(found[:2], expected[:2]):
            np.testing.assert_allclose(values[met], known[met], rtol=1e-9, atol=1e-9)
        # Rounding may take a step more.
        assert np.abs(found[2] - expected[2]).max() <= 128 and np.mean(found[2] != expected[2]) < 1e-3
        np.testing.assert_array_equal(found[0][~met], np.inf)
        np.testing.assert_array_equal(found[1][~met], -np.inf)
