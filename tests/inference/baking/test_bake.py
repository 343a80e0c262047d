# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light against predictions at points, layers, closed forms and symmetries."""

import time
from dataclasses import replace

import numpy as np
import pytest

from inference import (
    Camera,
    Cancelled,
    Environment,
    Medium,
    PointLight,
    RenderCache,
    SceneError,
    Settings,
    SparseGrid,
    Sun,
    Surface,
    Volume,
    bake,
    predict_multiple,
    render,
)
from inference.baking.bake import baked_view
from inference.baking.directional_factor import ANCHORS, cubic_terms, quadratic_terms
from inference.baking.directions import make_lobe, sampled_directions
from inference.baking.lattice import DIRECTIONS, WEIGHTS
from inference.grids.grid import Grid
from inference.scene.optimizations import ALL, OPTIMIZATIONS
from tests.support.volumes import SUN, box, camera, cloud

MEDIUM = Medium(20.0, (1.0, 0.9, 0.8), 0.6)
EVERY_VOXEL = ALL - {"unseen_voxels", "smooth_light", "small_voxels"}
EXACT = Settings(directional=False, optimizations=EVERY_VOXEL)


def looking(direction) -> Camera:
    """An orthographic camera whose rays go along a direction."""
    matrix = np.eye(4)
    z = -np.asarray(direction) / np.linalg.norm(direction)
    x = np.cross([0.3, 0.9, 0.1], z)
    matrix[:3, :3] = np.stack([x / np.linalg.norm(x), np.cross(z, x / np.linalg.norm(x)), z], axis=1)
    return Camera(matrix, "orthographic", (24, 16))


def centres(lit) -> np.ndarray:
    """World positions (N, 3) of all voxels of a LitVolume."""
    voxels = np.argwhere(np.ones(lit.emission.shape[:3], bool))
    return voxels @ lit.world_from_index[:3, :3].T + lit.world_from_index[:3, 3]


def scattering(volume, medium, lit) -> np.ndarray:
    """Scattering coefficient (N, 3) at the centres of a LitVolume's voxels."""
    grid = Grid(volume)
    density = grid.sample_density(grid.index(centres(lit)).T.astype(np.float32))
    return density[:, None] * medium.sigma_t * medium.albedo


def seen_through(volume, medium, lit, view) -> np.ndarray:
    """Baked light, attenuated by its volume, in a camera's pixels: (H, W, 3)."""
    glow = Volume(np.ones(lit.emission.shape[:3]), lit.world_from_index, "light", lit.emission)
    dark = replace(medium, albedo=np.zeros(3))
    return render([(volume, dark), (glow, Medium(0.0))], [SUN], view, Settings(multiple=False)).emission


def relative(values, truth) -> float:
    return float(np.sqrt(np.mean((values - truth) ** 2)) / truth.mean())


def test_emission_at_voxel_centres_is_what_points_scatter():
    volume, view = cloud(), camera()
    [lit] = bake([(volume, MEDIUM)], [SUN], view, EXACT)
    positions, dense = centres(lit), lit.emission.reshape(-1, 3)
    filled = np.flatnonzero(dense.any(axis=1))
    assert len(filled) == np.count_nonzero(volume.density)
    towards = positions[filled] - view.world_matrix[:3, 3]
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    predicted = predict_multiple(volume, MEDIUM, SUN, positions[filled], towards)
    expected = predicted * scattering(volume, MEDIUM, lit)[filled]
    np.testing.assert_allclose(dense[filled], expected, rtol=2e-3, atol=1e-4 * expected.max())


@pytest.mark.slow
@pytest.mark.parametrize("sigma_t, anisotropy", [(5.0, 0.0), (40.0, 0.85)])
def test_baked_light_shows_the_layers_multiple_scattering(sigma_t, anisotropy):
    volume, medium, view = cloud(voxels=48), Medium(sigma_t, 0.95, anisotropy), camera(resolution=(48, 32))
    [lit] = bake([(volume, medium)], [SUN], view)
    layer = render([(volume, medium)], [SUN], view, Settings(16))
    assert relative(seen_through(volume, medium, lit, view), layer.multiple) < 0.05
    assert seen_through(volume, medium, lit, view).mean() == pytest.approx(layer.multiple.mean(), rel=0.02)


@pytest.mark.slow
def test_nothing_shines_where_there_is_no_density():
    volume = cloud()
    [lit] = bake([(volume, MEDIUM)], [SUN], camera())
    dark = scattering(volume, MEDIUM, lit) == 0.0
    assert dark.any() and np.all(lit.emission.reshape(-1, 3)[dark] == 0.0)
    assert np.all(lit.emission.reshape(-1, 3)[~dark] > 0.0)
    outside = np.array([[0.0, 0.0, 0.7], [2.0, 0.0, 0.0]])
    assert np.all(lit.towards(outside, np.tile([0.0, 0.0, -1.0], (2, 1))) == 0.0)


def test_light_adds_up_and_scales_with_irradiance():
    volume, other = cloud(), Sun((-1.0, 0.2, 0.1), (0.5, 1.0, 2.0))
    one, two, both = (bake([(volume, MEDIUM)], s, camera(), EXACT)[0] for s in ([SUN], [other], [SUN, other]))
    np.testing.assert_allclose(both.emission, one.emission + two.emission, rtol=1e-4, atol=1e-6)
    [brighter] = bake([(volume, MEDIUM)], [Sun(SUN.direction, 3.0 * SUN.irradiance)], camera(), EXACT)
    np.testing.assert_allclose(brighter.emission, 3.0 * one.emission, rtol=1e-5)


@pytest.mark.slow
def test_a_white_cloud_in_uniform_light_vanishes():
    """What scatters once and more often together has the radiance of the surroundings, 1, everywhere."""
    volume, medium = cloud(voxels=12), Medium(10.0, 1.0, 0.0)
    suns = [Sun(d, 4.0 * np.pi * w) for d, w in zip(DIRECTIONS, WEIGHTS)]
    [lit] = bake([(volume, medium)], suns, None, EXACT)
    coefficient, grid = scattering(volume, medium, lit)[:, 0], Grid(volume)
    inside = coefficient > 0.1 * coefficient.max()
    index = grid.index(centres(lit)[inside]).T.astype(np.float32)
    depths = grid.sun_depths([sun.direction for sun in suns])
    once = sum(w * np.exp(-depth(index, 10.0)) for w, depth in zip(WEIGHTS, depths))
    total = once + lit.emission[..., 0].reshape(-1)[inside] / coefficient[inside]
    assert total.mean() == pytest.approx(1.0, abs=0.05)
    assert total.std() < 0.05


def sky() -> Environment:
    """Light from everywhere, most of it from one side and from above."""
    image = np.full((16, 32, 3), 0.2, np.float32)
    image[:8, :12] = 1.0, 1.5, 2.0
    return Environment(image)


def test_light_of_an_environment_is_baked_at_once():
    volume, medium, view = cloud(voxels=48), Medium(20.0, 0.95, 0.6), camera(resolution=(48, 32))
    [lit] = bake([(volume, medium)], [sky()], view, Settings(directional=False))
    assert lit.report.counts["network points"] == lit.report.counts["voxels predicted"]
    layer = render([(volume, medium)], [sky()], view, Settings(16))
    found = seen_through(volume, medium, lit, view)
    assert relative(found, layer.multiple) < 0.05
    np.testing.assert_allclose(found.mean(axis=(0, 1)), layer.multiple.mean(axis=(0, 1)), rtol=0.02)


def test_light_of_an_environment_and_a_sun_adds_up():
    volume, view = cloud(), camera()
    one, two, both = (bake([(volume, MEDIUM)], s, view, EXACT)[0] for s in ([SUN], [sky()], [SUN, sky()]))
    np.testing.assert_allclose(both.emission, one.emission + two.emission, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("directional", [False, True])
def test_a_faint_environment_beside_a_sun_takes_few_predictions(directional):
    """Its errors hardly count there."""
    volume, view, bright = cloud(voxels=48), camera(resolution=(48, 32)), sky()
    faint = Environment(0.02 * bright.radiance)
    settings = Settings(directional=directional)
    sun, alone, both = (bake([(volume, MEDIUM)], s, view, settings)[0] for s in ([SUN], [faint], [SUN, faint]))
    points = [lit.report.counts["network points"] for lit in (sun, alone, both)]
    assert points[0] < points[2] < points[0] + 0.6 * points[1]
    parts = [seen_through(volume, MEDIUM, lit, view) for lit in (sun, alone, both)]
    assert parts[1].mean() < 0.1 * parts[0].mean()
    assert relative(parts[2], parts[0] + parts[1]) < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("light", [SUN, sky()], ids=["sun", "environment"])
def test_light_that_ground_throws_back_is_baked_with_what_scatters_once(light):
    volume, medium, view = cloud(voxels=48), Medium(20.0, 0.95, 0.6), camera(resolution=(48, 32))
    corners = np.array([[-9.0, -9.0, -0.6], [9.0, -9.0, -0.6], [9.0, 9.0, -0.6], [-9.0, 9.0, -0.6]])
    baked, layers = [], []
    for reflectance in (0.0, 0.8):
        # No camera ray ends at the ground: all of both pictures is light that the cloud scatters.
        ground = Surface(corners[[[0, 1, 2], [0, 2, 3]]], covers=False, reflectance=reflectance)
        [lit] = bake([(volume, medium)], [light], view, Settings(directional=False), surfaces=[ground])
        baked.append(seen_through(volume, medium, lit, view))
        layers.append(render([(volume, medium)], [light], view, Settings(16), surfaces=[ground]))
    assert relative(baked[0], layers[0].multiple) < 0.05
    added, expected = baked[1] - baked[0], layers[1].rgb - layers[0].rgb
    assert added.mean() == pytest.approx(expected.mean(), rel=0.02)
    assert relative(added, expected) < 0.05


@pytest.mark.slow
def test_an_environment_that_surfaces_shadow_unevenly_is_baked_as_each_point_sees_it():
    corners = np.array([[-9.0, -9.0, -0.1], [0.1, -9.0, -0.1], [0.1, 9.0, -0.1], [-9.0, 9.0, -0.1]])
    half = Surface(corners[[[0, 1, 2], [0, 2, 3]]])
    [lit] = bake([(cloud(), MEDIUM)], [sky()], camera(), EXACT, surfaces=[half])
    assert any("as each point of the volumes sees it" in sentence for sentence in lit.report.planned)
    [free] = bake([(cloud(), MEDIUM)], [sky()], camera(), EXACT)
    # The floor keeps away what comes from below.
    assert 0.6 * free.emission.mean() < lit.emission.mean() < 0.95 * free.emission.mean()


@pytest.mark.parametrize("place, error", [((0.9, 0.6, 0.5), 0.08), ((0.1, -0.05, 0.12), 0.15)])
def test_light_of_a_lamp_is_baked(place, error):
    volume, medium, view = cloud(voxels=48), Medium(20.0, 0.95, 0.6), camera(resolution=(48, 32))
    lamp = PointLight(place, (3.0, 5.0, 4.0))
    [lit] = bake([(volume, medium)], [lamp], view, Settings(directional=False))
    layer = render([(volume, medium)], [lamp], view, Settings(16))
    found = seen_through(volume, medium, lit, view)
    # Within its voxel, light of a lamp inside has a peak that no voxel holds.
    around = layer.multiple.max(axis=2) < 0.5 * layer.multiple.max()
    assert relative(found[around], layer.multiple[around]) < error
    np.testing.assert_allclose(found.mean(axis=(0, 1)), layer.multiple.mean(axis=(0, 1)), rtol=0.03)


@pytest.mark.slow
def test_without_a_camera_the_mean_over_directions_is_baked():
    volumes = [(cloud(voxels=8), MEDIUM)]
    [mean] = bake(volumes, [SUN], None, EXACT)
    cache = RenderCache()
    towards = [bake(volumes, [SUN], looking(d), EXACT, cache=cache)[0].emission for d in DIRECTIONS]
    np.testing.assert_allclose(mean.emission, np.tensordot(WEIGHTS, towards, 1), rtol=1e-3, atol=1e-6)


def test_overlapping_volumes_share_the_light():
    """Two halves of one cloud, one of them twice as white as the other."""
    whole, view = cloud(), camera()
    half = Volume(0.5 * whole.density, whole.world_from_index, "half")
    white, grey = Medium(20.0, 0.8, 0.6), Medium(20.0, 0.4, 0.6)
    first, second = bake([(half, white), (replace(half), grey)], [SUN], view, EXACT)
    np.testing.assert_allclose(second.emission, 0.5 * first.emission, rtol=1e-4)
    # Together they are a cloud of their mean albedo.
    [merged] = bake([(whole, Medium(20.0, 0.6, 0.6))], [SUN], view, EXACT)
    # On the merged grid, whose voxels are the same.
    assert relative(first.emission + second.emission, merged.emission) < 0.02


@pytest.mark.slow
def test_volumes_without_light_are_dark_in_their_place():
    clear = Volume(cloud().density, cloud().world_from_index, "clear")
    black = Volume(cloud().density, cloud().world_from_index + np.diag([0, 0, 0, 0]), "black")
    black.world_from_index[0, 3] += 3.0
    found = bake([(clear, Medium(0.0)), (cloud(), MEDIUM), (black, Medium(5.0, 0.0))], [SUN], camera())
    assert [lit.name for lit in found] == ["clear", "cloud", "black"]
    assert [bool(lit.emission.any()) for lit in found] == [False, True, False]


def test_scattered_emission_is_baked_too():
    lamp = cloud()
    lamp.emission = np.repeat(lamp.density[..., None], 3, axis=3) * np.float32(2.0)
    [lit] = bake([(lamp, MEDIUM)], [], camera(), EXACT)
    layer = render([(lamp, MEDIUM)], [], camera(), Settings(16))
    assert seen_through(cloud(), MEDIUM, lit, camera()).mean() == pytest.approx(layer.multiple.mean(), rel=0.03)


def test_surfaces_shadow_baked_light():
    corners = np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]]) + 3.0 * SUN.direction
    wall = Surface(corners[[[0, 1, 2], [0, 2, 3]]])
    [lit] = bake([(cloud(), MEDIUM)], [SUN, Sun((0.0, 0.0, -1.0), 1.0)], camera(), EXACT, surfaces=[wall])
    [alone] = bake([(cloud(), MEDIUM)], [Sun((0.0, 0.0, -1.0), 1.0)], camera(), EXACT)
    assert relative(lit.emission, alone.emission) < 0.02


def test_sparse_and_dense_grids_are_baked_alike():
    volume = cloud()
    sparse = Volume(SparseGrid.of_dense(volume.density), volume.world_from_index)
    # Dense grids of few voxels are refined for rays, sparse ones are not.
    dense, other = (bake([(v, MEDIUM)], [SUN], camera(), EXACT)[0] for v in (volume, sparse))
    assert dense.emission.shape == other.emission.shape
    assert relative(other.emission, dense.emission) < 0.02


def test_voxels_far_smaller_than_pixels_are_joined():
    volume = cloud(voxels=96)
    near, far = (bake([(volume, MEDIUM)], [SUN], camera(d), Settings(directional=False))[0] for d in (1.5, 30.0))
    assert near.emission.shape[0] > 1.5 * far.emission.shape[0]
    voxel = [np.abs(np.linalg.det(lit.world_from_index[:3, :3])) for lit in (near, far)]
    totals = [lit.emission.sum() * v for lit, v in zip((near, far), voxel)]
    assert totals[1] == pytest.approx(totals[0], rel=0.1)


def in_view(optimizations, medium, voxels):
    volume, view = cloud(voxels=voxels), camera(resolution=(48, 32))
    [lit] = bake([(volume, medium)], [SUN], view, Settings(directional=False, optimizations=optimizations))
    return seen_through(volume, medium, lit, view), lit.report.counts


@pytest.mark.parametrize(
    "name, medium, voxels",
    [("smooth_light", Medium(3.0, 0.9, 0.3), 48), ("unseen_voxels", Medium(3000.0, 0.9, 0.3), 48)],
)
def test_each_optimization_stays_within_its_budget_and_has_an_effect(name, medium, voxels):
    # Which voxels are interpolated depends on all others.
    others = ALL - {"smooth_light"} if name != "smooth_light" else ALL
    usual, counts = in_view(others, medium, voxels)
    every, all_counts = in_view(others - {name}, medium, voxels)
    assert counts["voxels predicted"] < all_counts["voxels predicted"]
    assert relative(usual, every) <= OPTIMIZATIONS[name].budget


def relative_of_joined_voxels(volume: Volume, distance: float) -> tuple[float, float]:
    """The relative error of a picture of joined voxels, and that of its mean."""
    view = camera(distance, resolution=(24, 16))
    [joined] = bake([(volume, MEDIUM)], [SUN], view, Settings(directional=False))
    [every] = bake([(volume, MEDIUM)], [SUN], view, Settings(directional=False, optimizations=ALL - {"small_voxels"}))
    assert joined.emission.size < every.emission.size
    # Seen by pixels that are means over their area, as a camera's are.
    fine = camera(distance, resolution=(192, 128))
    a, b = (
        seen_through(volume, MEDIUM, lit, fine).reshape(16, 8, 24, 8, 3).mean(axis=(1, 3)) for lit in (joined, every)
    )
    return relative(a, b), abs(a.mean() / b.mean() - 1.0)


def test_joined_voxels_stay_within_their_budget():
    assert relative_of_joined_voxels(cloud(voxels=96), 3.0)[0] <= OPTIMIZATIONS["small_voxels"].budget


def test_joined_voxels_of_few_pixels_keep_the_brightness_of_thin_walls():
    """Where they were as large as walls, light beside these, which nothing absorbs, made a ring 75 % brighter."""
    x, y, z = np.meshgrid(*[(np.arange(96) + 0.5) / 96 - 0.5] * 3, indexing="ij")
    walls = (np.abs(np.hypot(x, y) - 0.36) < 0.07) & (np.abs(z) < 0.2)
    ring = Volume(walls.astype(np.float32), cloud(voxels=96).world_from_index)
    assert relative_of_joined_voxels(ring, 12.0)[1] <= 0.06


def test_light_in_few_voxels_keeps_the_detail_of_the_density():
    volume, view = cloud(voxels=48), camera(resolution=(96, 64))
    few, full = (bake([(volume, MEDIUM)], [SUN], view, Settings(directional=False, most_voxels=n))[0] for n in (16, 0))
    assert full.fine is None and few.fine.density.shape > few.density.shape
    positions = centres(full)
    along = np.tile(-view.world_matrix[:3, 2], (len(positions), 1))
    truth = full.towards(positions, along)
    assert relative(few.towards(positions, along), truth) < 0.15
    assert relative(replace(few, fine=None).towards(positions, along), truth) > 0.3


@pytest.mark.slow
def test_the_factor_of_other_directions_is_one_along_the_baked_view():
    volume, view = cloud(voxels=16), camera()
    [lit] = bake([(volume, MEDIUM)], [SUN], view)
    filled = lit.emission.any(axis=3)
    positions, baked = centres(lit)[filled.reshape(-1)], lit.scattered[filled].mean(axis=1)
    along = positions - view.world_matrix[:3, 3]
    along /= np.linalg.norm(along, axis=1)[:, None]
    np.testing.assert_array_equal(lit.directional(positions, along, baked), 1.0)
    # Just beside it, the correction is interpolated between the centres of coarse cells.
    beside = along + [0.004, 0.0, 0.0]
    beside /= np.linalg.norm(beside, axis=1)[:, None]
    np.testing.assert_allclose(lit.directional(positions, beside, baked), 1.0, atol=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("anisotropy, error", [(0.0, 0.08), (0.85, 0.3)])
def test_other_directions_are_nearer_the_truth_than_the_baked_one(anisotropy, error):
    volume, medium = cloud(), Medium(20.0, 1.0, anisotropy)
    [lit] = bake([(volume, medium)], [SUN], looking((0.0, 0.0, -1.0)), replace(EXACT, directional=True))
    other = np.array([np.sin(np.radians(40)), 0.0, -np.cos(np.radians(40))])
    [truth] = bake([(volume, medium)], [SUN], looking(other), EXACT)
    positions = centres(lit)
    found = lit.towards(positions, np.tile(other, (len(positions), 1)))
    truth = truth.emission.reshape(-1, 3)
    assert relative(found, truth) < error
    assert relative(found, truth) < relative(lit.emission.reshape(-1, 3), truth)


@pytest.mark.slow
@pytest.mark.parametrize("anisotropy", [0.6, 0.85])
def test_a_film_around_baked_light_has_no_steps(anisotropy):
    view = camera()
    [lit] = bake([(cloud(), Medium(20.0, 1.0, anisotropy))], [SUN], view)
    positions = centres(lit)[lit.emission.any(axis=3).reshape(-1)][::7]
    frames, eye, middle = [], view.world_matrix[:3, 3], positions.mean(axis=0)
    # Frame 60 is seen by the camera that baked the light.
    for angle in np.radians(np.arange(120) - 60.0):
        turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
        rays = positions - (middle + turn @ (eye - middle))
        frames.append(lit.towards(positions, rays / np.linalg.norm(rays, axis=1)[:, None]).mean(axis=1))
    light = np.array(frames)
    assert light.mean(axis=1).max() > 1.3 * light.mean(axis=1).min()
    jumps = (light[1:-1] - 0.5 * (light[:-2] + light[2:])) / light.mean(axis=0)
    # A step of 0.6 % from one frame to the next would be one of 0.003.
    assert np.sqrt((jumps**2).mean(axis=1)).max() < 0.003


@pytest.mark.slow
@pytest.mark.parametrize("directional", [False, True])
def test_progress_is_about_that_of_time_and_does_not_wait_at_the_end(directional):
    told, start = [], time.perf_counter()

    def keep(fraction, message):
        told.append((time.perf_counter() - start, fraction))

    bake([(cloud(voxels=64), MEDIUM)], [SUN], camera(), Settings(directional=directional), keep)
    seconds, fractions = np.array(told).T
    # What is expected is within a factor of 1.5 of what was done.
    assert 0.67 < fractions[-2] < 1.0
    assert seconds[-1] - seconds[np.argmax(fractions > 0.98)] < 0.3 * seconds[-1]


@pytest.mark.slow(seconds=40)
def test_in_thin_fog_finer_voxels_take_no_more_predictions_for_other_directions():
    points = []
    for voxels in (40, 80):
        scene = [(box(voxels=voxels), Medium(1.0, 0.9, 0.5))], [SUN], camera()
        with_directions, without = (
            bake(*scene, Settings(directional=directional))[0].report.counts["network points"]
            for directional in (True, False)
        )
        points.append(with_directions - without)
    assert 1.5 * points[0] > points[1] > 1000


@pytest.mark.slow
def test_predictions_for_other_directions_do_not_grow_with_the_voxels():
    scene = [(cloud(voxels=96), MEDIUM)], [SUN], camera(resolution=(96, 64))
    [with_directions], [without] = (bake(*scene, Settings(directional=directional)) for directional in (True, False))
    more = with_directions.report.counts["network points"] - without.report.counts["network points"]
    # 6000 along each of 18 anchors, and 600 along each of the fixed directions.
    assert without.report.counts["voxels with light"] > 100_000
    assert 40_000 < more < 140_000


@pytest.mark.slow
def test_each_colour_of_a_coloured_volume_has_its_own_directions():
    volume, medium = cloud(voxels=16), Medium(40.0, (0.6, 0.9, 1.0), 0.85)
    [lit] = bake([(volume, medium)], [SUN], looking((0.0, 0.0, -1.0)), replace(EXACT, directional=True))
    other = np.array([0.0, np.sin(np.radians(40)), -np.cos(np.radians(40))])
    [truth] = bake([(volume, medium)], [SUN], looking(other), EXACT)
    positions = centres(lit)
    found, truth = lit.towards(positions, np.tile(other, (len(positions), 1))), truth.emission.reshape(-1, 3)
    filled = truth.mean(axis=1) > 0.1 * truth.mean()
    ratios, expected = (light[filled] / light[filled].mean(axis=1, keepdims=True) for light in (found, truth))
    baked = lit.emission.reshape(-1, 3)[filled]
    unturned = baked / baked.mean(axis=1, keepdims=True)
    assert np.abs(ratios - expected).mean() < 0.7 * np.abs(unturned - expected).mean()


@pytest.mark.slow
def test_light_along_the_anchors_about_the_baked_view_is_what_is_predicted_there():
    volume, medium = cloud(voxels=16), Medium(20.0, 1.0, 0.85)
    view = looking((0.0, 0.0, -1.0))
    [lit] = bake([(volume, medium)], [SUN], view, replace(EXACT, directional=True))
    positions = centres(lit)
    for anchor in ANCHORS[[2, 9]]:
        direction = anchor @ baked_view(view).frames(positions[:1])[0]
        [truth] = bake([(volume, medium)], [SUN], looking(direction), EXACT)
        found = lit.towards(positions, np.tile(direction, (len(positions), 1)))
        # Every voxel is a point of its own, but those that hardly count.
        assert relative(found, truth.emission.reshape(-1, 3)) < 0.05


def test_terms_of_other_directions_are_orthogonal_harmonics():
    # Gauss-Legendre in z and equal steps in azimuth: exact for polynomials of this degree.
    z, weights = np.polynomial.legendre.leggauss(6)
    azimuth = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    r = np.sqrt(1.0 - z * z)[:, None]
    grid = np.broadcast_arrays(r * np.cos(azimuth), r * np.sin(azimuth), z[:, None])
    directions = np.stack(grid, axis=-1).reshape(-1, 3)
    one = np.ones((len(directions), 1))
    terms = np.concatenate([one, directions, quadratic_terms(directions), cubic_terms(directions)], axis=1)
    products = terms.T @ (terms * np.repeat(weights / 24.0, 12)[:, None])
    np.testing.assert_allclose(products - np.diag(np.diag(products)), 0.0, atol=1e-12)
    assert np.diag(products).min() > 0.0


def test_other_directions_of_strong_forward_scattering_are_sampled_about_the_sun():
    lobe = make_lobe([Sun((0.0, 0.6, 0.8), 1.0)], 0.85)
    directions = sampled_directions(lobe)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    np.testing.assert_allclose(directions[: len(DIRECTIONS)], DIRECTIONS)
    near = directions @ lobe.directions[0] > np.cos(np.radians(46.0))
    assert near.sum() >= 12
    # Where no direction is brighter, those of the lattice are enough.
    assert len(sampled_directions(make_lobe([Sun((0.0, 0.6, 0.8), 1.0)], 0.0))) == len(DIRECTIONS)
    assert len(sampled_directions(make_lobe([], 0.85))) == len(DIRECTIONS)


def test_a_light_with_an_extent_is_the_mean_of_its_parts():
    directions = np.array([[0.3, 0.1, 1.0], [-0.3, 0.1, 1.0], [0.0, 0.4, 1.0]])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    extended = Sun((0.0, 0.2, 1.0), 1.0, spread=(directions, np.full(3, 1 / 3)))
    medium = Medium(8.0, 0.9, 0.5)
    [lit] = bake([(cloud(), medium)], [extended], camera(), EXACT)
    [parts] = bake([(cloud(), medium)], [Sun(d, 1 / 3) for d in directions], camera(), EXACT)
    assert lit.emission.mean() == pytest.approx(parts.emission.mean(), rel=0.1)


@pytest.mark.slow
def test_progress_rises_to_one_and_a_cache_changes_nothing():
    told, cache = [], RenderCache()
    scene = [(cloud(), MEDIUM)], [SUN], camera()
    [first] = bake(*scene, progress=lambda fraction, message: told.append(fraction), cache=cache)
    [again] = bake(*scene, cache=cache)
    assert told == sorted(told) and told[-1] == 1.0
    np.testing.assert_array_equal(first.emission, again.emission)


def test_cancelling_stops_the_bake():
    asked = []

    def cancelled():
        asked.append(None)
        return len(asked) > 20

    with pytest.raises(Cancelled):
        bake([(cloud(voxels=64), MEDIUM)], [SUN], camera(), cancelled=cancelled)


def test_scenes_that_cannot_be_baked_are_refused():
    with pytest.raises(SceneError, match="no volume"):
        bake([], [SUN])
    with pytest.raises(SceneError, match="box: the density grid is zero everywhere"):
        bake([(box(density=0.0), MEDIUM)], [SUN])
    with pytest.raises(SceneError, match="needs about .* GiB and the memory limit is 0.4 GiB"):
        bake([(cloud(voxels=256), MEDIUM)], [SUN], settings=Settings(memory_limit=400 << 20))
