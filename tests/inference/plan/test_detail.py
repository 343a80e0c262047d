# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail: light on larger cells in volumes that cover few pixels."""

from dataclasses import replace

import numpy as np
import pytest

from inference import Environment, Medium, PointLight, Settings, Sun, Volume, render
from inference.features.density_reader import SHARED_RANGE, DensityReader
from inference.features.mip_lattices import density_lattices
from inference.grids.grid import Grid
from inference.grids.working_cube import fit_cube
from inference.network.network import load_network
from inference.numerics.interpolation import halved_means
from inference.plan.detail import LARGER_CELLS, coarser_light, coarser_shadows, once_per_ray, seen_groups
from inference.plan.memory import FURTHER_BYTES
from inference.plan.plan import make_plan
from inference.runtime.tasks import SERIAL
from inference.scene.errors import SceneError
from inference.scene.sparse_grid import SparseGrid
from tests.support.volumes import SUN, camera, cloud

CLOUD = cloud(voxels=60)
MEDIUM = Medium(8.0, 0.95, 0.6)
SETTINGS = Settings()
WHOLE = replace(SETTINGS, optimizations=SETTINGS.optimizations - {"level_of_detail"})
LIGHTS = [SUN, Environment(np.full((1, 2, 3), 0.3))]


def change(found, expected):
    """Root mean square difference over that of the expected picture."""
    return float(np.sqrt(np.mean((found.rgb - expected.rgb) ** 2) / np.mean(expected.rgb**2)))


def test_cells_grow_with_the_distance_and_never_where_the_camera_is_near():
    distances = np.geomspace(0.1, 1e3, 60)
    views = [camera(distance, resolution=(200, 120)) for distance in distances]

    def light(view, medium=MEDIUM, lamps=False, settings=SETTINGS):
        return coarser_light([[(CLOUD, medium)]], lamps, view, settings)[0]

    def shadows(view, medium, settings=SETTINGS):
        return coarser_shadows([(CLOUD, medium)], view, settings)[0]

    found = [light(view) for view in views]
    assert found == sorted(found) and found[0] == 0 and found[-1] == len(LARGER_CELLS)
    thin, dense = Medium(5.0), Medium(1e5)
    of_shadows = [shadows(view, thin) for view in views]
    assert of_shadows == sorted(of_shadows) and of_shadows[0] == 0 and of_shadows[-1] > 0
    assert not any(light(view, settings=WHOLE) or shadows(view, thin, WHOLE) for view in views)
    # The light of lamps may be the transport's own, and thick cells tell the light of dense media badly.
    assert light(views[-1], lamps=True) == light(views[-1], dense) == shadows(views[-1], dense) == 0
    # Where more error is tolerated, larger cells do from nearer.
    nearer = [light(view, settings=replace(SETTINGS, tolerance=4.0)) for view in views]
    assert all(far <= near for far, near in zip(found, nearer)) and sum(nearer) > sum(found)
    thicker = [
        sum(light(views[-1], Medium(sigma_t), settings=replace(SETTINGS, tolerance=most)) for sigma_t in range(5, 500))
        for most in (1.0, 4.0)
    ]
    assert thicker[1] > 2 * thicker[0]
    # A network that knows suns alone has cells of its own.
    assert light(views[-1], settings=replace(SETTINGS, model="paper")) == 0


def moved(shift, factor=1.0):
    """The cloud elsewhere; another one if its density has another factor."""
    frame = CLOUD.world_from_index.copy()
    frame[:3, 3] += shift
    return Volume(CLOUD.density * np.float32(factor), frame, f"cloud {factor:g}")


@pytest.mark.parametrize(
    "lights", [[SUN], LIGHTS, [PointLight((0.0, 2.5, 0.0), 60.0, 0.05)]], ids=["sun", "sky", "lamp"]
)
def test_light_that_volumes_outside_the_picture_scatter_is_not_computed(lights):
    """They shade what is in the picture all the same, whatever they scatter."""
    view = camera(3.0, resolution=(48, 32))
    shading = SUN.direction * 8.0 if lights[0] is SUN else np.array([0.0, 1.4, 0.0])
    others = [moved(shading, 1.1), moved([0.0, 0.0, 9.0], 1.2), moved([30.0, 0.0, 0.0], 1.3)]
    seen = seen_groups([[(one, MEDIUM)] for one in others], view, SETTINGS)
    assert seen[1:] == [False, False] and (lights[0] is not SUN or not seen[0])
    pairs = [(CLOUD, MEDIUM), *((one, MEDIUM) for one in others)]
    black = [(CLOUD, MEDIUM), *((one, replace(MEDIUM, albedo=np.zeros(3))) for one in others[1:])]
    if lights[0] is SUN:
        plan = make_plan(pairs, lights, view, SETTINGS)
        assert plan.multiple == [True, False, False, False] and any("outside the picture" in x for x in plan.left_out)
        black.insert(1, (others[0], replace(MEDIUM, albedo=np.zeros(3))))
        assert change(render(pairs, lights, view, SETTINGS), render(pairs[:1], lights, view, SETTINGS)) > 0.01
    else:
        black.insert(1, pairs[1])
    # Light paths that correct a sky's brightness go through all volumes.
    limit = 1e-3 if len(lights) > 1 else 0.0
    assert change(render(pairs, lights, view, SETTINGS), render(black, lights, view, SETTINGS)) <= limit


def test_volumes_outside_the_picture_need_little_memory():
    view = camera(3.0, resolution=(48, 32))
    behind = [(moved([0.0, 3.0 * n, 9.0], 1.0 + 0.01 * n), MEDIUM) for n in range(100)]
    pairs, limit = [(CLOUD, MEDIUM), *behind], 1 << 40
    own, whole = (make_plan(pairs, [SUN], view, replace(some, memory_limit=limit)).memory for some in (SETTINGS, WHOLE))
    assert own < 0.25 * whole
    make_plan(pairs, [SUN], view, SETTINGS)
    with pytest.raises(SceneError):
        make_plan(pairs, [SUN], view, replace(WHOLE, memory_limit=whole // 2))


def test_volumes_and_groups_are_told_apart():
    view = camera(14.0, resolution=(200, 120))
    pairs = [(volume_at(place, 0.3), Medium(sigma_t)) for place, sigma_t in ((0.0, 30.0), (13.5, 30.0), (1.0, 1e4))]
    groups = [pairs[:1], pairs[1:2], pairs[::2]]
    assert coarser_light(groups, False, view, SETTINGS) == [
        coarser_light([members], False, view, SETTINGS)[0] for members in groups
    ]
    assert coarser_shadows(pairs, view, SETTINGS) == [coarser_shadows([pair], view, SETTINGS)[0] for pair in pairs]
    assert len(set(coarser_light(groups, False, view, SETTINGS))) > 1
    assert coarser_light([], False, view, SETTINGS) == coarser_shadows([], view, SETTINGS) == []


@pytest.mark.parametrize("distance", [8.0, 14.0, 30.0])
def test_pictures_hardly_change(distance):
    turned = [volume_at(place, angle) for place, angle in ((-0.7, 0.3), (0.7, 1.9))]
    pairs, view = [(volume, MEDIUM) for volume in turned], camera(distance, resolution=(96, 64))
    plan = make_plan(pairs, LIGHTS, view, SETTINGS)
    found, expected = (render(pairs, LIGHTS, view, settings) for settings in (SETTINGS, WHOLE))
    assert sum(own.transport + own.density for own in plan.coarser) > 0
    assert 0.0 < change(found, expected) < 5e-3


@pytest.mark.parametrize("lights", [LIGHTS[:1], LIGHTS])
def test_thin_volumes_of_several_need_less_memory_for_nearly_the_same_light(lights):
    pairs = [(moved([1.2 * n, 0.0, 0.0], 1.0 + 0.01 * n), MEDIUM) for n in (-1, 0, 1)]
    view = camera(3.0, resolution=(96, 64))
    plan, whole = (make_plan(pairs, lights, view, settings) for settings in (SETTINGS, WHOLE))
    assert [own.density for own in plan.coarser] == [1, 1, 1] and plan.coarser[0].transport == 0
    # Of two further volumes.
    assert whole.memory - plan.memory > 0.8 * 2 * (FURTHER_BYTES >> 1)
    found, expected = (render(pairs, lights, view, settings) for settings in (SETTINGS, WHOLE))
    assert 0.0 < change(found, expected) < 5e-3
    # Neither one volume alone nor a dense one.
    dense = [(volume, Medium(1e3)) for volume, _ in pairs]
    for others in (pairs[:1], dense):
        assert {own.density for own in make_plan(others, lights, view, SETTINGS).coarser} == {0}


def test_colours_hardly_change():
    mask = np.random.default_rng(2).random((4, 4, 4)).repeat(15, 0).repeat(15, 1).repeat(15, 2).astype(np.float32)
    albedo = np.stack([0.95 - 0.7 * mask, 0.3 + 0.6 * mask, np.full_like(mask, 0.9)], axis=3)
    coloured, view = [(CLOUD, Medium(8.0, albedo, 0.6))], camera(60.0, resolution=(96, 64))
    assert coarser_light([[(CLOUD, MEDIUM)]], False, view, SETTINGS) == [2]
    found, expected = (render(coloured, LIGHTS, view, settings) for settings in (SETTINGS, WHOLE))
    assert 0.0 < change(found, expected) < 5e-3


def test_no_display_shows_where_cells_become_larger():
    """In a flight, the frame in which they do flickers by a thousandth more than it would without, at most."""
    distances = np.geomspace(8.0, 40.0, 400)
    cells = [coarser_light([[(CLOUD, MEDIUM)]], False, camera(d, resolution=(96, 64)), SETTINGS)[0] for d in distances]
    grow = np.flatnonzero(np.diff(cells))
    assert len(grow)

    def flicker(change, settings):
        """Of pixels, against the mean of the frames before and after, over that of the picture."""
        frames = [
            render([(CLOUD, MEDIUM)], LIGHTS, camera(distances[change] + 0.02 * n, resolution=(96, 64)), settings).rgb
            for n in range(-2, 4)
        ]
        beside = 0.5 * (np.array(frames[2:]) + frames[:-2])
        return np.sqrt(np.mean((frames[1:-1] - beside) ** 2) / np.mean(np.square(frames)))

    for change in grow:
        assert flicker(change, SETTINGS) < flicker(change, WHOLE) + 1e-3


@pytest.mark.parametrize("even", [True, False])
def test_an_even_world_is_asked_once_on_each_ray_of_a_small_volume(even):
    lights = LIGHTS[1:] if even else [Environment(np.random.default_rng(0).random((8, 16, 3)))]
    # They overlap, so that rays meet either's samples in turn.
    pairs = [(volume_at(place, angle), MEDIUM) for place, angle in ((-0.2, 0.0), (0.7, 0.0))]
    view = camera(30.0, resolution=(96, 64))
    found, expected = (render(pairs, lights, view, settings) for settings in (SETTINGS, WHOLE))
    few, many = (layer.report.counts["network points"] for layer in (found, expected))
    assert few <= found.report.counts["rays that meet density"] * 2 and few < 0.7 * many if even else few == many
    assert change(found, expected) < 5e-3


def test_an_even_world_is_asked_once_on_each_ray_of_several_volumes_that_are_not_near():
    pairs = [[(CLOUD, MEDIUM)], [(volume_at(0.5, 0.0), Medium(1e5))]]
    views = [camera(distance, resolution=(200, 120)) for distance in np.geomspace(0.1, 1e3, 60)]
    found = [once_per_ray(pairs, [0, 0], view, SETTINGS) for view in views]
    assert found == sorted(found) and found[0] == [False, False] and found[-1] == [True, True]
    # Before cells become larger, and however dense media are.
    coarser = [coarser_light(pairs[:1], False, view, SETTINGS)[0] for view in views]
    assert found[coarser.index(1) - 1] == [True, True]
    # A single volume is asked so only where its cells are larger.
    assert once_per_ray(pairs[:1], [0], views[-1], SETTINGS) == [False]
    assert once_per_ray(pairs[:1], [1], views[-1], SETTINGS) == [True]
    assert once_per_ray(pairs, [0, 0], views[-1], WHOLE) == [False, False]


@pytest.mark.parametrize("sigma_t", [3.0, 400.0])
def test_a_sky_of_small_clouds_hardly_changes(sigma_t):
    pairs = [(volume_at(1.3 * n - 5.2, 0.0), Medium(sigma_t, 0.99, 0.5)) for n in range(9)]
    view = camera(30.0, resolution=(160, 60))
    found, expected = (render(pairs, LIGHTS, view, settings) for settings in (SETTINGS, WHOLE))
    few, many = (layer.report.counts["network points"] for layer in (found, expected))
    assert few < 0.8 * many
    assert 0.0 < change(found, expected) < 5e-3


def volume_at(place, angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    matrix = np.eye(4)
    matrix[:3, :3] = [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]
    matrix[0, 3] = place
    return CLOUD.instance(matrix @ CLOUD.world_from_index, f"cloud at {place}")


def test_larger_voxels_of_shadows_lie_where_the_grid_does():
    """Shadows of a density that is linear in space are the same in voxels of any size."""
    ramp = np.broadcast_to(np.arange(1.0, 65.0, dtype=np.float32)[:, None, None], (64, 64, 64)).copy()
    volume = Volume(ramp, np.diag([1 / 64, 1 / 64, 1 / 64, 1.0]), "ramp")
    grid, towards = Grid(volume), [np.array([0.0, 0.0, 1.0])]
    index = np.random.default_rng(0).uniform(12.0, 50.0, (3, 500)).astype(np.float32)
    [own] = grid.sun_depths(towards)
    for octaves in (1, 2, 3):
        [larger] = grid.sun_depths(towards, octaves)
        np.testing.assert_allclose(larger(index, 0.05), own(index, 0.05), rtol=2e-3)


@pytest.mark.parametrize("seed", range(8))
def test_half_a_sparse_grid_equals_half_the_dense_one(seed):
    rng = np.random.default_rng(seed)
    dense = np.zeros(rng.integers(20, 50, 3), np.float32)
    for place in rng.random((6, 3)):
        middle = (place * dense.shape).astype(int)
        dense[tuple(slice(max(at - 3, 0), at + 4) for at in middle)] = rng.random()
    grid = SparseGrid.of_dense(dense)
    low, high = grid.bounds()
    cropped, expected = grid.crop(low, high), halved_means(dense[tuple(map(slice, low, high))])
    for _ in range(2):
        cropped = cropped.halved()
        np.testing.assert_allclose(cropped.dense(), expected, atol=1e-6)
        expected = halved_means(expected)
    # Those that kernels read stay within the blocks.
    assert np.all(cropped.first >= 1) and np.all(cropped.first + cropped.shape + 1 < 8 * np.array(cropped.table.shape))


class Instance:
    """What reads a volume's density."""


def test_instances_of_several_sizes_share_lattices():
    stencil = load_network("mrpnn").points
    reader = DensityReader(CLOUD, fit_cube(CLOUD), stencil)
    instances = [Instance(), Instance()]
    reader.readers.update(instances)
    thick, thin = (reader.lattices(sigma_hat, SERIAL) for sigma_hat in (10.0, 10.0 / SHARED_RANGE * 2.0))
    assert thick.values is thin.values
    for lattices, sigma_hat in ((thick, 10.0), (thin, 10.0 / SHARED_RANGE * 2.0)):
        own = density_lattices(reader.padded, sigma_hat, stencil, reader.extent)
        index = np.random.default_rng(0).integers(0, own.values.size, (500, 4))
        read = np.empty((2, 500, 4), np.float32)
        lattices.read(index, read[0])
        own.read(index, read[1])
        np.testing.assert_allclose(read[0], read[1], atol=2.0 * float(lattices.step))
        assert read[1].max() > 0.0


def test_a_hundred_instances_of_all_sizes_need_little_memory():
    rng = np.random.default_rng(0)
    pairs = []
    for number in range(100):
        volume = volume_at(2.0 * number - 100.0, rng.uniform(0.0, 6.0))
        scaled = volume.world_from_index @ np.diag([*[rng.uniform(0.5, 1.0)] * 3, 1.0])
        pairs.append((CLOUD.instance(scaled, f"cloud {number}"), MEDIUM))
    plan = make_plan(pairs, [Sun((0.4, 0.3, 0.8), 2.0)], camera(150.0, resolution=(320, 180)), SETTINGS)
    assert plan.memory < 1.5 * 2**30
