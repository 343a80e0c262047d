# SPDX-License-Identifier: GPL-3.0-or-later
"""How far light goes between two scatterings."""

import numpy as np
import pytest

from inference.transport.mean_free_path import FARTHEST, mean_free_path


def test_the_mean_free_path_is_that_where_most_is_scattered():
    """In a block within a veil that of the block; in thin fog, and where nothing is, at most a part of the cube."""
    density = np.full((16, 16, 16), 1e-3, np.float32)
    density[4:12, 4:12, 4:12] = 1.0
    assert mean_free_path(density, 20.0) == pytest.approx(1.0 / 20.0, rel=0.1)
    assert mean_free_path(density, 0.01) == FARTHEST
    assert mean_free_path(np.zeros_like(density), 20.0) == FARTHEST
