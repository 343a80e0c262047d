# SPDX-License-Identifier: GPL-3.0-or-later
"""Values between known ones: against the equations of kriging over all of them, and of what is smooth."""

import numpy as np
import pytest

from inference.baking.kriging import NOISE, RANGE, REACH, krige

SHAPE = (17, 12, 9)


def cells_at(places: np.ndarray) -> np.ndarray:
    """Numbers (N,) of cells int (N, 3)."""
    return np.ravel_multi_index(tuple(places.T), SHAPE)


def test_few_known_values_give_those_of_least_expected_error():
    rng = np.random.default_rng(1)
    known = np.array([[8, 6, 4], [9, 6, 4], [7, 3, 5], [10, 8, 2]])
    values, mean = rng.normal(size=(len(known), 2)), np.array([0.5, -1.0])
    asked = known[0] + rng.integers(-1, 2, (30, 3))

    def covariance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.exp(-np.linalg.norm(a[:, None] - b, axis=2) / RANGE)

    weights = np.linalg.solve(covariance(known, known) + NOISE * np.eye(len(known)), covariance(known, asked))
    found = krige(SHAPE, cells_at(known), values, mean, cells_at(asked))
    np.testing.assert_allclose(found, mean + weights.T @ (values - mean), rtol=1e-4, atol=1e-5)


def test_far_from_known_values_is_the_mean_at_edges_and_without_any():
    corners = np.array([[x, y, z] for x in (0, 16) for y in (0, 11) for z in (0, 8)])
    known, mean = np.array([[0, 0, 0]]), np.array([3.0])
    near = np.linalg.norm(corners - known, axis=1) <= REACH
    found = krige(SHAPE, cells_at(known), np.array([[1.0]]), mean, cells_at(corners))[:, 0]
    assert np.all(found[~near] == 3.0) and found[near] == pytest.approx(1.0 + 2.0 * NOISE / (1.0 + NOISE))
    nothing = krige(SHAPE, np.zeros(0, int), np.zeros((0, 1)), mean, cells_at(corners))
    assert np.all(nothing == 3.0)


def test_what_is_smooth_comes_back_better_than_from_the_nearest():
    rng = np.random.default_rng(2)
    cells = np.indices(SHAPE).reshape(3, -1).T
    truth = np.sin(0.4 * cells[:, 0] + 0.3 * cells[:, 1]) + 0.1 * cells[:, 2]
    known = np.sort(rng.choice(len(cells), len(cells) // 6, replace=False))
    found = krige(SHAPE, known, truth[known, None], truth.mean()[None], np.arange(len(cells)))[:, 0]
    nearest = known[np.linalg.norm(cells[:, None] - cells[known], axis=2).argmin(axis=1)]
    error, of_nearest = (np.sqrt(np.mean((values - truth) ** 2)) for values in (found, truth[nearest]))
    assert error < 0.6 * of_nearest
