# SPDX-License-Identifier: GPL-3.0-or-later
"""The compiled kernels that prepare fields against their twins in numpy: ordinary, extreme and random contents."""

import itertools
import time
import warnings

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from inference import Camera, Medium, PointLight, Settings, Sun, Surface, Volume, render
from inference.features.final_gather import FinalGather
from inference.features.mip_lattices import (
    SunLevels,
    build_lattices,
    density_pyramid,
    padded_pyramid,
    unit_optical_depths,
)
from inference.grids import working_cube
from inference.grids.dense_grid import DenseGrid
from inference.grids.grid import Grid
from inference.grids.lamp_optical_depth import LampOpticalDepth
from inference.grids.merge import merge, resampled
from inference.grids.optical_depth_sweep import sun_optical_depth
from inference.grids.sun_optical_depth import SunOpticalDepth
from inference.grids.working_cube import Cube, fit_cube, level0_density
from inference.kernels.field_structures import LampSlices
from inference.kernels.library import Kernels, load_kernels
from inference.marching.lamp_in_media import place_lamp
from inference.network.network import load_network
from inference.occluders.lamp_shadow_map import LampShadowMap
from inference.runtime.cancellation import Cancelled, CancelToken
from inference.scene.emitters import LampSource
from inference.scene.optimizations import ALL
from inference.scene.sparse_grid import SparseGrid
from inference.transport.diffusion import couple, solve
from inference.transport.discrete_ordinates import CELLS, DiscreteOrdinates
from inference.transport.lamp_beam import LampInCube
from inference.transport.nearby_light import NearbyMedium, nearby_light
from inference.transport.open_depths import OpenDepths, direction_depths
from inference.transport.radiance_sweep import sweep_radiance
from tests.support.marches import LAMPS, random_density, random_lamp
from tests.support.volumes import SUN, cloud

KERNELS = load_kernels()
# Largest difference over the largest value.
TOLERANCE, BETWEEN_VARIANTS = 1e-5, 1e-6
DIRECTIONS = [(0.0, 0.0, -1.0), (0.3, -0.8, 0.5), (-0.9, 0.2, 0.1), (0.5, 0.4, 0.75), (-0.577, 0.577, -0.577)]
KINDS = ("lumps", "solid", "voxels", "magnitudes")
MATRICES = {
    "along the axes": np.diag([1.0, 1.5, 0.7, 1.0]),
    "mirrored": np.diag([1.0, -1.0, 1.0, 1.0]),
    "sheared": np.array([[1.0, 0.3, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.2, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]),
}
# Seconds of processor time that one call may take: Esc must work within a second.
CALL = 0.1


def assert_close(expected, found, tolerance=TOLERANCE):
    """Equal within a part of the largest value."""
    expected = np.asarray(expected, np.float64)
    assert expected.shape == np.shape(found)
    assert np.abs(expected - found).max(initial=0.0) <= tolerance * np.abs(expected).max(initial=0.0)


def variants():
    """The kernels for every kind of processor that this one can stand in for."""
    return [Kernels(KERNELS.path, variant) for variant in range(KERNELS.best + 1)]


def some_density(kind="lumps", shape=(40, 33, 27), seed=0):
    return random_density(np.random.default_rng(seed), shape, kind)


def test_structures_take_numpy_booleans():
    """Without the warning of numpy versions that will refuse them."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert LampSlices(inside=np.bool_(True)).inside == 1


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_sun_columns(kind, direction):
    direction, density = np.array(direction) * 3.0, some_density(kind)
    for grid in (DenseGrid(density), SparseGrid.of_dense(density)):
        expected = SunOpticalDepth(grid, direction).columns
        for kernels in variants():
            found = SunOpticalDepth(grid, direction, kernels=kernels).columns
            assert found.size == expected.size
            np.testing.assert_array_equal(found.offsets, expected.offsets)
            if isinstance(grid, SparseGrid):
                np.testing.assert_array_equal(found.table, expected.table)
                assert_close(expected.tiles, found.tiles)
            else:
                assert_close(expected.depths, found.depths)
    assert_close(sun_optical_depth(density, direction, 0.5), sun_optical_depth(density, direction, 0.5, KERNELS))


POINTS = [(0.9, 0.6, 0.5), (0.52, 0.0, 0.1), (0.1, -0.05, 0.12), (-7.0, 3.0, 0.4)]
SPHERES = [
    LampSource(np.array([0.1, -0.05, 0.12]), np.array([0.1, -0.05, 0.12]), 0.2),
    LampSource(np.array([0.1, -0.05, 0.3]), np.array([0.1, -0.05, 0.12]), 0.2),
    LampSource(np.array([0.1, -0.05, 0.3]), np.array([0.1, -0.05, 0.12]), 0.2, soft_falloff=True),
]


@pytest.mark.parametrize("lamp", [*(LampSource(np.array(at), np.array(at)) for at in POINTS), *SPHERES])
@pytest.mark.parametrize("kind", KINDS)
def test_optical_depths_around_lamps(kind, lamp):
    matrix, density = np.linalg.inv(MATRICES["sheared"])[:3, :3], some_density(kind)
    linear, offset = 30.0 * matrix, np.array([19.0, 16.0, 13.0])
    points = np.random.default_rng(1).uniform(-5.0, 45.0, (3, 500)).astype(np.float32)
    for grid in (DenseGrid(density), SparseGrid.of_dense(density)):
        expected = LampOpticalDepth(grid, linear, offset, lamp)
        for kernels in variants():
            found = LampOpticalDepth(grid, linear, offset, lamp, kernels=kernels)
            for one, other in zip(expected.pyramids, found.pyramids, strict=True):
                assert_close(one.depths, other.depths)
            for sigma_t, forward in itertools.product((1e-3, 50.0), (0.0, 0.7)):
                assert_close(expected(points, sigma_t, forward), found(points, sigma_t, forward))


@pytest.mark.parametrize("kind", LAMPS)
@pytest.mark.parametrize("shadows", [False, True])
def test_light_of_lamps_in_cells(kind, shadows):
    random, roof = np.random.default_rng(8), [Surface(np.random.default_rng(4).normal(size=(4, 3, 3)) * 0.2)]
    cube = Cube(np.linalg.qr(random.normal(size=(3, 3)))[0], np.full(3, 0.05), 1.1, np.zeros(3), np.ones(3))
    emitters = random_lamp(random, kind).emitters(np.full(3, -0.5), np.full(3, 0.5), 4)
    shadow_maps = [LampShadowMap(roof, emitter.position, 64) for emitter in emitters] if shadows else None
    lamp, density = LampInCube(emitters, cube, shadow_maps, b"", np.full(3, 0.4)), some_density("lumps", (32,) * 3)
    expected, towards = lamp(DiscreteOrdinates(density, 20.0, 0.4))
    assert expected.max() > 0.0
    for kernels in variants():
        found = lamp(DiscreteOrdinates(density, 20.0, 0.4, None, kernels))
        assert_close(expected, found[0])
        np.testing.assert_array_equal(towards, found[1])


@pytest.mark.parametrize("kind", LAMPS)
def test_light_of_lamps_at_points(kind):
    random, grid = np.random.default_rng(9), Grid(Volume(some_density("lumps", (12,) * 3), np.eye(4) / 12.0))
    points = np.concatenate([random.normal(size=(301, 3)) * size for size in (0.3, 1.0, 20.0)])
    lamp = random_lamp(random, kind)
    expected = place_lamp(lamp, [grid])
    for kernels in variants():
        found = place_lamp(lamp, [grid], kernels=kernels)
        np.testing.assert_allclose(found.fluence(points), expected.fluence(points), 1e-3, 1e-9)
        np.testing.assert_allclose(found.reference(points), expected.reference(points), 1e-4)


@pytest.mark.parametrize("albedo", [0.9, "varies"])
def test_lamps_light(albedo):
    random, cube = np.random.default_rng(8), Cube(np.eye(3), np.zeros(3), 1.0, np.zeros(3), np.ones(3))
    emitters = PointLight((0.1, -0.2, 0.05), 1.0).emitters(np.full(3, -0.5), np.full(3, 0.5), 4)
    lamp, density = LampInCube(emitters, cube, None, b"", np.array([0.1, -0.2, 0.05])), some_density("lumps", (16,) * 3)
    if albedo == "varies":
        albedo = random.uniform(0.2, 1.0, density.shape).astype(np.float32)
    triangles = np.array([[[-0.2, -0.5, -0.5], [-0.2, 0.5, -0.5], [-0.2, 0.0, 0.5]]])
    expected = DiscreteOrdinates(density, 20.0, 0.4, triangles, None, albedo).lamp(lamp)
    assert expected.shape == (4, 16, 16, 16) and expected[0].max() > 0.0
    for kernels in variants():
        assert_close(expected, DiscreteOrdinates(density, 20.0, 0.4, triangles, kernels, albedo).lamp(lamp))


@pytest.mark.parametrize("walled", [False, True])
def test_light_of_a_lamp_nearby(walled):
    cube = Cube(np.eye(3), np.zeros(3), 1.0, np.zeros(3), np.ones(3))
    emitters = PointLight((0.1, -0.2, 0.05), 1.0).emitters(np.full(3, -0.5), np.full(3, 0.5), 4)
    lamp, density = LampInCube(emitters, cube, None, b"", np.array([0.1, -0.2, 0.05])), some_density("lumps", (16,) * 3)
    triangles = np.array([[[-0.2, -0.5, -0.5], [-0.2, 0.5, -0.5], [-0.2, 0.0, 0.5]]]) if walled else None

    def light(kernels):
        solver = DiscreteOrdinates(density, 20.0, 0.857, triangles, kernels, 0.9)
        return nearby_light(solver, NearbyMedium(density, 20.0, 0.857, 0.9, kernels), lamp)

    expected = light(None)
    assert expected.shape == (20, 16, 16, 16) and expected[0].max() > 0.0 and expected[16].max() > 0.0
    for kernels in variants():
        # Photons near a face fly to the one cell or the other.
        found = light(kernels)
        assert_close(expected, found, 1e-3)
        assert np.abs(found - expected).mean() < 1e-5 * np.abs(expected).mean()


@pytest.mark.parametrize("sigma_hat, anisotropy", [(1e-3, 0.0), (20.0, 0.857), (300.0, -0.4), (2000.0, 0.857)])
def test_light_gathered_around_camera_rays(sigma_hat, anisotropy):
    """Even light and smooth density: after rounding, a place may lie in another cell."""
    random, density = np.random.default_rng(6), gaussian_filter(some_density("lumps", (64,) * 3), 3.0)
    depth = sun_optical_depth(density, DIRECTIONS[2], 1.0 / 64.0)
    light = np.broadcast_to(np.array([0.7, 0.1, -0.05, 0.02], np.float32), (32, 32, 32, 4))
    points, turned = random.uniform(-0.55, 0.55, (300, 3)), np.linalg.qr(random.normal(size=(300, 3, 3)))[0]
    expected = FinalGather.of(density, depth, light, (sigma_hat, anisotropy))(points, turned)
    found = [
        FinalGather.of(density, depth, light, (sigma_hat, anisotropy), kernels)(points, turned)
        for kernels in variants()
    ]
    for gathered in found:
        for value in range(expected.shape[2]):
            assert_close(expected[:, :, value], gathered[:, :, value])
        assert_close(found[0], gathered, BETWEEN_VARIANTS)


@pytest.mark.parametrize("sigma_hat, anisotropy", [(1e-3, 0.0), (20.0, 0.857), (300.0, -0.4), (1e5, 0.857)])
def test_discrete_ordinates(sigma_hat, anisotropy):
    density, sun = some_density("lumps", (CELLS,) * 3), np.array([0.48, 0.6, 0.64])
    expected = DiscreteOrdinates(density, sigma_hat, anisotropy).light(sun)
    found = [DiscreteOrdinates(density, sigma_hat, anisotropy, None, kernels).light(sun) for kernels in variants()]
    for light in found:
        assert_close(expected, light)
        assert_close(found[0], light, BETWEEN_VARIANTS)


def test_discrete_ordinates_beside_surfaces():
    density, sun = some_density("solid", (CELLS // 2,) * 3), np.array([-0.8, 0.0, 0.6])
    triangles = np.random.default_rng(1).normal(size=(5, 3, 3)) * 0.3
    visibility = np.random.default_rng(2).random(density.shape).astype(np.float32)
    one, other = (DiscreteOrdinates(density, 30.0, 0.5, triangles, kernels) for kernels in (None, KERNELS))
    assert one.boundaries is not None
    assert_close(one.light(sun, visibility), other.light(sun, visibility))


def test_open_depths():
    random = np.random.default_rng(8)
    fine = random_density(random, (64, 64, 64), "lumps")
    # Levels as they lie in their padded arrays; points in the cube, on its faces and beyond.
    padded = [np.pad(level, 3) for level in density_pyramid(fine)[:3]]
    levels = [level[3:-3, 3:-3, 3:-3] for level in padded]
    lattice = direction_depths(np.ascontiguousarray(levels[2]))
    positions = np.concatenate([random.uniform(-0.5, 0.5, (500, 3)), random.choice([-0.5, 0.5], (8, 3)), [[0.7, 0, 0]]])
    expected = OpenDepths(levels[:2], lattice)(positions)
    for kernels in variants():
        assert_close(lattice, direction_depths(np.ascontiguousarray(levels[2]), kernels=kernels))
        assert_close(expected, OpenDepths(levels[:2], lattice, kernels)(positions), 1e-4)


@pytest.mark.parametrize("shape", [(12, 20, 9), (1, 1, 7), (16, 16, 16)])
def test_swept_emission(shape):
    random = np.random.default_rng(0)
    extinction, emission = 10.0 ** random.uniform(-9.0, 4.0, shape), random.random(shape)
    for expected, found in zip(
        sweep_radiance(extinction, emission, 0.1, 6), sweep_radiance(extinction, emission, 0.1, 6, kernels=KERNELS)
    ):
        assert_close(expected, found)


@pytest.mark.parametrize("iterations", [3, 120])
def test_diffusion(iterations):
    random = np.random.default_rng(0)
    equation, source = couple(10.0 ** random.uniform(-4.0, 0.0, (9, 14, 11)), 0.1), random.normal(size=(9, 14, 11))
    assert_close(
        solve(equation, source, -np.inf, 1e-6, iterations), solve(equation, source, -np.inf, 1e-6, iterations, KERNELS)
    )


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("placed", MATRICES)
def test_mean_density_of_cells(placed, sparse, monkeypatch):
    monkeypatch.setattr(working_cube, "LEVEL0_CELLS", 48)
    density = some_density("lumps", (60, 44, 37))
    volume = Volume(SparseGrid.of_dense(density) if sparse else density, MATRICES[placed], "cloud")
    cube = fit_cube(volume)
    expected = level0_density(volume, cube)
    assert expected.max() > 0.0
    for kernels in variants():
        assert_close(expected, level0_density(volume, cube, kernels=kernels))


def test_pyramid():
    level0 = np.random.default_rng(0).random((256, 256, 256), np.float32)
    for expected, found in zip(density_pyramid(level0), density_pyramid(level0, KERNELS)):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("sigma_hat", [0.5, 100.0, 1e5])
@pytest.mark.parametrize("model", ["mrpnn", "mrpnn-paper"])
def test_lattices(model, sigma_hat):
    """Rounding may move a value to the next of 65536 steps."""
    stencil, volume = load_network(model).points, Volume(some_density("lumps", (30, 30, 30)), np.eye(4), "cloud")
    padded = padded_pyramid(volume, fit_cube(volume), stencil, kernels=KERNELS)
    sun = None
    if model == "mrpnn-paper":
        depths = unit_optical_depths(padded, np.array([0.48, 0.6, 0.64]), KERNELS)
        sun = SunLevels(
            depths, [np.random.default_rng(m).random(depth.shape, np.float32) for m, depth in enumerate(depths)]
        )
    arguments = padded, sigma_hat, stencil, sun, (-0.05, 0.04)
    expected = build_lattices(*arguments).values.view(np.uint16).astype(int)
    assert expected.max() > 30000
    for kernels in variants():
        found = build_lattices(*arguments, kernels=kernels).values.view(np.uint16)
        assert np.abs(found - expected).max() <= 1
        assert np.mean(found != expected) < 0.002


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
    for values, power in ((grid.density, 1), *((values, 4) for values in grid.emission[:1])):
        one, other = (resampled(grid, values, matrix, shape, kernels=found, power=power) for found in (None, KERNELS))
        assert one.max() > 0.0
        assert_close(one, other)


def test_merged_volumes():
    volumes = [Volume(some_density(seed=seed, shape=(20, 24, 18)), np.eye(4), "puff") for seed in (1, 2)]
    arguments = [Grid(volume) for volume in volumes], [Medium(3.0, 0.9, 0.2), Medium(5.0, 0.5, 0.7)], "both"
    (one, medium), (other, same) = merge(*arguments), merge(*arguments, kernels=KERNELS)
    assert_close(one.density, other.density)
    assert medium.anisotropy == pytest.approx(same.anisotropy, rel=1e-6)


class Timed(Kernels):
    """Notes how long each call takes."""

    def __init__(self, path):
        super().__init__(path)
        self.longest: dict[str, float] = {}

    def prepare(self, name, data):
        start = time.thread_time()
        found = super().prepare(name, data)
        self.longest[name] = max(self.longest.get(name, 0.0), time.thread_time() - start)
        return found


@pytest.mark.slow
def test_no_call_lasts_long():
    kernels = Timed(KERNELS.path)
    volume = Volume(np.ones((250, 400, 300), np.float32), np.eye(4), "large")
    blocks = Volume(SparseGrid.of_dense(volume.density), MATRICES["sheared"], "large")
    for one in (volume, blocks):
        padded_pyramid(one, fit_cube(one), load_network("mrpnn").points, kernels=kernels)
        Grid(one).sun_depths([np.array([0.0, 0.6, 0.8])], kernels=kernels)
    merge([Grid(blocks), Grid(volume)], [Medium(1.0), Medium(1.0)], "both", kernels=kernels)
    DiscreteOrdinates(np.ones((CELLS,) * 3, np.float32), 1e3, 0.857, None, kernels).light(np.array([0.0, 0.6, 0.8]))
    assert len(kernels.longest) == 7
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
        "columns": lambda: SunOpticalDepth(DenseGrid(density), np.array([0.0, 0.6, 0.8]), cancel, KERNELS),
        "blocks": lambda: SunOpticalDepth(SparseGrid.of_dense(density), np.array([0.0, 0.6, 0.8]), cancel, KERNELS),
        "transport": lambda: DiscreteOrdinates(cube, 5.0, 0.5, None, KERNELS).light(SUN.direction, 1.0, cancel),
        "means": lambda: level0_density(Volume(density, np.eye(4), "cloud"), fit_cube(sheared), cancel, KERNELS),
        "resampling": lambda: level0_density(sheared, fit_cube(sheared), cancel, KERNELS),
        "diffusion": lambda: solve(couple(thin, 1.0), thin, 0.0, 0.0, 10**9, KERNELS, cancel),
    }
    with pytest.raises(Cancelled):
        todo[work]()
    assert len(asked) == 2


@pytest.mark.parametrize(
    "model", ["mrpnn", *(pytest.param(model, marks=pytest.mark.slow) for model in ("mrpnn-paper", "rpnn"))]
)
def test_pictures_of_fire_and_smoke_are_equal(model):
    """Of overlapping volumes, one of which emits light."""
    smoke, fog = cloud(2), cloud(3)
    flame = np.repeat((smoke.density**2)[..., None], 3, axis=3).astype(np.float32)
    volumes = [
        (Volume(smoke.density, smoke.world_from_index, "fire", flame), Medium(20.0, 0.9, 0.5, emission=2.0)),
        (fog, Medium(10.0, 0.8, 0.5)),
    ]
    matrix = np.eye(4)
    matrix[2, 3] = 3.0
    camera, suns = Camera(matrix, resolution=(32, 24), fov=0.5), [SUN, Sun((0.3, -0.2, 0.9), 0.5)]
    one, other = (
        render(
            volumes, suns, camera, Settings(model=model, compiled=on, leave_out=ALL - {"shared_pixels", "faint_rays"})
        )
        for on in (False, True)
    )
    seen = one.alpha > 0.0
    assert one.multiple[seen].mean() > 0.0
    assert np.abs(one.rgb - other.rgb)[seen].max() < 3e-5 * one.rgb[seen].mean()
