# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that volumes emit, against closed forms and an independent integration."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from inference import Camera, Medium, SceneError, Sun, Volume, render
from inference.scene.camera_rays import camera_rays

VIEW = Camera(
    np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 6], [0, 0, 0, 1]], float), "orthographic", (4, 4), ortho_scale=0.2
)
GLOW = np.array([3.0, 1.0, 0.25], np.float32)


def slab(density, glow=GLOW, height=0.0, voxels=24):
    """A cube of edge 1 and constant emission, at a height along the view."""
    matrix = np.diag([*[1.0 / voxels] * 3, 1.0])
    matrix[:3, 3] = 0.5 / voxels - 0.5
    matrix[2, 3] += height
    shape = (voxels,) * 3
    return Volume(np.full(shape, density, np.float32), matrix, "slab", np.broadcast_to(glow, (*shape, 3)))


def test_emission_without_extinction_grows_with_path_length_and_needs_no_sun():
    layer = render([(slab(0.0), Medium(1.0))], [], VIEW)
    np.testing.assert_allclose(layer.emission[1, 2], GLOW, rtol=1e-3)
    np.testing.assert_array_equal(layer.rgb, layer.emission)
    assert layer.alpha.max() == 0.0


@pytest.mark.parametrize("sigma", [0.3, 4.0, (0.5, 2.0, 40.0), 2000.0])
def test_fog_attenuates_its_own_emission(sigma):
    """L = e (1 - exp(-sigma)) / sigma, in each channel."""
    layer = render([(slab(1.0), Medium(sigma, 0.0, emission=2.0))], [], VIEW)
    sigma = np.broadcast_to(sigma, 3)
    np.testing.assert_allclose(layer.emission[0, 0], 2.0 * GLOW * -np.expm1(-sigma) / sigma, rtol=5e-3)


def test_other_volumes_attenuate_emission_and_it_adds_to_scattered_light():
    behind, before = slab(0.0, height=-2.0), slab(1.0, glow=np.zeros(3))
    before = Volume(before.density, before.world_from_index, "fog")
    medium, sun = Medium(1.5, 0.8), Sun((0.2, 0.3, 1.0), 5.0)
    fog = render([(before, medium)], [sun], VIEW)
    both = render([(behind, Medium(1.0)), (before, medium)], [sun], VIEW)
    np.testing.assert_allclose(both.emission[2, 2], GLOW * np.exp(-1.5), rtol=5e-3)
    np.testing.assert_allclose(both.alpha, fog.alpha, rtol=1e-4)
    np.testing.assert_allclose(both.single, fog.single, rtol=1e-4)
    np.testing.assert_allclose(both.rgb, both.single + both.multiple + both.emission, rtol=1e-6)
    assert np.all(fog.emission == 0.0)


@pytest.mark.parametrize("sigma", [6.0, 300.0])
def test_a_lumpy_fire_equals_integration_in_tiny_steps(sigma):
    """Flames beside and inside smoke, in an oblique close view."""
    random = np.random.default_rng(4)
    voxels = 20
    density = random.random((voxels,) * 3) * (np.arange(voxels) < 12)
    emission = random.random((voxels, voxels, voxels, 3)) * (np.arange(voxels) > 7)[:, None]
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[0.05, 0.01, 0.0], [-0.01, 0.06, 0.0], [0.0, 0.0, 0.04]])
    matrix[:3, 3] = -matrix[:3, :3] @ np.full(3, (voxels - 1) / 2)
    fire = Volume(density, matrix, "fire", emission)
    view = Camera(VIEW.world_matrix.copy(), "perspective", (6, 5), fov=0.15)
    view.world_matrix[2, 3] = 3.0
    layer = render([(fire, Medium(sigma, 0.0))], [], view)

    origins, directions, _, _ = camera_rays(view)
    distance = np.linspace(1.5, 4.5, 30001)
    step, expected = distance[1] - distance[0], []
    for origin, direction in zip(origins, directions):
        world = origin + distance[:, None] * direction
        index = np.linalg.inv(matrix) @ np.concatenate([world, np.ones((len(world), 1))], axis=1).T

        def read(values):
            return map_coordinates(values.astype(float), index[:3], order=1, mode="grid-constant")

        tau = np.cumsum(read(fire.density)) * sigma * step
        expected.append([(np.exp(-tau) * read(fire.emission[..., c])).sum() * step for c in range(3)])
    found = layer.emission.reshape(-1, 3)
    assert np.abs(found - expected).mean() < 0.02 * np.mean(expected)
    assert found.mean() == pytest.approx(np.mean(expected), rel=0.01)


def test_blackbody_radiation_follows_the_interpolated_temperature():
    """Between a cold and a hot slice: the mean of T^4 along the path, T linear."""
    roots = np.zeros((3, 3, 2, 3), np.float32)
    roots[:, :, 1] = 2.0
    matrix = np.eye(4)
    matrix[:3, 3] = -1.0, -1.0, -0.5
    hot = Volume(np.zeros((3, 3, 2), np.float32), matrix, "hot", roots, emission_power=4)
    layer = render([(hot, Medium(1.0))], [], VIEW)
    # Rising from 0 to 2 over one unit, and falling again over the next.
    np.testing.assert_allclose(layer.emission, 2.0 * 2.0**4 / 5.0, rtol=0.01)


def test_bad_emission_is_refused_by_name():
    good = slab(1.0)
    with pytest.raises(SceneError, match="slab: emission must have"):
        Volume(good.density, good.world_from_index, "slab", np.ones((2, 2, 2, 3)))
    with pytest.raises(SceneError, match="slab: emission holds NaN"):
        Volume(good.density, good.world_from_index, "slab", np.full((*good.density.shape, 3), np.nan))
