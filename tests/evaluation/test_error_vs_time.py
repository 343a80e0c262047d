# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against time: the noise law, ladders of samples and verdicts, for planted noise, bias and cost."""

import numpy as np
import pytest

from evaluation.error import Estimate, relative_bias, relative_rmse
from evaluation.error_vs_time import (
    AT_LEAST,
    AT_MOST,
    EXTRAPOLATED,
    MEASURED,
    PathTracing,
    Rung,
    cost,
    error_on_ladder,
    judge,
    seconds_on_ladder,
    variance_at_one,
)

SIZE = 96
EVERYWHERE = np.ones((SIZE, SIZE), bool)
# Standard deviation of a pixel at one sample, relative to its mean.
SPREAD = 2.0


@pytest.fixture
def truth():
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    return (1.0 + 0.5 * np.sin(4 * x + 3 * y))[..., None] * np.ones(3)


def traced(truth, samples, seed):
    """A path tracer's image of `truth` at `samples` per pixel: unbiased, grey gamma noise."""
    shape = samples / SPREAD**2
    noise = np.random.default_rng(seed).gamma(shape, 1.0 / shape, truth.shape[:2])
    return truth * noise[..., None]


def rung(image, a, b, samples=1, seconds=1.0, method="candidate"):
    return Rung(
        method,
        samples,
        seconds,
        seconds,
        0.0,
        0.0,
        relative_rmse(image, a, b, EVERYWHERE),
        relative_bias(image, a, b, EVERYWHERE),
    )


def of_error(samples, seconds, error):
    return Rung("denoised", samples, seconds, seconds, 0.0, 0.0, Estimate(error, error, error), Estimate(0, 0, 0))


def test_a_bias_of_5_percent_lies_in_the_stated_intervals_and_not_0(truth):
    a, b = traced(truth, 4096, 1), traced(truth, 4096, 2)
    found = rung(1.05 * truth, a, b)
    assert found.bias.low < 0.05 < found.bias.high and found.bias.low > 0.04
    # A constant factor is a relative RMSE of 5 %.
    expected = 0.05 * np.sqrt((truth**2).mean()) / truth.mean()
    assert found.rmse.low < expected < found.rmse.high
    assert judge(found, a, b, EVERYWHERE, 1.0).good


def test_an_image_against_itself_has_no_error(truth):
    image = traced(truth, 16, 1)
    found = rung(image, image, image)
    assert (found.rmse.value, found.rmse.high, found.bias.value) == (0.0, 0.0, 0.0)
    a, b = traced(truth, 16, 1), traced(truth, 16, 2)
    assert rung((a + b) / 2, a, b).rmse.value == 0.0 and rung((a + b) / 2, a, b).bias.value == pytest.approx(0.0)


def test_the_law_from_halves_predicts_the_error_of_another_render(truth):
    samples = 256
    a, b = traced(truth, samples, 1), traced(truth, samples, 2)
    variance = variance_at_one(a, b, EVERYWHERE, samples)
    law = PathTracing(start=2.0, each=0.5, variance=variance, largest=64)
    for count in (4, 64):
        seen = rung(traced(truth, count, 3), a, b)
        predicted = law.error_after(law.seconds(count))
        assert predicted.value == pytest.approx(seen.rmse.value, rel=0.05) and predicted.how == MEASURED
        assert law.seconds_for(seen.rmse.value).value == pytest.approx(2.0 + 0.5 * count, rel=0.1)
    # A tenth of the error takes a hundred times the samples.
    assert law.seconds_for(np.sqrt(variance / 6400)).value == pytest.approx(2.0 + 3200)
    assert law.seconds_for(np.sqrt(variance / 6400)).how == EXTRAPOLATED
    assert law.error_after(1000.0).how == EXTRAPOLATED
    assert law.error_after(2.1).how == AT_LEAST and law.error_after(2.1).value == pytest.approx(np.sqrt(variance))


def test_cost_is_split_into_start_and_samples():
    samples = np.array([1, 4, 16, 64])
    assert cost(samples, 3.0 + 0.25 * samples) == pytest.approx((3.0, 0.25))
    # Neither part is ever negative, and one measurement gives only the sum.
    assert cost(samples, 0.25 * samples - 0.1)[0] == 0.0
    assert cost([8], [4.0]) == (0.0, 0.5)


def test_a_ladder_is_interpolated_and_marked_where_extrapolated():
    ladder = [of_error(1, 1.0, 0.4), of_error(4, 4.0, 0.2), of_error(16, 16.0, 0.1)]
    between = seconds_on_ladder(ladder, np.sqrt(0.2 * 0.1))
    assert between.value == pytest.approx(8.0) and between.how == MEASURED
    assert seconds_on_ladder(ladder, 0.5).value == 1.0 and seconds_on_ladder(ladder, 0.5).how == AT_MOST
    beyond = seconds_on_ladder(ladder, 0.05)
    assert beyond.value == pytest.approx(64.0) and beyond.how == AT_LEAST
    assert seconds_on_ladder(ladder, 0.0).value == np.inf
    assert (error_on_ladder(ladder, 5.0).value, error_on_ladder(ladder, 5.0).how) == (0.2, MEASURED)
    assert error_on_ladder(ladder, 0.5).how == AT_LEAST


def test_a_noisy_reference_states_the_samples_of_a_good_one(truth):
    layer = 1.05 * truth
    a, b = traced(truth, 16, 1), traced(truth, 16, 2)
    exact = rung(layer, truth, truth)
    verdict = judge(exact, a, b, EVERYWHERE, 10.0)
    assert not verdict.good and verdict.more > 1.5 and verdict.seconds == pytest.approx(10.0 * verdict.more)
    assert "too noisy" in str(verdict)
    # With as many samples as it asks for, 20 references scatter the error by about the 10 % that it promises.
    samples = int(16 * verdict.more)
    found = [rung(layer, traced(truth, samples, 10 + i), traced(truth, samples, 60 + i)).rmse.value for i in range(20)]
    assert 0.05 < np.std(found) / np.mean(found) < 0.2
    a, b = traced(truth, 2 * samples, 3), traced(truth, 2 * samples, 4)
    assert judge(exact, a, b, EVERYWHERE, 10.0).good


def test_a_noiseless_reference_is_good_and_one_noisier_than_the_error_is_marked(truth):
    assert judge(rung(1.1 * truth, truth, truth), truth, truth, EVERYWHERE, 1.0).good
    a, b = traced(truth, 4, 1), traced(truth, 4, 2)
    hidden = judge(rung((a + b) / 2, a, b), a, b, EVERYWHERE, 1.0)
    assert not hidden.good and "cannot be told from 0" in str(hidden)
