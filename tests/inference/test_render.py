# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole renders against closed forms and symmetries."""

import gc
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from inference import (
    Camera,
    Cancelled,
    Environment,
    Medium,
    PointLight,
    SceneError,
    Settings,
    Sun,
    Volume,
    bake,
    predict_multiple,
    render,
)
from inference.network.predictor import MAX_FLUENCE
from inference.plan import plan
from inference.scene.optimizations import ALL
from inference.scene.phase_function import henyey_greenstein
from tests.support.volumes import BLACK, SUN, box, camera, cloud


def test_alpha_of_a_box_is_one_minus_transmittance():
    layer = render([(box((1.0, 1.0, 2.0)), BLACK)], [SUN], camera(projection="orthographic", ortho_scale=0.5))
    np.testing.assert_allclose(layer.alpha, 1 - np.exp(-3.0 * 2.0), rtol=2e-4)
    # Mean free-flight distance in a slab of optical depth 6, from its face at distance 2.
    expected = 2.0 + (1 / 3.0) * (1 - 7 * np.exp(-6.0)) / (1 - np.exp(-6.0))
    np.testing.assert_allclose(layer.depth, expected, rtol=5e-3)
    assert np.all(layer.rgb == 0.0)


def test_alpha_of_a_sphere_follows_its_chords():
    """Radius 0.4, extinction 3: 1 - exp(-3 chord) at every distance from the centre."""
    voxels = 96
    axis = (np.arange(voxels) + 0.5) / voxels - 0.5
    r = np.sqrt(sum(a**2 for a in np.meshgrid(axis, axis, axis, indexing="ij")))
    # The surface crosses voxels: the density falls off over one of them.
    sphere = box(voxels=voxels)
    sphere.density = np.clip((0.4 - r) * voxels + 0.5, 0.0, 1.0).astype(np.float32)
    view = camera(projection="orthographic", ortho_scale=1.0, resolution=(64, 1))
    layer = render([(sphere, BLACK)], [SUN], view)
    offset = (np.arange(64) + 0.5) / 64 - 0.5
    chord = 2.0 * np.sqrt(np.maximum(0.4**2 - offset**2, 0.0))
    inside = np.abs(offset) < 0.38
    np.testing.assert_allclose(layer.alpha[0, inside], 1 - np.exp(-3.0 * chord[inside]), atol=3e-3)
    assert np.all(layer.alpha[0, np.abs(offset) > 0.43] == 0.0)


@pytest.mark.parametrize("g", [0.0, 0.7])
def test_single_scattering_of_a_slab(g):
    """Sun behind the camera, view straight on: L = albedo p E int sigma exp(-2 sigma t) dt."""
    sigma, albedo = 4.0, 0.5
    slab = box((8.0, 8.0, 1.0), voxels=48)
    sun = Sun((0.0, 0.0, 1.0), (1.0, 2.0, 3.0))
    view = camera(6.0, projection="orthographic", ortho_scale=0.2, resolution=(4, 4))
    layer = render([(slab, Medium(sigma, albedo, g))], [sun], view)
    expected = albedo * henyey_greenstein(-1.0, g) * 0.5 * (1 - np.exp(-2 * sigma))
    np.testing.assert_allclose(layer.single / sun.irradiance, expected, rtol=0.01)


@pytest.mark.parametrize("thickness, tolerance", [(0.5, 0.02), (4.0, 0.03), (40.0, 0.3)])
def test_optically_thick_voxels(thickness, tolerance):
    """Head-on light on a dense slab: half of albedo p E, however much a voxel holds."""
    view = camera(6.0, projection="orthographic", ortho_scale=0.2, resolution=(4, 4))
    slab = box((8.0, 8.0, 1.0), voxels=16)
    layer = render([(slab, Medium(16 * thickness, 0.1))], [Sun((0.0, 0.0, 1.0))], view)
    expected = 0.1 / (4 * np.pi) * 0.5 * (1 - np.exp(-2 * 16 * thickness))
    np.testing.assert_allclose(layer.single, expected, rtol=tolerance)


def test_light_is_linear_and_parallel_suns_add():
    volumes = [(cloud(), Medium(30.0, (0.5, 0.9, 1.0), 0.5))]
    one = render(volumes, [Sun((0.4, 0.3, 0.8), 1.0)], camera())
    double = render(volumes, [Sun((0.4, 0.3, 0.8), 2.0)], camera())
    both = render(volumes, [Sun((0.4, 0.3, 0.8), 1.0), Sun((0.8, 0.6, 1.6), 1.0)], camera())
    np.testing.assert_allclose(double.rgb, 2 * one.rgb, rtol=1e-5)
    np.testing.assert_array_equal(both.rgb, double.rgb)
    assert any("parallel" in sentence for sentence in both.report.left_out)
    np.testing.assert_allclose(one.rgb, one.single + one.multiple)
    assert one.multiple.max() > 0.0


def test_same_seed_same_image_for_any_number_of_threads():
    volumes = [(cloud(), Medium(30.0, 0.9, 0.5))]
    images = [render(volumes, [SUN], camera(), Settings(threads=n)).rgb for n in (1, 2, 3)]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])
    other = render(volumes, [SUN], camera(), Settings(seed=1)).rgb
    assert not np.array_equal(images[0], other)


def test_a_region_is_cut_out_of_the_whole():
    """With interpolated pixels: test_adaptive_interpolation.py."""
    volumes, settings = [(cloud(), Medium(30.0, 0.9, 0.5))], Settings(optimizations=ALL - {"shared_pixels"})
    whole = render(volumes, [SUN], camera(), settings)
    part = render(volumes, [SUN], camera(region=(5, 3, 17, 14)), settings)
    np.testing.assert_allclose(part.rgb, whole.rgb[3:14, 5:17], rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(part.alpha, whole.alpha[3:14, 5:17], atol=1e-6)


@pytest.mark.slow(seconds=20)
def test_how_arrays_lie_in_memory_changes_nothing():
    random = np.random.default_rng(3)
    density, emission, sky = (random.random(shape).astype(np.float32) for shape in [(9, 8, 7), (9, 8, 7, 3), (4, 8, 3)])

    def found(laid_out):
        volume = Volume(laid_out(density), np.diag([0.1, 0.1, 0.1, 1.0]), "cloud", laid_out(emission))
        lights = [SUN, PointLight((0.4, 0.4, 2.0), (5.0, 5.0, 5.0)), Environment(laid_out(sky))]
        layer = render([(volume, Medium(3.0, 0.9))], lights, camera(resolution=(8, 6)), Settings(depth_samples=2))
        (lit,) = bake([(volume, Medium(3.0, 0.9))], [SUN], camera())
        return layer.rgb, np.asarray(lit.emission)

    rgb, baked = found(np.ascontiguousarray)
    assert rgb.max() > 0.0 and baked.max() > 0.0
    for laid_out in (np.asfortranarray, lambda a: a[::-1].copy()[::-1], lambda a: np.repeat(a, 2, axis=0)[::2]):
        again = found(laid_out)
        np.testing.assert_array_equal(again[0], rgb)
        np.testing.assert_array_equal(again[1], baked)


def test_rotating_translating_and_scaling_the_scene_changes_nothing():
    """Rotation, translation far from the origin, and scale at fixed optical depth."""
    medium, view = Medium(30.0, 0.9, 0.5), camera()
    still = render([(cloud(), medium)], [SUN], view)
    turn = Rotation.from_rotvec([0.5, -0.8, 0.3]).as_matrix()
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = 100.0 * turn, (3e4, -2e4, 1e4)
    volume = cloud()
    volume.world_from_index = motion @ volume.world_from_index
    moved = render(
        [(volume, Medium(0.3, 0.9, 0.5))],
        [Sun(turn @ SUN.direction, 2.0)],
        Camera(motion @ view.world_matrix, resolution=view.resolution, fov=view.fov),
    )
    np.testing.assert_allclose(moved.alpha, still.alpha, atol=1e-3)
    np.testing.assert_allclose(moved.single.mean(), still.single.mean(), rtol=1e-3)
    np.testing.assert_allclose(moved.multiple.mean(), still.multiple.mean(), rtol=1e-2)
    np.testing.assert_allclose(moved.depth[still.alpha > 0.1] / 100, still.depth[still.alpha > 0.1], rtol=1e-3)


def test_two_overlapping_parts_equal_their_sum():
    """In alpha, single and multiple scattering, shadows included."""
    whole = cloud()
    parts = []
    for share in (0.3, 0.7):
        parts.append((Volume(whole.density * np.float32(share), whole.world_from_index), Medium(30.0, 0.9, 0.5)))
    one = render([(whole, Medium(30.0, 0.9, 0.5))], [SUN], camera())
    two = render(parts, [SUN], camera())
    np.testing.assert_allclose(two.alpha, one.alpha, atol=1e-5)
    # The shadows of thin halves are interpolated where those of the sum are integrated.
    np.testing.assert_allclose(two.single, one.single, rtol=0.03, atol=1e-4)
    # The network sees one medium.
    np.testing.assert_allclose(two.multiple, one.multiple, rtol=0.01, atol=1e-3 * one.multiple.max())


def test_one_volume_shadows_another():
    # The upper box is larger, so that its soft boundary casts no shadow.
    lower, upper = box(name="lower"), box((2.0, 1.0, 2.0), name="upper")
    upper.world_from_index = upper.world_from_index.copy()
    upper.world_from_index[1, 3] += 1.5
    sun, dim = Sun((0.0, 1.0, 0.0)), Medium(2.0, 0.01)
    view = camera(projection="orthographic", ortho_scale=0.2, resolution=(4, 4))
    alone = render([(lower, dim)], [sun], view)
    shadowed = render([(lower, dim), (upper, dim)], [sun], view)
    np.testing.assert_allclose(shadowed.single, alone.single * np.exp(-2.0), rtol=0.02)


def test_extinction_may_differ_by_channel():
    medium = Medium((1.0, 3.0, 3.0), (0.8, 0.5, 0.0))
    layer = render([(cloud(), medium)], [SUN], camera())
    for channel, (sigma_t, albedo) in enumerate(zip((1.0, 3.0, 3.0), (0.8, 0.5, 0.0))):
        grey = render([(cloud(), Medium(sigma_t, albedo))], [SUN], camera())
        np.testing.assert_allclose(layer.rgb[..., channel], grey.rgb[..., channel], rtol=1e-4, atol=1e-7)


def test_multiple_scattering_vanishes_in_proportion_to_thin_media():
    volume = cloud()
    points = np.zeros((1, 3))
    thin, thinner = (
        predict_multiple(volume, Medium(s, 1.0, 0.5), SUN, points, [(0.0, 0.0, -1.0)])[0, 0] for s in (1e-3, 1e-5)
    )
    assert thinner == pytest.approx(thin / 100, rel=1e-3)


def test_predictions_match_the_image():
    """The multiple layer of an opaque box is the prediction at its face, weighted along the ray."""
    volume, medium = box(voxels=96), Medium(10.0, 0.9, 0.5)
    view = camera(projection="orthographic", ortho_scale=0.01, resolution=(1, 1))
    layer = render([(volume, medium)], [SUN], view, Settings(depth_samples=256))
    t = -np.log(1 - (np.arange(256) + 0.5) / 256 * (1 - np.exp(-10.0))) / 10.0
    points = np.stack([0 * t, 0 * t, 0.5 - t], axis=1)
    directions = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
    predicted = predict_multiple(volume, medium, SUN, points, directions)
    np.testing.assert_allclose(layer.multiple[0, 0], 0.9 * predicted.mean(axis=0) * (1 - np.exp(-10.0)), rtol=0.02)


@pytest.mark.slow
def test_sampling_error_is_what_more_depth_samples_remove():
    """Over the pixels: right in its size, and in where it is large."""

    def layer(samples):
        return render([(cloud(), Medium(30.0, 0.95, 0.5))], [SUN], camera(resolution=(96, 72)), Settings(samples))

    best = layer(96).multiple.mean(axis=2)
    for samples in (4, 8):
        found = layer(samples)
        error, told = found.multiple.mean(axis=2) - best, found.sampling_error
        lit = found.alpha > 0.01
        assert 0.5 < np.sqrt((told[lit] ** 2).mean() / (error[lit] ** 2).mean()) < 2.5
        assert np.corrcoef(told[lit], np.abs(error[lit]))[0, 1] > 0.2
        assert told[~lit].max() <= 0.1 * best[~lit].max()
    one = layer(1)
    assert np.all(one.sampling_error >= (1.0 - 1e-5) * one.multiple.mean(axis=2))


def test_fewer_samples_on_faint_rays_stay_below_the_reported_error():
    """A thin cloud, most of whose rays are faint; without this, every ray that hits it gets all samples."""

    def layer(samples, *without):
        return render(
            [(cloud(), Medium(3.0, 0.95, 0.5))],
            [SUN],
            camera(),
            Settings(samples, optimizations=ALL - {"shared_pixels", *without}),
        )

    best, fewer, every = layer(64, "faint_rays"), layer(8), layer(8, "faint_rays")
    assert every.report.counts["network points"] == 8 * np.count_nonzero(every.alpha)
    assert fewer.report.counts["network points"] < 0.7 * every.report.counts["network points"]
    np.testing.assert_array_equal(fewer.single, every.single)
    off = fewer.multiple.mean(axis=2) - best.multiple.mean(axis=2)
    assert np.sqrt((off**2).mean()) < 2.5 * np.sqrt((fewer.sampling_error**2).mean())
    assert np.sqrt((off**2).mean()) < 0.02 * best.multiple.mean()


def test_a_black_sun_leaves_alpha_unchanged():
    layer = render([(cloud(), Medium(30.0, 0.9))], [Sun((0.0, 0.0, 1.0), 0.0)], camera())
    assert np.all(layer.rgb == 0.0) and layer.alpha.max() > 0.5


def test_without_light_volumes_are_black_and_as_opaque_as_ever():
    volumes, settings = [(cloud(), Medium(30.0, 0.9))], Settings(depth_samples=2)
    dark, lit = (render(volumes, lights, camera(), settings) for lights in ([], [SUN]))
    assert not dark.rgb.any() and lit.rgb.any()
    np.testing.assert_array_equal(dark.alpha, lit.alpha)
    np.testing.assert_array_equal(dark.depth, lit.depth)
    (baked,) = bake(volumes, [])
    assert not baked.scattered.any()


def test_rendering_can_be_cancelled():
    calls = []
    with pytest.raises(Cancelled):
        render([(cloud(), Medium(30.0, 0.9))], [SUN], camera(), cancelled=lambda: calls.append(0) or len(calls) > 3)
    assert len(calls) == 4


def test_progress_grows_to_one():
    seen = []
    render([(cloud(), Medium(30.0, 0.9))], [SUN], camera(), progress=lambda fraction, message: seen.append(fraction))
    assert seen == sorted(seen) and seen[-1] == 1.0 and max(seen[:-1]) < 1.0
    assert len(set(seen)) > 5


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(volumes=[]), "no volume"),
        (dict(settings=Settings(model="nothing")), "no network called 'nothing'"),
        (dict(settings=Settings(memory_limit=1)), "raise the limit"),
        (dict(volumes=[(box(density=0.0, name="fog"), BLACK)]), "fog: .* zero everywhere"),
    ],
)
def test_a_scene_that_cannot_be_rendered_is_named(change, message):
    scene = dict(volumes=[(box(), Medium(1.0, 0.9))], lights=[SUN], camera=camera(), settings=Settings()) | change
    with pytest.raises(SceneError, match=message):
        render(**scene)


def test_warnings_name_what_is_outside_the_trained_range():
    layer = render([(box(name="fog"), Medium(1e5, 0.9, 0.99))], [SUN], camera())
    assert any("fog: anisotropy" in w for w in layer.report.warnings)
    assert any("fog: very dense" in w for w in layer.report.warnings)
    assert np.all(np.isfinite(layer.rgb)) and layer.rgb.min() >= 0.0


@pytest.mark.parametrize("anisotropy", [-0.99, 0.0, 0.999])
@pytest.mark.parametrize(
    "sigma_t", [pytest.param(1e-6, marks=pytest.mark.slow), pytest.param(1.0, marks=pytest.mark.slow), 1e7]
)
def test_outside_the_trained_range_radiance_stays_finite_and_bounded(sigma_t, anisotropy):
    """At most a conservative medium's largest fluence, all of it in the peak of the phase function."""
    random = np.random.default_rng(6)
    points, directions = random.uniform(-0.4, 0.4, (300, 3)), random.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = predict_multiple(cloud(), Medium(sigma_t, 1.0, anisotropy), SUN, points, directions)
    used = np.clip(anisotropy, -0.3, 0.95)
    most = MAX_FLUENCE * henyey_greenstein(np.sign(used), used) * SUN.irradiance[0]
    assert np.all(np.isfinite(found)) and found.min() >= 0.0 and found.max() <= most * (1 + 1e-6)
    assert found.max() > 0.0


@pytest.mark.parametrize("suns", [1, 2])
@pytest.mark.parametrize("model", ["mrpnn", "mrpnn-paper"])
def test_tiles_equal_the_whole_image(monkeypatch, suns, model):
    scene = [(cloud(), Medium(30.0, (0.9, 0.95, 1.0), 0.5))], [SUN, Sun((-0.6, 0.0, 0.8), 0.5)][:suns]
    scene += (camera(resolution=(50, 75)),)
    monkeypatch.setattr(plan, "TILE_BANDS", (4,))
    whole = render(*scene, Settings(2, model=model))
    monkeypatch.setattr(plan, "TILE_BANDS", (1,))
    tiled = render(*scene, Settings(2, model=model))
    said = [[words for words in layer.report.planned if "tiles" in words] for layer in (whole, tiled)]
    assert said == [[], ["6 tiles of up to 1089 pixels"]]
    for name in ("rgb", "alpha", "depth", "uncertainty"):
        np.testing.assert_array_equal(getattr(tiled, name), getattr(whole, name))


def test_a_volume_is_cut_by_the_clip_start():
    """As in Cycles."""
    scene, view = ([(cloud(), Medium(30.0, 0.9, 0.5))], [SUN]), camera()
    distance = np.linalg.norm(view.world_matrix[:3, 3])
    cut, whole = (render(*scene, one, Settings(1)) for one in (replace(view, clip=(distance, 100.0)), view))
    assert 0.0 < cut.alpha.max() < whole.alpha.max()
    assert not cut.report.warnings and not whole.report.warnings


@pytest.mark.parametrize(
    "light",
    [SUN, PointLight((0.0, 0.1, 0.0), 50.0, 0.02), Environment(np.ones((4, 8, 3)))],
    ids=["sun", "lamp", "World"],
)
def test_what_a_render_held_is_freed_with_it(light):
    """Without Python's search for cycles, of which any would keep arrays of many tiles in memory."""

    def held():
        names = (f"{type(value).__module__}.{type(value).__name__}" for value in gc.get_objects())
        return Counter(name for name in names if name.startswith("inference."))

    def draw():
        render([(cloud(), Medium(40.0, 0.9, 0.8))], [light], camera(resolution=(64, 64)))

    draw()
    gc.collect()
    gc.disable()
    try:
        before = held()
        draw()
        assert not held() - before
    finally:
        gc.enable()
