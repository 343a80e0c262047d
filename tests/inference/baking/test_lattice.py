# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a volume a camera sees, on the cells on which a bake computes it."""

import numpy as np
import pytest

from inference.baking.directional_factor import BakedView
from inference.baking.lattice import BakeLattice, Visibility

VOXELS = 48
ALONG = np.array([0.38, 0.2, -0.9]) / np.linalg.norm([0.38, 0.2, -0.9])


def ragged() -> BakeLattice:
    """Dense clumps with gaps between them, in a cube of edge 1 about the origin."""
    density = (np.random.default_rng(5).random((12,) * 3) < 0.2).astype(np.float32).repeat(4, 0).repeat(4, 1)
    frame = np.diag([1.0 / VOXELS] * 3 + [1.0])
    frame[:3, 3] = 0.5 / VOXELS - 0.5
    return BakeLattice(density.repeat(4, 2), frame, 1)


@pytest.mark.parametrize("view", [BakedView(direction=ALONG), BakedView(position=-30.0 * ALONG)])
def test_a_camera_sees_what_lies_on_its_own_rays(view):
    lattice = ragged()
    visibility = Visibility(lattice, 40.0)
    voxels = np.argwhere(np.ones((VOXELS,) * 3, bool))
    expected = visibility.transmittances(voxels, -ALONG[None])[:, 0]
    found = visibility.towards(view, lattice).reshape(-1)
    assert np.count_nonzero(expected < 1e-3) > 1000 and np.count_nonzero(expected > 0.3) > 1000
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.05
