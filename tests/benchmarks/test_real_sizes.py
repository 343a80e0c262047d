# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against run time at real sizes: figures of planted images, and references that are continued."""

from dataclasses import replace

import numpy as np

from benchmarks.error_vs_time.real_scenes import SCENES, halves, sky, trace, traced
from benchmarks.error_vs_time.real_sizes import FIRST, NEXT, Image, Measured, section, span

SIZE, CYCLES = 128, "Cycles 1.0"


def planted(layer_error=0.1, noise=0.8):
    """A scene of radiance 1 whose layer is off by alternating signs, and Cycles' of known noise and filtered error."""
    random = np.random.default_rng(5)
    shape = (SIZE, SIZE, 3)
    signs = np.sign(np.indices(shape).sum(axis=0) % 2 - 0.5)
    pair = np.ones((2, SIZE, SIZE, 4))
    pair[..., :3] += 0.2 * random.standard_normal((2, *shape))

    def noisy(method, samples, deviation, seconds):
        return Image(method, samples, 1.0 + deviation * random.standard_normal(shape), seconds)

    images = [
        Image(FIRST, 4, 1.0 + layer_error * signs, 2.0),
        Image(NEXT, 4, 1.0 + layer_error * signs, 1.0),
        noisy(CYCLES, 4, noise, 9.0),
        noisy(f"{CYCLES}, denoised", 1, 0.4, 3.0),
        noisy(f"{CYCLES}, denoised", 4, 0.2, 9.0),
    ]
    return Measured(SCENES[0], pair, images, flips=False)


def test_ratios_follow_from_planted_errors():
    measured = planted()
    rmse = measured.rungs[FIRST][0].rmse
    assert rmse.low < 0.1 < rmse.high and abs(rmse.value - 0.1) < 0.01
    # Noise of 0.8 at 4 samples falls to 0.1 at 256; a sample takes 2 s beside 1 s to start.
    ratios, _ = measured.ratios(CYCLES, FIRST)
    assert np.quantile(ratios, 0.02) < 256 * 2.0 / 2.0 < np.quantile(ratios, 0.98)
    # Denoised, half the last error takes at least four times its samples.
    ratios, how = measured.ratios(f"{CYCLES}, denoised", NEXT)
    assert how == "at least" and np.quantile(ratios, 0.02) < 1.0 + 2.0 * 16 < np.quantile(ratios, 0.98)
    first, _ = measured.ratios(f"{CYCLES}, denoised", FIRST)
    np.testing.assert_allclose(first, ratios / 2.0)


def test_an_error_hidden_by_the_reference_leaves_ratios_open():
    measured = planted(layer_error=0.0)
    assert "beyond telling" in span(measured.ratios(CYCLES, FIRST)[0])
    text = section([measured])
    assert "| 1 of 5 |" in text and "cloud, side, G 0.857" in text


def test_references_go_on_where_they_were_stopped(tmp_path):
    small = replace(SCENES[4], spec=replace(SCENES[4].spec, size=24), rows=16, folder=tmp_path / "one")
    trace(small, 4)
    trace(small, 8)
    whole = replace(small, folder=tmp_path / "other")
    trace(whole, 8)
    np.testing.assert_allclose(halves(small), halves(whole), rtol=1e-5, atol=1e-7)
    assert traced(small) == 8 and halves(small).shape == (2, 16, 24, 4)
    # Independent halves, each lit by the blue sky too.
    a, b = halves(small)
    assert np.any(a != b) and a[..., 2].mean() > 1.1 * a[..., 0].mean()


def test_the_sky_is_brighter_above():
    up, level, down = sky(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
    assert np.all(up > level) and np.all(level > down) and np.all(down > 0.0)
