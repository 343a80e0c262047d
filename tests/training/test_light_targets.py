# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance traced for lights of every kind: conservation laws, closed forms, photons, and the files of it."""

import signal
import subprocess
import sys

import numpy as np
import pytest

from inference import PointLight, SpotLight
from tests.support.paths import ROOT
from training.data import light_targets
from training.data.light_scene import LAMPS
from training.data.light_targets import in_turns, make_traces, read_traces
from training.tracer.density_grid import prepare
from training.tracer.lamps import _towards, place_lamps
from training.tracer.light_paths import AlbedoField, Lights, LitMedium, trace_lights
from training.tracer.path_tracer import Sampling, Scene, Vertices, trace_points

CELLS = 12


def unit_vectors(count, seed=0):
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def lights(suns=(), lamps=(), environments=None, emission=None):
    """Of some kinds, in a grid of CELLS."""
    return Lights(
        np.reshape(suns, (-1, 3)),
        tuple(lamps),
        np.zeros((0, 8, 16)) if environments is None else environments,
        np.zeros((CELLS,) * 3 + (0,)) if emission is None else emission,
    )


@pytest.fixture(scope="module")
def uneven():
    return prepare((np.random.default_rng(4).random((CELLS,) * 3) ** 3).astype(np.float32))


@pytest.fixture(scope="module")
def full():
    return prepare(np.ones((CELLS,) * 3, np.float32))


@pytest.fixture(scope="module")
def vertices():
    return np.random.default_rng(1).uniform(-0.45, 0.45, (48, 3)), unit_vectors(48)


@pytest.mark.slow
def test_without_absorption_even_light_is_the_same_everywhere(uneven, vertices):
    medium = LitMedium(20.0, 0.6, AlbedoField([1.0], [1.0]))
    even = lights(environments=np.full((1, 8, 16), 3.0))
    radiance, once = trace_lights(uneven, even, medium, vertices, Sampling(16, 1))
    np.testing.assert_allclose(radiance[:, 0, 0] + once[:, 0], 3.0, rtol=1e-5)


@pytest.mark.slow
def test_a_mask_in_which_both_albedos_are_equal_changes_nothing(uneven, vertices):
    mask = np.random.default_rng(2).random((CELLS,) * 3).astype(np.float32)
    scene = lights(suns=unit_vectors(2), environments=np.ones((1, 8, 16)))
    first, second = (
        trace_lights(uneven, scene, LitMedium(10.0, 0.3, AlbedoField([0.9], [0.9], m)), vertices, Sampling(16, 1))[0]
        for m in (mask, None)
    )
    np.testing.assert_allclose(first, second, rtol=1e-4)


def test_an_albedo_that_varies_is_that_of_its_places(full):
    """The half x > 0 is black: from deep inside, it is as dark as if nothing there scattered, the other one is not."""
    mask = (np.arange(CELLS) >= CELLS // 2).astype(np.float32)[:, None, None] * np.ones((CELLS,) * 3, np.float32)
    varying = LitMedium(30.0, 0.0, AlbedoField([1.0, 1.0], [0.0, 1.0], mask))
    positions = np.repeat([[-0.3, 0.0, 0.0], [0.3, 0.0, 0.0]], 40, axis=0)
    found, _ = trace_lights(
        full, lights(environments=np.ones((1, 8, 16))), varying, (positions, unit_vectors(80)), Sampling(64, 3)
    )
    left, right = found[:40, 0].mean(axis=0), found[40:, 0].mean(axis=0)
    assert right[0] < 1e-3 and left[0] > 0.3
    # Where the albedo is 1 everywhere the box is even from side to side.
    np.testing.assert_allclose([left[1], right[1]], 1.0, atol=0.02)
    assert left[0] < left[1]


def test_suns_are_those_of_the_other_tracer_and_of_far_lamps(uneven, vertices):
    suns, far = unit_vectors(2, 5), 400.0
    lamps = [PointLight(far * sun, 4.0 * np.pi * far**2) for sun in suns]
    albedos, sigma, g = [1.0, 0.8], 10.0, 0.4
    found, _ = trace_lights(
        uneven, lights(suns, lamps), LitMedium(sigma, g, AlbedoField(albedos, albedos)), vertices, Sampling(1500, 6)
    )
    expected = trace_points(Scene(uneven, suns), Vertices(*vertices, sigma, g, albedos), Sampling(1500, 7))
    for traced in (found[:, :2], found[:, 2:]):
        difference = traced.astype(float) - expected
        error = difference.std(axis=0, ddof=1) / np.sqrt(len(difference))
        assert np.all(error < 0.02 * expected.mean(axis=0))
        assert np.all(np.abs(difference.mean(axis=0)) < 4.0 * error)


def photon_collisions(lamp, sigma, albedo, g, count, seed):
    """Collisions, over the lamp's photons, of light that has scattered already, in a full grid around a sphere.

    Both sides of the sphere shine alike, the inner one into the sphere alone, as in Cycles.
    """
    random, normal = np.random.default_rng(seed), unit_vectors(count, seed + 1)
    w = normal + unit_vectors(count, seed + 2)
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    x, inwards = lamp.position + lamp.radius * normal, np.arange(count) % 2 == 0
    reach = np.where(inwards, 2.0 * lamp.radius * (w * normal).sum(axis=1), np.inf)
    w = np.where(inwards[:, None], -w, w)
    weight, order, found = np.ones(count), np.zeros(count, int), 0.0
    while len(x):
        length = -np.log(random.random(len(x))) / sigma
        x = x + length[:, None] * w
        kept = (np.abs(x).max(axis=1) < 0.5) & (length < reach)
        x, w, weight, order = x[kept], w[kept], weight[kept], order[kept]
        reach = np.full(len(x), np.inf)
        # Trilinear between the outermost cells and the zeros around them.
        density = np.clip(0.5 + (0.5 - np.abs(x)) * CELLS, 0.0, 1.0).prod(axis=1)
        real = random.random(len(x)) < density
        found += weight[real & (order > 0)].sum()
        weight, order = np.where(real, weight * albedo, weight), order + real
        cosine = 2.0 * random.random(len(x)) - 1.0
        if g:
            s = (1.0 - g * g) / (1.0 + g * cosine)
            cosine = (1.0 + g * g - s * s) / (2.0 * g)
        across = np.cross(w, unit_vectors(len(x), random.integers(1 << 30)))
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        turned = cosine[:, None] * w + np.sqrt(1.0 - cosine**2)[:, None] * across
        w = np.where(real[:, None], turned, w)
    return 2.0 * found / count


@pytest.mark.parametrize("sigma, albedo, g", [(8.0, 0.9, 0.5), pytest.param(30.0, 0.7, 0.0, marks=pytest.mark.slow)])
def test_a_lamp_inside_sends_as_much_light_as_its_photons(full, sigma, albedo, g):
    lamp, random, count, most = PointLight((0.2, -0.1, 0.0), 1.0, 0.1), np.random.default_rng(8), 8000, 0.9
    distance = most * random.random(count)
    positions = lamp.position + distance[:, None] * unit_vectors(count, 9)
    inside = np.abs(positions).max(axis=1) < 0.5
    vertices = positions[inside], unit_vectors(count, 10)[inside]
    medium = LitMedium(sigma, g, AlbedoField([albedo], [albedo]))
    radiance, _ = trace_lights(full, lights(lamps=[lamp]), medium, vertices, Sampling(24, 11))
    density = np.clip(0.5 + (0.5 - np.abs(positions[inside])) * CELLS, 0.0, 1.0).prod(axis=1)
    # Collisions per volume, over the probability of a point there.
    values = np.zeros(count)
    values[inside] = (
        sigma * density * 4.0 * np.pi * radiance[:, 0, 0] * 4.0 * np.pi * distance[inside] ** 2 * most * albedo
    )
    error = values.std(ddof=1) / np.sqrt(count)
    assert error < 0.04 * values.mean()
    expected = photon_collisions(lamp, sigma, albedo, g, 100_000, 12) * albedo
    assert abs(values.mean() - expected) < 4.0 * error + 0.01 * expected


@pytest.mark.parametrize("soft", [False, True])
def test_samples_of_a_lamp_are_its_fluence(full, soft):
    """Against what rendering takes for the same lamp, outside, within its radius, and in the cone of a spot."""
    lamps = [
        PointLight((0.1, 0.0, 0.0), 2.0),
        PointLight((0.1, 0.0, 0.0), 2.0, 0.2, soft_falloff=soft),
        SpotLight((0.1, 0.0, 0.0), (1.0, 0.3, 0.0), 2.0, 1.4, 0.5, 0.2, soft_falloff=soft),
    ]
    placed, points = place_lamps(lamps, full, 5.0), np.random.default_rng(3).uniform(-0.5, 0.5, (60, 3))
    low, high = np.full(3, -0.5), np.full(3, 0.5)
    for number, lamp in enumerate(lamps):
        (whole,) = lamp.emitters(low, high, 1)
        at = ((points + 0.5) * CELLS).astype(np.float32)
        found, state = np.zeros(len(at)), np.uint64(5)
        for k, (x, y, z) in enumerate(at):
            for _ in range(200):
                ray, reach, fluence, state = _towards(x, y, z, placed, number, np.uint64(state))
                found[k] += fluence / 200
                # The light starts on the lamp, or within the disk.
                gone = np.array(ray[:3]) + reach * np.array(ray[3:]) - placed.centre[number]
                assert np.linalg.norm(gone) < placed.radius[number] * 1.001 + 1e-3
        expected = 2.0 * whole.fluence(points)
        # Rendering takes a cone's edge from six nodes.
        tolerance = 0.02 * expected.max() if isinstance(lamp, SpotLight) else 1e-3 * expected
        assert np.all(np.sqrt(np.mean((found - expected) ** 2)) < tolerance)


def test_emission_in_a_thin_medium_is_its_mean_along_rays(full):
    """Scattered once it is the mean over directions of the emission along them, also where the density is low."""
    thin = prepare(np.full((CELLS,) * 3, 1e-3, np.float32))
    emission, count = np.ones((CELLS,) * 3 + (1,), np.float32), 400
    centre = np.zeros((count, 3))
    medium = LitMedium(1.0, 0.0, AlbedoField([1.0], [1.0]))
    _, once = trace_lights(thin, lights(emission=emission), medium, (centre, unit_vectors(count)), Sampling(400, 1))
    # Out to the faces; the outer half of the outermost cells glows three quarters as much on average.
    mean = (0.5 - 0.125 / CELLS) * (1.0 / np.abs(unit_vectors(100_000)).max(axis=1)).mean()
    assert once.mean() == pytest.approx(mean, rel=0.02)


def test_a_glowing_medium_in_balance_is_as_bright_as_its_walls(full):
    """Emission of (1 - albedo) sigma density and even light of 1 make radiance 1 everywhere (Kirchhoff)."""
    sigma, albedo = 6.0, 0.6
    emission = np.full((CELLS,) * 3 + (1,), (1.0 - albedo) * sigma, np.float32)
    positions, omega = np.random.default_rng(1).uniform(-0.4, 0.4, (64, 3)), unit_vectors(64)
    scene = lights(environments=np.ones((1, 8, 16)), emission=emission)
    medium = LitMedium(sigma, 0.3, AlbedoField([albedo], [albedo]))
    radiance, once = trace_lights(full, scene, medium, (positions, omega), Sampling(400, 2))
    total = radiance[:, :, 0].sum(axis=1) + once.sum(axis=1)
    assert total.mean() == pytest.approx(1.0, abs=0.005)
    np.testing.assert_allclose(total, 1.0, atol=0.12)


def test_light_is_linear_and_follows_from_the_seed_on_any_number_of_threads(uneven, vertices):
    lamps = [PointLight((0.3, 0.0, 0.1), power, 0.05) for power in (1.0, 2.5)]
    medium = LitMedium(20.0, 0.5, AlbedoField([0.9, 0.5], [0.9, 0.5]))
    first, second = (
        trace_lights(uneven, lights(lamps=[lamp]), medium, vertices, Sampling(16, 1), threads)[0]
        for lamp, threads in zip(lamps, (1, 3))
    )
    np.testing.assert_allclose(2.5 * first, second, rtol=1e-4)
    again = trace_lights(uneven, lights(lamps=lamps[1:]), medium, vertices, Sampling(16, 1))[0]
    np.testing.assert_array_equal(again, second)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A file of few points of seed 148, as the program writes it."""
    folder = tmp_path_factory.mktemp("lights")
    light_targets.main(["--out", str(folder), "--volumes", "148", "--points", "48", "--paths", "8"])
    return folder / "0000148.npz"


def test_files_hold_the_scene_and_its_light(file):
    scene, arrays = read_traces(file)
    count, channels = scene.lights.count, len(scene.media[0].albedo.low)
    points = len(arrays["medium"])
    assert 24 < points <= 48 and arrays["radiance"].shape == (points, count, channels, 2)
    assert np.isfinite(arrays["radiance"]).all() and np.all(arrays["radiance"] >= 0.0)
    assert np.all(arrays["radiance"].max(axis=(0, 2, 3)) > 0.0)
    assert arrays["once"].shape == (points, len(arrays["environments"]) + len(arrays["emission_kind"]), 2)
    assert (arrays["lamp"] >= 0).any() and (arrays["lamp"] < 0).any() and len(scene.lights.lamps) == len(LAMPS)
    masks = [medium.albedo.mask for medium in scene.media]
    assert sum(mask is None for mask in masks) == len(masks) // 2
    assert all(mask is None or 0.0 <= mask.min() < mask.max() <= 1.0 for mask in masks)
    # In uniform media, less light for a smaller albedo.
    for number in np.flatnonzero(arrays["albedo_kind"] == "uniform"):
        order = np.argsort(arrays["albedo_low"][number])
        own = arrays["radiance"][arrays["medium"] == number][:, :, order]
        assert np.all(np.diff(own, axis=2) >= -1e-5 * own.max())


def test_traces_follow_from_the_seed(file):
    again = make_traces(148, 48, 8, threads=2)
    _, arrays = read_traces(file)
    for name, values in again.items():
        np.testing.assert_array_equal(arrays[name], values, err_msg=name)


def test_a_changed_scene_is_refused(file, tmp_path):
    with np.load(file) as data:
        arrays = dict(data)
    arrays["density_blocks"] = arrays["density_blocks"][::-1]
    np.savez(tmp_path / "0000148.npz", **arrays)
    with pytest.raises(ValueError, match="density_blocks"):
        read_traces(tmp_path / "0000148.npz")


def test_files_that_exist_are_left_alone(file):
    before = file.read_bytes(), file.stat().st_mtime_ns
    light_targets.main(["--out", str(file.parent), "--volumes", "148", "--points", "32", "--paths", "4"])
    assert (file.read_bytes(), file.stat().st_mtime_ns) == before
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_ranges_take_turns():
    order = in_turns([range(10, 18), range(100, 104), range(1000, 1001)])
    assert sorted(order) == [*range(10, 18), *range(100, 104), 1000]
    assert len({seed for seed in order[:6] if seed < 100}) == 4
    assert [seed for seed in order if seed < 100] == list(range(10, 18))


@pytest.mark.slow
def test_a_signal_stops_it_and_leaves_no_part_of_a_file(tmp_path):
    command = [sys.executable, "-m", "training.data.light_targets", "--out", str(tmp_path), "--volumes", "148-149"]
    with subprocess.Popen([*command, "--points", "48", "--paths", "8"], cwd=ROOT, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline().startswith(b"0000148.npz")
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 1
    assert not list(tmp_path.glob("*.partial"))
    read_traces(tmp_path / "0000148.npz")
