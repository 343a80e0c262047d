# SPDX-License-Identifier: GPL-3.0-or-later
"""The render cache changes nothing but the time, for one thread and for several."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import training.rpnn  # noqa: F401  Lets settings name it.
from inference import Camera, Cancelled, Medium, RenderCache, Settings, Sun, Volume, render, render_cache
from inference.network.network import load_network

SETTINGS = Settings(depth_samples=1, threads=1)


def ball(cells=24):
    axis = (np.arange(cells) + 0.5) / cells - 0.5
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    matrix = np.diag([1 / cells, 1 / cells, 1 / cells, 1.0])
    matrix[:3, 3] = axis[0]
    return Volume(np.clip(4 - 10 * np.sqrt(x**2 + 2 * y**2 + z**2), 0, 1).astype(np.float32), matrix, name="ball")


def camera(size=12):
    matrix = np.eye(4)
    matrix[2, 3] = 2.5
    return Camera(matrix, resolution=(size, size), fov=0.6)


def test_a_render_cancelled_while_preparing_leaves_nothing_half_built():
    volume, sun, cache = ball(), [Sun((0.3, 0.5, 0.8))], RenderCache()
    thin, thick = Medium(20.0, 0.9, 0.5), Medium(60.0, 0.9, 0.5)
    expected = {medium.sigma_t[0]: render([(volume, medium)], sun, camera(), SETTINGS).rgb for medium in (thin, thick)}
    render([(volume, thin)], sun, camera(), SETTINGS, cache=cache)
    for medium in (thick, thin):
        # At the ninth poll, half of the lattices are built.
        asked = iter(range(9))
        with pytest.raises(Cancelled):
            render(
                [(volume, medium)], sun, camera(), SETTINGS, cancelled=lambda: next(asked, None) is None, cache=cache
            )
        found = render([(volume, medium)], sun, camera(), SETTINGS, cache=cache)
        np.testing.assert_array_equal(found.rgb, expected[medium.sigma_t[0]])


def test_two_threads_share_the_render_cache():
    # Other levels of detail share what they read after rescaling it, which rounds.
    settings = replace(SETTINGS, optimizations=SETTINGS.optimizations - {"level_of_detail"})
    volume, cache = ball(), RenderCache()
    scenes = [
        ([(volume, Medium(density, 0.9, 0.5))], [Sun(direction)])
        for density, direction in ((20.0, (0.3, 0.5, 0.8)), (50.0, (0.9, -0.1, 0.2)))
    ]
    expected = [render(*scene, camera(), settings).rgb for scene in scenes]
    found = {}

    def run(number):
        found[number] = render(*scenes[number], camera(), settings, cache=cache).rgb

    threads = [threading.Thread(target=run, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for number in range(2):
        np.testing.assert_array_equal(found[number], expected[number])


def test_threads_get_the_networks_that_they_ask_for_each_loaded_once(monkeypatch):
    loaded = []

    def load(name, provider):
        loaded.append((name, provider))
        return load_network(name, provider)

    monkeypatch.setattr(render_cache, "load_network", load)
    # CUDA is unavailable on most machines: then the processor runs the network, and a warning says so.
    wanted = [("mrpnn-narrow", "CPU"), ("rpnn", "CPU"), ("mrpnn-narrow", "CUDA")]
    threads = 2 * len(wanted)
    for _ in range(8):
        loaded.clear()
        cache, barrier = RenderCache(), threading.Barrier(threads)

        def ask(first, cache=cache, barrier=barrier):
            barrier.wait()
            order = [wanted[(first + n) % len(wanted)] for n in range(2 * len(wanted))]
            return [(key, cache.network(*key)) for key in order]

        with ThreadPoolExecutor(threads) as pool:
            found = [pair for pairs in pool.map(ask, range(threads)) for pair in pairs]
        assert sorted(loaded) == sorted(wanted)
        networks = dict(found)
        assert len({id(network) for network in networks.values()}) == len(wanted)
        for (name, provider), network in found:
            assert network is networks[name, provider] and network.name == name
            assert network.provider == provider or any(provider in warning for warning in network.warnings)


@pytest.mark.slow
def test_renders_with_different_networks_share_a_cache():
    scene = [(ball(), Medium(20.0, 0.9, 0.5))], [Sun((0.3, 0.5, 0.8))]
    models = ("mrpnn", "mrpnn-narrow", "rpnn")
    expected = {model: render(*scene, camera(), replace(SETTINGS, model=model)).rgb for model in models}
    cache, barrier = RenderCache(), threading.Barrier(len(models))

    def run(model):
        barrier.wait()
        return [render(*scene, camera(), replace(SETTINGS, model=model), cache=cache) for _ in range(2)]

    with ThreadPoolExecutor(len(models)) as pool:
        for model, layers in zip(models, pool.map(run, models)):
            for layer in layers:
                assert layer.report.model == model
                np.testing.assert_array_equal(layer.rgb, expected[model])


def test_without_multiple_scattering_the_other_passes_are_unchanged():
    volume, sun = ball(), [Sun((0.3, 0.5, 0.8))]
    whole = render([(volume, Medium(20.0, 0.9, 0.5))], sun, camera(), SETTINGS)
    single = render([(volume, Medium(20.0, 0.9, 0.5))], sun, camera(), replace(SETTINGS, multiple=False))
    np.testing.assert_array_equal(single.rgb, whole.single)
    np.testing.assert_array_equal(single.alpha, whole.alpha)
    assert "multiple scattering" in " ".join(single.report.left_out) and not single.report.model
