# SPDX-License-Identifier: GPL-3.0-or-later
"""Error measures against planted errors of known size."""

import numpy as np
import pytest

from evaluation.error import error_text, paper_metric, relative_bias, relative_rmse

SIZE = 160


@pytest.fixture
def truth():
    """A smooth RGB image between 0.2 and 1.8."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    return (1.0 + 0.8 * np.sin(3 * x + 5 * y))[..., None] * [1.0, 0.9, 0.7]


def halves(truth, noise, seed=1):
    """Two independent unbiased estimates of `truth`, with a path tracer's long-tailed noise."""
    rng = np.random.default_rng(seed)
    shape = 1.0 / noise**2
    return tuple(truth * rng.gamma(shape, 1.0 / shape, truth.shape) for _ in range(2))


EVERYWHERE = np.ones((SIZE, SIZE), bool)


def test_identical_images_have_no_error(truth):
    assert relative_rmse(truth, truth, truth, EVERYWHERE).value == 0.0
    assert relative_bias(truth, truth, truth, EVERYWHERE).value == 0.0
    assert paper_metric(truth, truth, truth) == 0.0


@pytest.mark.parametrize("noise", [0.05, 0.3, 1.0])
def test_planted_bias_is_found_whatever_the_noise(truth, noise):
    a, b = halves(truth, noise)
    bias = relative_bias(1.05 * truth, a, b, EVERYWHERE)
    # The standard error of the mean of 2 x 25600 x 3 samples, four times.
    tolerance = 4 * 1.2 * noise / np.sqrt(2 * 3 * SIZE**2)
    assert bias.value == pytest.approx(0.05, abs=tolerance)


@pytest.mark.parametrize("noise", [0.05, 0.3, 1.0])
def test_planted_rmse_is_found_whatever_the_noise(truth, noise):
    # An error pattern whose RMSE is a fifth of the image's mean.
    pattern = np.sign(np.sin(np.arange(SIZE) / 5.0))[:, None, None] * 0.2 * truth.mean()
    a, b = halves(truth, noise)
    rmse = relative_rmse(truth + pattern, a, b, EVERYWHERE)
    assert rmse.value == pytest.approx(0.2, rel=0.1 if noise == 1.0 else 0.03)
    assert rmse.low <= 0.2 <= rmse.high
    # A single reference would have counted its own noise as the layer's error.
    single = np.sqrt(np.mean((truth + pattern - a) ** 2)) / truth.mean()
    assert single > np.hypot(0.2, 0.9 * noise)


def test_the_interval_covers_the_truth_in_about_95_percent(truth):
    rng = np.random.default_rng(5)
    # Errors constant over randomly placed 8 x 8 blocks: a bootstrap over pixels would often fail.
    covered = 0
    for trial in range(100):
        blocks = np.kron(rng.normal(0.0, 0.1, (SIZE // 8, SIZE // 8)), np.ones((8, 8)))[..., None]
        flat = np.ones((SIZE, SIZE, 1))
        a, b = halves(flat, 0.3, seed=100 + trial)
        estimate = relative_bias(flat + blocks, a, b, EVERYWHERE, seed=trial)
        covered += estimate.low <= 0.0 <= estimate.high
    assert 88 <= covered <= 99


def test_only_the_mask_counts(truth):
    mask = np.zeros((SIZE, SIZE), bool)
    mask[:40] = True
    wrong_outside = truth + 3.0 * ~mask[..., None]
    assert relative_rmse(wrong_outside, truth, truth, mask).value == 0.0
    assert relative_bias(wrong_outside, truth, truth, mask).value == 0.0
    assert relative_rmse(wrong_outside, truth, truth, EVERYWHERE).value > 1.0


def test_grey_images_equal_rgb_images_with_equal_channels(truth):
    grey = truth[..., 0]
    rgb = np.repeat(grey[..., None], 3, axis=-1)
    noisy = halves(grey, 0.3)
    noisy_rgb = [np.repeat(half[..., None], 3, axis=-1) for half in noisy]
    for measure in (relative_rmse, relative_bias):
        assert measure(1.1 * grey, *noisy, EVERYWHERE).value == pytest.approx(
            measure(1.1 * rgb, *noisy_rgb, EVERYWHERE).value
        )
    assert paper_metric(1.1 * grey, *noisy) == pytest.approx(paper_metric(1.1 * rgb, *noisy_rgb))


def test_paper_metric_of_two_greys_is_the_difference_of_their_tone_mapped_values():
    # The ACES fit at pi L = 1 is 2.54 / 3.16, at 0 it is 0.
    one, black = np.full((4, 4), 1 / np.pi), np.zeros((4, 4))
    assert paper_metric(one, black, black) == pytest.approx(100 * 2.54 / 3.16)
    # Half the image is wrong: the RMSE over all of it.
    half = one.copy()
    half[:2] = 0.0
    assert paper_metric(half, black, black) == pytest.approx(100 * 2.54 / 3.16 / np.sqrt(2))


@pytest.mark.parametrize(
    "layer, mask, message",
    [
        (np.ones((4, 5)), np.ones((4, 4), bool), "differ in size"),
        (np.ones((4, 4)), np.zeros((4, 4), bool), "mask is empty"),
    ],
)
def test_unusable_input_is_refused(layer, mask, message):
    reference = np.ones((4, 4))
    with pytest.raises(ValueError, match=message):
        relative_rmse(layer, reference, reference, mask)


def test_black_reference_is_refused():
    image = np.ones((4, 4))
    with pytest.raises(ValueError, match="black"):
        relative_bias(image, 0 * image, 0 * image, np.ones((4, 4), bool))


def test_an_error_that_noise_hides_is_said_to_be_below_its_interval(truth):
    """Never an error of 0 beside a bias: the reference cannot tell one."""
    shown = np.ones((SIZE, SIZE), bool)
    noisy, clean = halves(truth, 1.0), halves(truth, 0.01)
    hidden = relative_rmse(truth, *(half + 0.002 * truth.mean() for half in noisy), shown)
    told = relative_rmse(1.2 * truth, *clean, shown)
    assert hidden.value == 0.0 or hidden.low == 0.0
    assert error_text(0.0, 0.0, hidden.high) == f"below {hidden.high:.3f}"
    assert error_text(told.value, told.low, told.high) == f"{told.value:.3f} ({told.low:.3f}–{told.high:.3f})"
    assert error_text(0.0, 0.0, 1e-5) == error_text(0.0) == "below the noise"
