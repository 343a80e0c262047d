# SPDX-License-Identifier: GPL-3.0-or-later
"""Light paths: the laws that they obey, and another tracer."""

from ctypes import c_int32
from dataclasses import replace

import numpy as np
import pytest

from inference import Medium
from inference.grids.bound_medium import BoundMedium
from inference.grids.grid import Grid
from inference.marching.light_paths import COLLISIONS, GIVEN_UP, LEFT, MISSED, PathTracer, ScatteringMedia
from inference.marching.ray_steps import RayBatch
from inference.runtime.cancellation import Cancelled
from tests.support.kernels import VARIANTS, variant
from tests.support.marches import Recipe, random_scene
from tests.support.volumes import cloud
from training.procedural.seeded_volume import cube_volume
from training.tracer.density_grid import prepare
from training.tracer.exits import decode_directions, trace_camera_exits
from training.tracer.path_tracer import Sampling
from training.tracer.scene import PinholeCamera

RECIPES = {
    "dense": Recipe(thickness=20.0),
    "sparse": Recipe(thickness=20.0, sparse=True),
    "overlapping": Recipe(volumes=3, thickness=8.0, shear=0.4),
    "thin": Recipe(thickness=0.3),
    "voxels": Recipe(thickness=60.0, kind="voxels"),
    "varying albedo": Recipe(volumes=2, thickness=8.0, albedo=3),
    "varying albedo in blocks": Recipe(thickness=8.0, albedo=1, sparse=True),
    "inside": Recipe(thickness=5.0, projection="inside"),
}


def scattering(media, anisotropy=0.0, albedo=(0.9, 0.8, 0.95), channels=(0, 1, 2)):
    """Random media made to scatter."""
    bound = [
        replace(medium, medium=replace(medium.medium, anisotropy=anisotropy - 0.3 * v, albedo=np.array(albedo)))
        for v, medium in enumerate(media)
    ]
    return ScatteringMedia(bound, channels)


@pytest.mark.parametrize("anisotropy", [0.0, 0.857])
@pytest.mark.parametrize("recipe", RECIPES.values(), ids=RECIPES)
def test_variants_for_different_processors_agree(recipe, anisotropy):
    scene, found = random_scene(7, recipe, 24), []
    media, numbers = scattering(scene.media, anisotropy), np.arange(24) * 5
    for number in VARIANTS:
        with variant(number):
            found.append(PathTracer(media).trace(scene.rays, numbers, 10))
    expected = found[0]
    assert (expected.ends == LEFT).any()
    for other in found[1:]:
        # A rounding may decide whether one path in thousands collides.
        same = np.abs(other.directions - expected.directions).max(axis=2) < 1e-4
        assert same.mean() > 0.99 and (other.ends == expected.ends).mean() > 0.99
        np.testing.assert_allclose(other.kept[same], expected.kept[same], rtol=1e-4, atol=1e-6)


def test_albedos_that_vary_are_those_of_the_voxels():
    """What one collision keeps: the mean of the albedo, weighted by how often paths collide with it."""
    _, media = ball_media(0.05, 1.0, 0.0)
    [medium] = media.media
    half = np.arange(48) < 24
    volume = cube_volume(np.ones((48, 48, 48), np.float32), "box")
    scattered = np.where(half[:, None, None], 0.9, 0.3).astype(np.float32) * volume.density
    volume = replace(volume, scattering=(scattered,))
    media = ScatteringMedia([BoundMedium(Grid(volume), medium.medium, 0.05, [])], (0,))
    rays = rays_of(PinholeCamera((0.0, -2.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 10.0, 6), media)
    ends = PathTracer(media).trace(rays, np.arange(36), 4000)
    assert ends.kept[ends.ends == LEFT].mean() == pytest.approx(0.6, rel=0.03)


@pytest.mark.parametrize("recipe", ["dense", "sparse", "overlapping", "thin"])
def test_paths_collide_as_often_as_rays_are_opaque(recipe):
    """Beer and Lambert's law, of the interpolated density, by sums along the rays."""
    scene = random_scene(3, RECIPES[recipe], 16)
    media, rays = scattering(scene.media), scene.rays
    ends = PathTracer(media).trace(rays, np.arange(16), 4000).ends
    distance = rays.near[:, None] + (rays.far - rays.near)[:, None] * (np.arange(4000) + 0.5) / 4000
    places = rays.origins[:, None] + distance[..., None] * rays.directions[:, None]
    depth = np.zeros(16)
    for medium in media.media:
        index = medium.grid.index(places.reshape(-1, 3)).T.astype(np.float32)
        density = medium.grid.sample_density(index).reshape(distance.shape)
        depth += medium.sigma_t * density.mean(axis=1) * (rays.far - rays.near)
    np.testing.assert_allclose((ends != MISSED).mean(axis=1), 1.0 - np.exp(-depth), atol=0.035)


def ball_media(sigma, albedo, anisotropy):
    axis = (np.arange(48) + 0.5) / 48 - 0.5
    radius = np.sqrt(sum(values**2 for values in np.meshgrid(axis, axis, axis)))
    density = (radius < 0.4).astype(np.float32)
    medium = Medium(sigma, albedo, anisotropy)
    return density, ScatteringMedia([BoundMedium(Grid(cube_volume(density, "ball")), medium, sigma, [])], (0, 1, 2))


def rays_of(camera: PinholeCamera, media) -> RayBatch:
    directions = camera.rays().reshape(-1, 3).astype(np.float64)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.tile(np.array(camera.position, float), (len(directions), 1))
    near, far = media.media[0].grid.interval(origins, directions)
    return RayBatch(origins, directions, np.maximum(near, 0.0), far)


@pytest.mark.slow
@pytest.mark.parametrize("sigma, anisotropy", [(3.0, 0.857), (30.0, 0.5), (40.0, 0.0)])
def test_paths_leave_as_those_of_the_tracer_that_trains_networks(sigma, anisotropy):
    """In the same directions on the mean, after as many collisions; the two share no code."""
    density, media = ball_media(sigma, (0.9, 0.5, 1.0), anisotropy)
    camera = PinholeCamera((0.3, -2.0, 0.4), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 16.0, 12)
    exits, _, hit = trace_camera_exits(prepare(density), camera, sigma, anisotropy, Sampling(600, 2))
    rays = rays_of(camera, media)
    ends = PathTracer(media).trace(rays, np.arange(len(rays.near)), 600)
    left = ends.ends == LEFT
    assert left.mean() == pytest.approx(hit.mean(), abs=0.01)
    scatterings = exits.scatterings[hit].astype(float)
    for channel, albedo in enumerate((0.9, 0.5, 1.0)):
        assert ends.kept[left][:, channel].mean() == pytest.approx((albedo ** (scatterings + 1.0)).mean(), rel=0.02)
    bright = left & (ends.kept[..., 2] > 0.0)
    np.testing.assert_allclose(
        ends.directions[bright].mean(axis=0), decode_directions(exits.directions[hit]).mean(axis=0), atol=0.012
    )


def test_nothing_is_lost_without_absorption():
    _, media = ball_media(200.0, 1.0, 0.857)
    rays = rays_of(PinholeCamera((0.0, -2.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 10.0, 6), media)
    ends = PathTracer(media).trace(rays, np.arange(36), 50)
    np.testing.assert_array_equal(ends.kept[ends.ends != MISSED], 1.0)
    np.testing.assert_allclose(np.linalg.norm(ends.directions[ends.ends == LEFT], axis=1), 1.0, atol=1e-5)


def test_paths_that_scatter_too_often_are_given_up():
    """Beside a wall of half-space the share is about 1 / sqrt(pi COLLISIONS)."""
    _, media = ball_media(1e5, 1.0, 0.0)
    rays = rays_of(PinholeCamera((0.0, -2.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 4.0, 4), media)
    ends = PathTracer(media).trace(rays, np.arange(16), 200)
    assert 0.3 / COLLISIONS**0.5 < (ends.ends == GIVEN_UP).mean() < 3.0 / COLLISIONS**0.5


def test_paths_depend_on_the_numbers_of_rays_alone():
    scene = random_scene(5, RECIPES["dense"], 12)
    tracer = PathTracer(scattering(scene.media))
    whole, some = tracer.trace(scene.rays, np.arange(12), 20), np.array([3, 9, 4])
    part = tracer.trace(scene.rays.take(some), some, 20)
    np.testing.assert_array_equal(part.directions, whole.directions[some])
    assert not np.array_equal(tracer.trace(scene.rays, np.arange(12) + 100, 20).directions, whole.directions)


def test_paths_stop_when_asked():
    media = ScatteringMedia([BoundMedium(Grid(cloud()), Medium(50.0), 50.0, [])], (0,))
    rays = rays_of(PinholeCamera((0.0, -4.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 20.0, 6), media)
    with pytest.raises(Cancelled):
        PathTracer(media, c_int32(1)).trace(rays, np.arange(36), 10)
