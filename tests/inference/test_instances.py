# SPDX-License-Identifier: GPL-3.0-or-later
"""Instances: volumes that hold the same array at different places."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from inference import Environment, Medium, PointLight, RenderCache, SceneError, Settings, Sun, Volume, render
from inference.plan.plan import make_plan
from tests.support.volumes import camera, cloud

CLOUD = cloud(voxels=20)
MEDIUM = Medium(25.0, (0.95, 0.9, 0.8), 0.4)
SKY = Environment(np.random.default_rng(0).random((4, 8, 3), np.float32))
VIEW = camera(8.0, resolution=(60, 40))


def at(place, angle=0.0, scale=1.0, density=CLOUD.density):
    """The cloud, turned about the vertical."""
    cosine, sine = np.cos(angle), np.sin(angle)
    matrix = np.eye(4)
    matrix[:3, :3] = scale * np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    matrix[:3, 3] = place
    return Volume(density, matrix @ CLOUD.world_from_index, f"cloud at {place}")


def copies(volumes):
    """The same volumes, each with an array of its own."""
    return [replace(volume, density=volume.density.copy()) for volume in volumes]


@pytest.mark.slow
@pytest.mark.parametrize("anisotropies", [(0.4, 0.4), (0.4, 0.8)], ids=["equal", "other"])
@pytest.mark.parametrize("light", ["suns and sky", "lamp"])
@pytest.mark.parametrize(
    "places", [[(0.0, 1.0), (0.0, 1.0)], [(0.0, 1.0), (0.7, 1.0)], [(0.3, 1.0), (0.3, 0.6)]], ids=str
)
def test_instances_look_like_copies(places, light, anisotropies):
    volumes = [at((1.4 * n - 0.7, 0.1 * n, 0.0), *turned) for n, turned in enumerate(places)]
    media = [Medium(MEDIUM.sigma_t / scale, MEDIUM.albedo, g) for (_, scale), g in zip(places, anisotropies)]
    lights = [PointLight((0.2, 0.3, 2.0), 40.0, 0.1)]
    if light != "lamp":
        lights = [Sun((0.4, 0.3, 0.8), 2.0), Sun((-0.5, 0.1, 0.2), 1.0), SKY]
    shared, apart = (
        render(list(zip(each, media)), lights, VIEW, cache=RenderCache()) for each in (volumes, copies(volumes))
    )
    np.testing.assert_allclose(shared.rgb, apart.rgb, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(shared.alpha, apart.alpha, rtol=1e-5, atol=1e-7)


@pytest.mark.slow
def test_alike_instances_that_overlap_look_like_copies():
    """A row too long to be one medium: some points are in two instances that are predicted together."""
    volumes = [at((0.75 * n - 1.9, 0.0, 0.0)) for n in range(6)]
    lights = [Sun((0.4, 0.3, 0.8), 2.0), SKY]
    shared, apart = (
        render([(volume, MEDIUM) for volume in each], lights, VIEW, cache=RenderCache())
        for each in (volumes, copies(volumes))
    )
    np.testing.assert_allclose(shared.rgb, apart.rgb, rtol=0.01, atol=0.01 * apart.rgb.max())
    assert shared.rgb.mean() == pytest.approx(apart.rgb.mean(), rel=1e-3)
    np.testing.assert_allclose(shared.alpha, apart.alpha, rtol=1e-5, atol=1e-7)


def test_what_instances_have_in_common_is_made_once():
    cache, volumes = RenderCache(), [at((1.3 * n - 1.3, 0.0, 0.0)) for n in range(3)]
    lights, pairs = [Sun((0.4, 0.3, 0.8), 2.0), SKY], [(volume, MEDIUM) for volume in volumes]
    render(pairs, lights, VIEW, cache=cache)
    grids = cache.grids(volumes)
    assert len({id(grid.density) for grid in grids}) == len({id(grid.occupancy) for grid in grids}) == 1
    towards = [np.array([0.0, 0.6, 0.8])]
    assert len({id(grid.sun_depths(towards)[0]) for grid in grids}) == 1
    turned = cache.grids([at((0.0, 0.0, 0.0), 0.5), at((0.0, 2.0, 0.0), 1.0)])
    assert turned[0].voxels is turned[1].voxels is grids[0].voxels
    assert turned[0].sun_depths(towards)[0] is not turned[1].sun_depths(towards)[0]


def test_a_varying_albedo_is_shared_too():
    albedo = np.linspace(0.3, 1.0, CLOUD.density.size, dtype=np.float32).reshape(CLOUD.density.shape)
    volumes = [at((1.3 * n - 0.6, 0.0, 0.0)) for n in range(2)]
    plan = make_plan([(volume, Medium(20.0, albedo)) for volume in volumes], [Sun((0, 0, 1))], VIEW, Settings())
    (first, _), (second, _) = plan.volumes
    assert first.scattering[0] is second.scattering[0] and first.voxels_key == second.voxels_key
    assert not np.array_equal(first.world_from_index, second.world_from_index)


def test_a_thousand_instances_need_little_more_memory_than_one():
    density = np.ones((156,) * 3, np.float32)
    like = Volume(density, np.eye(4) / 156.0, "one")
    places = np.stack(np.meshgrid(np.arange(40.0), np.arange(25.0), [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    pairs = []
    for place in places:
        matrix = np.diag([1 / 200.0, 1 / 200.0, 1 / 200.0, 1.0])
        matrix[:3, 3] = place
        pairs.append((like.instance(matrix, f"cloud at {place}"), Medium(20.0)))
    lights, settings = [Sun((0.3, 0.2, 1.0)), SKY], Settings(threads=2)
    one, all_of_them = (make_plan(some, lights, VIEW, settings).memory for some in (pairs[:1], pairs))
    assert all_of_them - one < 1 << 30
    apart = [(replace(volume, density=np.ones((24,) * 3, np.float32)), medium) for volume, medium in pairs]
    with pytest.raises(SceneError, match="raise the limit"):
        make_plan(apart, lights, VIEW, settings)


@pytest.mark.parametrize("overlap", [False, True])
def test_instances_need_what_is_planned(overlap):
    """Of other media, and in overlapping pairs, each of which is merged."""
    media = [Medium(20.0 + n, 0.9 - 0.02 * n, 0.1 * n) for n in range(8)]
    places = [2.6 * (n // 2) + 0.7 * (n % 2) - 4.5 if overlap else 1.3 * n - 4.5 for n in range(len(media))]
    pairs = [(at((x, 0.0, 0.0)), media[0] if overlap else medium) for x, medium in zip(places, media)]
    lights, settings, view = [Sun((0.4, 0.3, 0.8), 2.0)], Settings(threads=2), camera(12.0, resolution=(60, 12))
    tracemalloc.start()
    try:
        render(pairs, lights, view, settings)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    plan = make_plan(pairs, lights, view, settings)
    assert len(plan.groups) == (4 if overlap else 8)
    assert most < plan.memory < 2.5 * most


@pytest.mark.parametrize("coloured", [False, True])
def test_volumes_of_other_tiles_change_nothing(coloured):
    """Each tile is marched through the volumes that matter to it, in their shadows; the albedo of one may vary."""
    volumes = [(at((1.2 * n - 3.6, 0.3 * (n % 2), 0.8 * (n % 3)), 0.4 * n, 0.9), MEDIUM) for n in range(7)]
    if coloured:
        albedo = np.random.default_rng(3).uniform(0.2, 0.9, (*volumes[0][0].density.shape, 3)).astype(np.float32)
        volumes[0] = volumes[0][0], replace(MEDIUM, albedo=albedo)
    lights, view = [Sun((0.9, 0.1, 0.3), 2.0), SKY], camera(12.0, resolution=(150, 40), fov=0.8)
    settings = Settings(threads=1, optimizations=Settings().optimizations - {"missed_pixels"})
    each, together = (render(volumes, lights, view, one) for one in (Settings(threads=1), settings))
    np.testing.assert_allclose(each.rgb, together.rgb, rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(each.alpha, together.alpha)


def test_a_moved_instance_takes_the_voxels_along():
    cache = RenderCache()
    before = cache.grids([at((0.0, 0.0, 0.0))])[0]
    after = cache.grids([at((1.0, 0.0, 0.0))])[0]
    assert after is not before and after.voxels is before.voxels
