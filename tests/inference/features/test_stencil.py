# SPDX-License-Identifier: GPL-3.0-or-later
"""The stencil against equations 1 and 2 and the layout of A.2."""

import numpy as np
import pytest

from inference.features.stencil import LAYER_MIPS, LAYER_POINTS, SPARSE, Stencil, frames
from training.data.stencil import (
    fibonacci_sphere,
    layer_radius,
    load_stencil,
    mutual_minimum_distances,
    relaxed_stencil,
    unit_layer,
)


@pytest.fixture(scope="module")
def stencil():
    return load_stencil()


def brute_force_r(points):
    """Eq. 1, term by term."""
    nearest = [min(np.linalg.norm(p - q) for j, q in enumerate(points) if j != i) for i, p in enumerate(points)]
    return sum(nearest) / len(points)


@pytest.fixture(scope="module")
def relaxed():
    return relaxed_stencil()


@pytest.mark.slow
@pytest.mark.parametrize("made", ["stencil", "relaxed"])
@pytest.mark.parametrize("layer", range(1, 9))
def test_layers_are_spread_and_scaled(request, made, layer):
    points = of_layer(request.getfixturevalue(made), layer)
    # Eq. 2: the mean nearest distance is lambda_i cells of the layer's mip.
    lam = 1.0 - 0.08 * min(layer, 5)
    assert brute_force_r(points) == pytest.approx(lam * 2.0 ** (layer - 1) / 256.0, rel=1e-5)
    distance = np.linalg.norm(points, axis=1)
    radius = layer_radius(layer, unit_layer(layer))
    if layer == 1:
        assert distance[0] == 0.0 and np.allclose(distance[1:], distance[1])
    elif layer <= 5:
        assert np.allclose(distance, distance[0])
    # Relaxing again gives other points equally far apart: the larger R, the smaller the layer.
    assert distance.max() == pytest.approx(radius, rel=0.03)


def of_layer(stencil, layer):
    start = sum(LAYER_POINTS[: layer - 1])
    return stencil.low[start : start + LAYER_POINTS[layer - 1]].astype(np.float64)


def test_relaxation_spreads_points():
    before = mutual_minimum_distances(fibonacci_sphere(16)).mean()
    assert mutual_minimum_distances(unit_layer(3)).mean() > 1.05 * before


def test_high_frequency_points_do_not_overlap(stencil):
    """Each point stands for a ball of one cell of its mip; the balls touch and do not overlap."""
    cells = np.repeat([2.0**m for m in LAYER_MIPS[8:]], 8) / 256.0
    near, far = stencil.high - cells / 2, stencil.high + cells / 2
    np.testing.assert_allclose(near[1:], far[:-1], atol=1e-7)
    np.testing.assert_allclose(stencil.high[:8] * 256, np.arange(1, 9), rtol=1e-6)
    assert stencil.high[-1] * 256 == pytest.approx(120, abs=4)


def test_relaxing_repeats_on_one_processor(relaxed):
    assert relaxed_stencil().digest == relaxed.digest


def test_frames_are_rotations_that_hold_omega_and_sun():
    random = np.random.default_rng(0)
    omega = random.normal(size=(100, 3))
    omega /= np.linalg.norm(omega, axis=1, keepdims=True)
    sun = np.array([0.0, 0.6, 0.8])
    omega[0], omega[1] = sun, -sun
    rotation = frames(omega, sun)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-12)
    product = np.swapaxes(rotation, 1, 2) @ rotation
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), (100, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(rotation[:, :, 2], omega, atol=1e-12)
    local = np.einsum("nij,i->nj", rotation, sun)
    np.testing.assert_allclose(local[:, 1], 0.0, atol=1e-6)
    assert np.all(local[:, 0] > -1e-6)


def test_sparse_stencil_keeps_a_fourth_of_each_layer(stencil):
    sparse = stencil.sparse()
    assert [np.count_nonzero(sparse.mips == mip) for mip in range(8)] == [
        sum(n // SPARSE for n, m in zip(LAYER_POINTS, LAYER_MIPS) if m == mip) for mip in range(8)
    ]
    again = Stencil.read(sparse.written(), SPARSE)
    assert again.digest == sparse.digest
    with pytest.raises(ValueError):
        Stencil.read(stencil.written(), SPARSE)
