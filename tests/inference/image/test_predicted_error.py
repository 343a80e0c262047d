# SPDX-License-Identifier: GPL-3.0-or-later
"""The error that pictures state."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.fidelity.drawn_views import drawn_view
from inference import Environment, Medium, PointLight, Settings, Sun, render
from inference.image.predicted_error import BIAS, MOST_OF_PICTURES, MOST_OF_PIXELS, SparseDeviation
from inference.models import weights_file
from inference.network.baselines import register_baselines
from inference.network.uncertainty import load_uncertainty_network
from inference.scene.errors import SceneError
from tests.support.volumes import camera, cloud

SUN = Sun((0.3, -0.5, 0.8), 2.0)


def picture(sigma=30.0, albedo=0.95, g=0.5, lights=(SUN,), **settings):
    view = camera(resolution=(40, 40))
    return render([(cloud(), Medium(sigma, albedo, g))], list(lights), view, Settings(4, **settings))


@pytest.fixture(scope="module")
def usual():
    return picture()


def test_it_is_linear_in_the_light(usual):
    bright = picture(lights=[replace(SUN, irradiance=6.0)])
    np.testing.assert_allclose(bright.uncertainty, 3.0 * usual.uncertainty, rtol=1e-4, atol=1e-8)
    assert bright.report.expected_error.error == pytest.approx(usual.report.expected_error.error, rel=1e-4)


def test_it_states_a_plausible_interval(usual):
    stated = usual.report.expected_error
    assert 0.005 < stated.low < stated.error < stated.high < 0.5 and 0.0 < stated.bias < 0.3
    assert stated.low / stated.error == pytest.approx(MOST_OF_PICTURES[0]) and stated.bias == BIAS * stated.error
    assert f"{100 * stated.error:.1f}" in str(stated) and stated.where
    assert usual.report.to_dict()["expected_error"]["high"] == stated.high
    # Of depth sampling and of the network.
    assert np.all(usual.uncertainty >= usual.sampling_error) and usual.uncertainty.sum() > usual.sampling_error.sum()


def test_nothing_is_stated_where_nothing_is_predicted():
    """Single scattering is exact; a medium that only absorbs has nothing predicted, nor has one without light."""
    for layer in (picture(multiple=False), picture(albedo=0.0), picture(lights=[replace(SUN, irradiance=0.0)])):
        assert layer.uncertainty.max() == 0.0 and layer.report.expected_error is None


def test_it_is_left_out_where_nobody_asks(usual):
    """The picture is the same; depth sampling's own error steers what is interpolated."""
    silent = picture(states_error=False)
    np.testing.assert_array_equal(silent.rgb, usual.rgb)
    np.testing.assert_array_equal(silent.sampling_error, usual.sampling_error)
    assert silent.report.expected_error is None


def test_it_grows_outside_the_trained_range_and_a_warning_says_why(usual):
    relative = [usual.uncertainty.sum() / usual.multiple.sum()]
    for g in (0.96, 0.99):
        layer = picture(g=g)
        relative.append(layer.uncertainty.sum() / layer.multiple.sum())
        assert any("outside the network's range" in warning for warning in layer.report.warnings)
    thick, thicker = picture(sigma=3e4), picture(sigma=3e6)
    assert any("very dense" in warning for warning in thicker.report.warnings)
    stated = [layer.report.expected_error.error for layer in (usual, thick, thicker)]
    assert relative[1] < relative[2] and stated[1] < stated[2] and stated[0] < stated[2]


def test_every_predicted_light_has_an_error():
    lamp = PointLight((0.0, 0.0, 2.0), 100.0)
    world = Environment(np.full((8, 16, 3), 0.5, np.float32))
    for light in (lamp, world):
        layer = picture(lights=[light])
        assert 0.01 < layer.uncertainty.sum() / layer.rgb.mean(axis=2).sum() < 0.5, light
    both = picture(lights=[SUN, world])
    assert both.uncertainty.sum() > picture(lights=[world]).uncertainty.sum()


def test_networks_without_one_for_their_error_state_the_measured_one():
    layer = picture(model="mrpnn-paper")
    assert 0.1 < layer.report.expected_error.error < 0.3
    register_baselines()
    assert picture(model="multi-octave").report.expected_error is None


def test_it_does_not_depend_on_the_window():
    """Deviations are interpolated within bands, and keep the ratio that they have where they are known."""
    light = np.random.default_rng(0).uniform(1.0, 2.0, (70, 80))
    found = []
    for x0, x1 in ((0, 80), (33, 66)):
        sparse = SparseDeviation(camera(resolution=(80, 70), region=(x0, 0, x1, 70)))
        part = light[:, x0:x1].ravel()
        pixel = np.flatnonzero(sparse.known)
        sparse.add(pixel, 0.1 * part[pixel])
        found.append(sparse.everywhere(part, 1.0).reshape(70, -1))
    np.testing.assert_array_equal(found[0][:, 33:66], found[1])
    np.testing.assert_allclose(found[0] / light, (found[0] / light)[0, 0], rtol=1e-5)
    nowhere = SparseDeviation(camera(resolution=(80, 70))).everywhere(np.zeros(5600), 0.2)
    assert not nowhere.any()


def test_damaged_weights_are_refused(tmp_path, monkeypatch):
    folder = tmp_path / "uncertainty"
    folder.mkdir()
    for name in ("mrpnn.onnx", "mrpnn.sha256"):
        (folder / name).write_bytes((weights_file.WEIGHTS / "uncertainty" / name).read_bytes())
    monkeypatch.setattr(weights_file, "WEIGHTS", tmp_path)
    content = (folder / "mrpnn.onnx").read_bytes()
    (folder / "mrpnn.onnx").write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(SceneError, match="checksum"):
        load_uncertainty_network("mrpnn")


@pytest.mark.slow
def test_pixels_lie_within_what_is_stated(tmp_path):
    """Of few held-back views; benchmarks.fidelity.calibration counts on many."""
    inside = []
    for seed in (1_000_450, 1_000_451, 1_000_452, 1_000_453):
        view = drawn_view(seed, tmp_path)
        parts = view.halves()[..., :3].mean(axis=3)
        layer = view.render(Settings(4), 3 * view.spec.size)
        centre = slice(1, None, 3)
        off = layer.rgb[centre, centre].mean(axis=2) - parts.mean(axis=0)
        noise = parts.std(axis=0, ddof=1) / np.sqrt(len(parts))
        shown = parts.mean(axis=0) > 0.0
        bound = np.hypot(MOST_OF_PIXELS * layer.uncertainty[centre, centre], 2.5 * noise)
        inside.append((np.abs(off) <= bound)[shown])
    assert np.concatenate(inside).mean() > 0.85
