# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that arrives along a direction, swept for a whole grid at once: against rays that are integrated one by one."""

import numpy as np
import pytest

from inference.baking.light_ahead import SCALES, light_ahead

N = 24


def blob(at: np.ndarray, middle: np.ndarray, width: float) -> np.ndarray:
    """A smooth bump (...) at indices (..., 3)."""
    return np.exp(-(((at - middle) / width) ** 2).sum(axis=-1))


def fields(at: np.ndarray) -> np.ndarray:
    """Extinction and two sources (3, ...) at indices (..., 3)."""
    extinction = 0.5 * blob(at, np.array([12.0, 10.0, 13.0]), 5.0)
    return np.stack([extinction, blob(at, np.array([15.0, 12.0, 9.0]), 6.0), np.ones(at.shape[:-1])])


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, -1, 0), (0.3, 0.8, -0.5), (-1, 0.9, 0.2)])
def test_light_ahead_is_that_of_rays_on_their_own(direction):
    along = np.array(direction) / np.linalg.norm(direction)
    cells = np.moveaxis(np.indices((N, N, N)).astype(float), 0, -1)
    extinction, *sources = fields(cells).astype(np.float32)
    ahead, through = light_ahead(extinction, np.stack(sources), along)
    distance = np.arange(0.0, 2 * N, 0.05) + 0.025
    for place in [(12, 10, 13), (9, 12, 12), (15, 9, 14), (12, 14, 10)]:
        density, *light = fields(np.array(place) + distance[:, None] * along)
        depth = np.cumsum(density) * 0.05 - 0.5 * density * 0.05
        assert through[place] == pytest.approx(np.exp(-depth[-1]), abs=0.02)
        for k, source in enumerate(light):
            for a, scale in enumerate(SCALES):
                truth = (np.exp(-scale * depth) * source * scale * density).sum() * 0.05
                assert ahead[(k, a, *place)] == pytest.approx(truth, abs=0.02)


def test_a_steady_source_fills_what_is_not_clear():
    # Volumes have a margin: beyond the grid nothing shines.
    extinction = np.pad(np.random.default_rng(3).random((5, 7, 3)).astype(np.float32), 1)
    ahead, through = light_ahead(extinction, np.ones((1, 7, 9, 5), np.float32), np.array([0.2, -0.9, 0.3]))
    assert np.abs(ahead[0, 0] + through - 1.0).max() < 1e-5
    assert 0.0 < through.min() < 0.5
