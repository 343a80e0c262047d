# SPDX-License-Identifier: GPL-3.0-or-later
"""Deep samples: flattened they are the layer, and cut at any depth what a surface there leaves of it."""

import numpy as np
import pytest

from inference import (
    Camera,
    Environment,
    Medium,
    PointLight,
    RenderCache,
    Settings,
    SparseGrid,
    Sun,
    Surface,
    Volume,
    render,
    soft_sun,
)
from tests.reference.deep_compositor import seen_before

CELLS = 24
SIZE = 24, 18
# Error, relative to the brightest value, of what shows in front of a surface: the mean one, its root mean square and
# the largest. Networks read only what is in front of a surface, and predict a little otherwise.
MEAN, RMS, LARGEST = 0.01, 0.012, 0.08


def cloud(place=(0.0, 0.0, 0.0), name="cloud", emission=False):
    """A ball of uneven smoke, one unit wide."""
    axis = (np.arange(CELLS) + 0.5) / CELLS - 0.5
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    density = np.clip(4.0 - 10.0 * np.sqrt(x**2 + y**2 + z**2), 0.0, 1.0)
    density *= np.random.default_rng(1).uniform(0.3, 1.0, density.shape)
    matrix = np.diag([1.0 / CELLS, 1.0 / CELLS, 1.0 / CELLS, 1.0])
    matrix[:3, 3] = axis[0] + np.array(place)
    glow = np.stack([density**2, density**3, 0.3 * density], axis=-1) if emission else None
    return Volume(density.astype(np.float32), matrix, name, None if glow is None else glow.astype(np.float32))


def camera(distance=2.5, **changes):
    matrix = np.eye(4)
    matrix[2, 3] = distance
    return Camera(matrix, resolution=SIZE, fov=0.8, **changes)


def two_clouds(**medium):
    given = {"sigma_t": 25.0, "albedo": (1.0, 0.98, 0.9), "anisotropy": 0.5, **medium}
    return [(cloud(), Medium(**given)), (cloud((0.2, 0.1, -1.0), "behind"), Medium(8.0, 0.9, 0.2))]


SUN = Sun((1.0, 1.0, 0.3), 3.0)
AROUND = Environment(np.random.default_rng(2).uniform(0.0, 1.0, (8, 16, 3)))
SCENES = {
    "sun": (two_clouds(), [SUN], camera()),
    "panorama": (two_clouds(), [SUN], camera(1.2, projection="equirectangular")),
    "orthographic": (two_clouds(), [SUN], camera(projection="orthographic", ortho_scale=1.5)),
    "camera inside": (two_clouds(sigma_t=6.0), [SUN], camera(0.1)),
    "sky": (two_clouds(), [AROUND], camera()),
    "soft sun ahead": (two_clouds(sigma_t=3.0), soft_sun((0.1, 0.0, -1.0), (3.0, 3.0, 3.0), 0.2), camera()),
    "lamp between": (two_clouds(), [PointLight((0.1, 0.1, -0.5), (9.0, 5.0, 2.0))], camera()),
    "colours of extinction": (two_clouds(sigma_t=(30.0, 10.0, 3.0)), [SUN], camera()),
    "emission": ([(cloud(emission=True), Medium(4.0, 0.5, emission=5.0))], [SUN], camera()),
    "exposure": (two_clouds(), [SUN], camera(exposure=2.5)),
}


def layer_of(volumes, lights, view, cache=None, surfaces=(), outputs=frozenset()):
    settings = Settings(depth_samples=8, outputs=outputs)
    return render(volumes, lights, view, settings, cache=cache, surfaces=surfaces)


def deep_layer(volumes, lights, view, cache=None, surfaces=()):
    return layer_of(volumes, lights, view, cache, surfaces, frozenset({"deep"}))


def samples_by_pixel(deep):
    ends = np.cumsum(deep.counts.ravel())
    rows = np.column_stack([deep.front, deep.back, deep.rgba]).astype(float).tolist()
    return [rows[end - count : end] for end, count in zip(ends, deep.counts.ravel())]


def flattened(deep, depth=np.inf):
    found = [seen_before(samples, depth) for samples in samples_by_pixel(deep)]
    return np.array(found).reshape(*deep.counts.shape, 4)


def wall(view, depth):
    """A surface across the view, which neither shades nor lights; depth: from the camera."""
    z = view.world_matrix[2, 3] - depth
    corners = np.array([[[-90.0, -90.0, z], [90.0, -90.0, z], [0.0, 90.0, z]]])
    return Surface(corners, "wall", covers=True, shades=False, stops=False)


@pytest.mark.parametrize("name", SCENES)
def test_samples_flatten_to_the_layer_and_are_few(name):
    volumes, lights, view = SCENES[name]
    cache = RenderCache()
    layer = deep_layer(volumes, lights, view, cache)
    plain = layer_of(volumes, lights, view, cache)
    np.testing.assert_array_equal(layer.rgb, plain.rgb)
    deep, found = layer.deep, flattened(layer.deep)
    half = deep.rgba.astype(np.float16)
    deep.rgba = half.astype(np.float32)
    of_half = flattened(deep)
    for flat, within in ((found, 1e-5), (of_half, 2.0**-10)):
        np.testing.assert_allclose(flat[..., :3], layer.rgb, atol=within * layer.rgb.max())
        np.testing.assert_allclose(flat[..., 3], layer.alpha, atol=within)
    assert np.isfinite(deep.rgba).all() and deep.rgba.min() >= 0.0 and deep.rgba[:, 3].max() <= 1.0
    assert np.all(deep.back >= deep.front) and deep.front.min() >= 0.0
    pixel = np.repeat(np.arange(deep.counts.size), deep.counts.ravel())
    behind = np.flatnonzero(pixel[1:] == pixel[:-1])
    assert np.all(deep.front[behind + 1] >= deep.back[behind] * (1.0 - 1e-6))
    assert deep.counts.max() <= 64 and deep.counts.sum() < 36 * np.count_nonzero(deep.counts)
    assert not deep.counts[layer.alpha == 0.0].any()


@pytest.mark.parametrize("name", ["sun", "camera inside", "sky", "lamp between", "emission"])
def test_samples_in_front_of_a_surface_are_the_render_with_it(name):
    volumes, lights, view = SCENES[name]
    cache = RenderCache()
    layer = deep_layer(volumes, lights, view, cache)
    brightest = layer.rgb.max()
    for depth in (2.4, 2.8) if view.world_matrix[2, 3] > 1.0 else (0.2, 0.9):
        ended = layer_of(volumes, lights, view, cache, [wall(view, depth)])
        apart = flattened(layer.deep, depth) - np.concatenate([ended.rgb, ended.alpha[..., None]], axis=2)
        apart[..., :3] /= brightest
        assert np.abs(apart).mean(axis=(0, 1)).max() <= MEAN, (name, depth)
        assert np.sqrt((apart**2).mean(axis=(0, 1))).max() <= RMS, (name, depth)
        assert np.abs(apart).max() <= LARGEST, (name, depth)


def test_surfaces_of_the_scene_end_samples_also_at_their_edges():
    volumes, lights, view = SCENES["sun"]
    corners = np.array([[[-0.3, -0.4, 0.05], [0.35, -0.3, 0.05], [0.0, 0.45, 0.05]]])
    surface = Surface(corners, "triangle", covers=True, shades=False, stops=False)
    layer = deep_layer(volumes, lights, view, surfaces=[surface])
    found = flattened(layer.deep)
    np.testing.assert_allclose(found[..., :3], layer.rgb, atol=1e-5 * layer.rgb.max())
    np.testing.assert_allclose(found[..., 3], layer.alpha, atol=1e-5)


def test_a_region_without_volumes_and_a_sparse_grid():
    volumes, lights, view = SCENES["sun"]
    corner = deep_layer(volumes, lights, camera(region=(0, 0, 6, 4)))
    assert corner.deep.counts.shape == (4, 6) and not corner.deep.counts.any() and not len(corner.deep.rgba)
    whole = deep_layer(volumes, lights, view).deep
    part = deep_layer(volumes, lights, camera(region=(6, 4, 20, 13))).deep
    np.testing.assert_array_equal(part.counts, whole.counts[4:13, 6:20])
    placed = part.in_window((6, 4, 20, 13), SIZE)
    np.testing.assert_array_equal(placed.counts[4:13, 6:20], part.counts)
    np.testing.assert_allclose(placed.flat()[4:13, 6:20], whole.flat()[4:13, 6:20], atol=1e-3)
    sparse = [
        (Volume(SparseGrid.of_dense(volume.density), volume.world_from_index, volume.name), medium)
        for volume, medium in volumes
    ]
    np.testing.assert_allclose(
        deep_layer(sparse, lights, view).deep.flat(), whole.flat(), atol=2e-2 * whole.rgba[:, :3].max()
    )


def test_extreme_densities_and_clear_volumes_stay_finite():
    for sigma_t in (1e-6, 1e5):
        deep = deep_layer(two_clouds(sigma_t=sigma_t), [SUN], camera()).deep
        assert np.isfinite(deep.rgba).all() and np.isfinite(deep.front).all() and np.isfinite(deep.back).all()
    clear = deep_layer([(cloud(), Medium(0.0))], [SUN], camera()).deep
    assert not clear.counts.any() and clear.counts.shape == SIZE[::-1]
