# SPDX-License-Identifier: GPL-3.0-or-later
"""Depths along rays: what they integrate, and how many a ray gets."""

import numpy as np
import pytest

from inference.marching.depth_samples import DepthSamples, divided, gauss_legendre
from inference.scene.settings import DETAIL
from tests.reference.march import sample_opacities


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
    one = np.zeros((len(ray), 1), np.int32)
    samples = DepthSamples(
        pixel, nothing, nothing, nothing[:, 0], ray, opacity, weight, held=one, fraction=one + 1.0, held_groups=one
    )
    pixels, straight = samples.standard_error(weight * (1.0 + 2.0 * opacity), np.arange(len(weight)))
    np.testing.assert_array_equal(pixels, np.arange(rays))
    assert straight.max() < 1e-12
    noise = weight * random.normal(size=len(ray))
    _, told = samples.standard_error(noise, np.arange(len(noise)))
    spread = np.bincount(ray, noise).std()
    # Independent noise does not cancel along a ray as that of lookups does: a factor of two.
    assert np.sqrt((told**2).mean()) == pytest.approx(0.5 * spread, rel=0.1)


@pytest.mark.parametrize("detail", DETAIL)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 16, 32])
def test_divided_shares_keep_the_nodes_and_integrate_what_is_not_smooth(count, detail):
    nodes, weights, places = divided(gauss_legendre(count), detail)
    assert len(nodes) == count * detail and weights.sum() == pytest.approx(1.0, rel=1e-12)
    assert np.all(np.diff(nodes) > 0.0)
    np.testing.assert_array_equal(nodes[places], gauss_legendre(count)[0])
    # Each sample lies within its part, so that a jump costs less than one part.
    ends = np.cumsum(weights)
    assert np.all((nodes > ends - weights - 1e-12) & (nodes < ends + 1e-12))
    for place in np.linspace(0.05, 0.95, 11):
        assert abs((weights * (nodes < place)).sum() - place) <= weights.max()


def test_samples_at_nodes_are_those_of_rays_without_detail():
    alpha, detail = np.random.default_rng(5).uniform(0.01, 1.0, 300), np.random.default_rng(6).choice(DETAIL, 300)
    nothing, pixel = np.zeros((300, 3)), np.arange(300)

    def samples(detail):
        ray, opacity, weight = sample_opacities(alpha, 6, detail=detail)
        one = np.zeros((len(ray), 1), np.int32)
        return DepthSamples(pixel, nothing, nothing, alpha, ray, opacity, weight, one, one + 1.0, one, detail=detail)

    some, expected = samples(detail), samples(None)
    assert len(some.ray) > 3 * len(expected.ray)
    np.testing.assert_allclose(np.bincount(some.ray, some.weight), alpha, rtol=1e-12)
    np.testing.assert_array_equal(some.nodes.ray, expected.ray)
    np.testing.assert_allclose(some.nodes.distance, expected.distance, rtol=1e-15)
    np.testing.assert_allclose(some.nodes.weight, expected.weight, rtol=1e-12)
    # What is even has no error.
    assert some.standard_error(some.weight, np.arange(len(some.weight)))[1].max() < 1e-12
