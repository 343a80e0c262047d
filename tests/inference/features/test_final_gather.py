# SPDX-License-Identifier: GPL-3.0-or-later
"""Light gathered around camera rays: cases with exact answers, symmetry, and integrals taken in other ways."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter, map_coordinates

from inference.features.final_gather import (
    RINGS,
    SCALE,
    FinalGather,
    gather_directions,
    shadowed_depth,
    unit_sun_depth,
)
from inference.features.stencil import frames
from inference.scene.phase_function import henyey_greenstein
from tests.support.volumes import cloud

SUN = np.array([0.48, 0.6, 0.64])
EVEN = np.broadcast_to(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (8, 8, 8, 4))


def solid(cells=48, margin=4):
    """A cube of density 1 with air around it."""
    density = np.zeros((cells,) * 3, np.float32)
    density[(slice(margin, -margin),) * 3] = 1.0
    return density


@pytest.mark.parametrize("g", [-0.6, 0.0, 0.5, 0.857])
def test_cones_share_the_phase_functions_probability(g):
    """As much is scattered within the first cone as half of a quarter, and so on."""
    vectors = gather_directions(g).reshape(3, RINGS, -1)
    np.testing.assert_allclose((vectors**2).sum(axis=0), 1.0, atol=1e-6)
    cosines = vectors[2]
    np.testing.assert_allclose(cosines, cosines[:, :1].repeat(cosines.shape[1], axis=1), atol=1e-6)
    for ring, cosine in enumerate(cosines[:, 0]):
        within = 2.0 * np.pi * quad(lambda mu: henyey_greenstein(mu, g), cosine, 1.0)[0]
        assert within == pytest.approx((ring + 0.5) / RINGS, abs=1e-4)


def test_even_light_arrives_where_it_is_scattered_and_nothing_behind():
    """Where light is even, what is scattered towards a point is what the medium in between hides."""
    density = solid()
    gather = FinalGather.of(density, np.zeros_like(density), EVEN, (12.0, 0.857))
    found = gather(np.zeros((1, 3)), np.eye(3)[None])[0]
    single, reduced, scattered, passed = found.T
    np.testing.assert_allclose(single, 1.0 - passed, atol=1e-5)
    np.testing.assert_allclose(scattered, 1.0 - passed, atol=1e-5)
    np.testing.assert_allclose(reduced, 1.0 - passed**SCALE, atol=1e-5)
    assert np.all(passed < 0.1)


def test_integrals_converge_to_those_of_many_small_steps():
    """Eight steps come close to a fine march through the same lattices."""
    density = gaussian_filter(cloud(voxels=48).density, 2.0)
    depth, sigma = unit_sun_depth(density, SUN), 25.0
    random = np.random.default_rng(3)
    points = random.uniform(-0.2, 0.2, (40, 3))
    omega = random.normal(size=(40, 3))
    omega /= np.linalg.norm(omega, axis=1)[:, None]
    turned = frames(omega, SUN)
    found = FinalGather.of(density, depth, EVEN, (sigma, 0.857))(points, turned)
    away = np.einsum("nij,jr->nri", turned, gather_directions(0.857))
    step = 1.0 / 400.0
    way = np.arange(0.5, 600.0) * step
    places = (points[:, None, None] + way[:, None] * away[:, :, None] + 0.5) * 48 - 0.5

    def sampled(values):
        return map_coordinates(values, np.moveaxis(places, -1, 0), order=1, mode="grid-constant")

    gained = sigma * step * sampled(density)
    tau = np.cumsum(gained, axis=-1) - 0.5 * gained
    single = (np.exp(-tau - sigma * np.maximum(sampled(depth), 0.0)) * gained).sum(axis=-1)
    passed = np.exp(-gained.sum(axis=-1))
    for value, expected in ((0, single), (3, passed)):
        # Rows of the two directions across, and the single ones.
        expected = expected.reshape(40, RINGS, 2)
        across = found[:, [0, 3], value] - expected[:, [0, 2]].mean(axis=2)
        others = found[:, [[1, 2], [4, 5]], value] - expected[:, [1, 3]]
        errors = np.concatenate([across.ravel(), others.ravel()])
        assert np.sqrt((errors**2).mean()) < 0.05 and abs(errors.mean()) < 0.02


def test_mirrored_volumes_have_equal_light():
    """The plane of the camera ray and the sun halves the directions, which networks rely on."""
    density = np.ascontiguousarray(cloud(voxels=48).density, np.float32)
    mirror, sun = np.array([1.0, -1.0, 1.0]), np.array([0.6, 0.0, 0.8])
    points = np.random.default_rng(4).uniform(-0.2, 0.2, (50, 3))
    omega = np.broadcast_to([0.8, 0.0, -0.6], (50, 3))
    found = [
        FinalGather.of(values, unit_sun_depth(values, sun), EVEN, (30.0, 0.857))(places, frames(omega, sun))
        for values, places in ((density, points), (np.ascontiguousarray(density[:, ::-1]), points * mirror))
    ]
    np.testing.assert_allclose(*found, atol=1e-4)


def test_shadows_of_surfaces_take_light_once():
    density = solid()
    depth, half = np.zeros_like(density), np.full_like(density, 0.5)
    open_light, shadowed = (
        FinalGather.of(density, values, EVEN, (12.0, 0.5))(np.zeros((1, 3)), np.eye(3)[None])
        for values in (depth, shadowed_depth(depth, half, 12.0))
    )
    np.testing.assert_allclose(shadowed[..., 0], 0.5 * open_light[..., 0], rtol=1e-4)
    np.testing.assert_allclose(shadowed[..., 2:], open_light[..., 2:], rtol=1e-6)
