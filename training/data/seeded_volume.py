"""The volume that a file of training data is about, from its seed alone."""

import numpy as np

from inference.scene import Volume
from training.data.volumes import make_volume

# Cells along the cube's edge: real grids are coarse and fine.
RESOLUTIONS = (96, 208)


def cube_volume(density: np.ndarray, name: str = "volume") -> Volume:
    """A grid (n, n, n) whose cells fill the cube [-1/2, 1/2]^3."""
    n = density.shape[0]
    world_from_index = np.diag([1 / n, 1 / n, 1 / n, 1.0])
    world_from_index[:3, 3] = 0.5 / n - 0.5
    return Volume(density, world_from_index, name)


def seeded_volume(seed: int):
    """The volume of a seed, and the generator from which everything else about it is drawn."""
    random = np.random.default_rng([seed, 2023])
    return cube_volume(make_volume(seed, int(random.integers(*RESOLUTIONS))).density, str(seed)), random
