# SPDX-License-Identifier: GPL-3.0-or-later
"""The volume that a file of training data is made from, given its seed."""

import numpy as np

from inference.scene import Volume
from training.procedural.volumes import make_volume

#: Cells per cube edge, since real grids are coarse and fine; the upper end is excluded.
RESOLUTIONS = (96, 208)


def cube_volume(density: np.ndarray, name: str = "volume") -> Volume:
    """A density (n, n, n) as a Volume whose cells fill the cube [-1/2, 1/2]^3."""
    n = density.shape[0]
    world_from_index = np.diag([1 / n, 1 / n, 1 / n, 1.0])
    world_from_index[:3, 3] = 0.5 / n - 0.5
    return Volume(density, world_from_index, name)


def seeded_volume(seed: int):
    """The Volume of a seed, and the numpy Generator that draws everything else about it."""
    random = np.random.default_rng([seed, 2023])
    return cube_volume(make_volume(seed, int(random.integers(*RESOLUTIONS))).density, str(seed)), random
