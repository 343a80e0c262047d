# SPDX-License-Identifier: GPL-3.0-or-later
"""Depths along rays: what they integrate, and how many a ray gets."""

import numpy as np
import pytest

from inference.marching.depth_samples import DepthSamples, sample_opacities


@pytest.mark.parametrize("most", [1, 2, 5, 9])
def test_polynomials_are_integrated_exactly(most):
    """Over an opaque ray, up to degree 2n - 1."""
    ray, opacity, weight = sample_opacities(np.array([1.0]), most)
    assert len(ray) == most
    for degree in range(2 * most):
        assert (weight * opacity**degree).sum() == pytest.approx(1.0 / (degree + 1), rel=1e-12)


def test_weights_sum_to_the_rays_opacity_and_faint_rays_get_fewer():
    alpha = np.array([0.0, 1e-6, 0.01, 0.3, 0.9, 1.0])
    ray, opacity, weight = sample_opacities(alpha, 8)
    counts = np.bincount(ray, minlength=6)
    assert np.all(np.diff(ray) >= 0) and np.all(np.diff(counts) >= 0)
    assert counts[0] == counts[1] == 0 and counts[2] == 2 and counts[-1] == 8
    np.testing.assert_allclose(np.bincount(ray, weight, 6)[2:], alpha[2:], rtol=1e-12)
    assert np.all((opacity > 0.0) & (opacity < alpha[ray]))
    # Unless that is turned off.
    ray, _, weight = sample_opacities(alpha, 8, adaptive=False)
    np.testing.assert_array_equal(np.bincount(ray, minlength=6), [0, 8, 8, 8, 8, 8])
    np.testing.assert_allclose(np.bincount(ray, weight, 6), alpha, rtol=1e-12)


def test_the_estimated_error_is_zero_for_a_line_and_that_of_noise_for_noise():
    random = np.random.default_rng(0)
    rays, most = 4000, 8
    ray, opacity, weight = sample_opacities(np.ones(rays), most)
    nothing = np.zeros((rays, 3))
    pixel = np.arange(rays)
    samples = DepthSamples(
        pixel, nothing, nothing, nothing[:, 0], ray, opacity, weight, fraction=np.ones((len(ray), 1))
    )
    pixels, straight = samples.standard_error(weight * (1.0 + 2.0 * opacity), np.arange(len(weight)))
    np.testing.assert_array_equal(pixels, np.arange(rays))
    assert straight.max() < 1e-12
    noise = weight * random.normal(size=len(ray))
    _, told = samples.standard_error(noise, np.arange(len(noise)))
    spread = np.bincount(ray, noise).std()
    # Independent noise does not cancel along a ray as that of lookups does: a factor of two.
    assert np.sqrt((told**2).mean()) == pytest.approx(0.5 * spread, rel=0.1)
