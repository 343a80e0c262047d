# SPDX-License-Identifier: GPL-3.0-or-later
"""Random environments to train with: skies over dark ground, bright lobes, glowing horizons, and gradients."""

import numpy as np

from inference.scene.environment import pixel_directions, pixel_solid_angles

#: Rows of the pictures; twice as many columns.
ROWS = 64


def random_environment(random: np.random.Generator) -> np.ndarray:
    """Radiance float32 (ROWS, 2 ROWS) as `inference.Environment` reads it, of mean 1 over the sphere."""
    directions = pixel_directions(ROWS)
    axis = _unit(random)
    height = directions @ axis
    kind = random.choice(5, p=[0.2, 0.25, 0.25, 0.15, 0.15])
    radiance = np.full(height.shape, 0.02)
    if kind == 0:
        # A gradient.
        radiance += np.clip(1.0 + random.uniform(0.3, 1.0) * height, 0.0, None)
    elif kind == 1:
        # A sky over dark ground, brighter towards the horizon or the zenith.
        sky = np.clip(height, 0.0, 1.0)
        radiance += np.where(height > 0.0, 1.0 + random.uniform(-0.8, 2.0) * sky, random.uniform(0.0, 0.3))
    elif kind == 3:
        # A glowing horizon.
        radiance += np.exp(-((height / random.uniform(0.06, 0.4)) ** 2)) + random.uniform(0.0, 0.2)
    if kind == 3:
        radiance = radiance * (1.0 + random.uniform(0.0, 1.0) * directions @ _unit(random))
    lobes = {2: 1, 4: random.integers(2, 5)}.get(kind, random.integers(0, 2))
    for _ in range(lobes):
        # Widths from about 8 to 60 degrees.
        sharpness = np.exp(random.uniform(np.log(1.0), np.log(50.0)))
        lobe = np.exp(sharpness * (directions @ _unit(random) - 1.0))
        radiance = radiance + random.uniform(0.3, 1.0) * lobe * min(sharpness, 10.0)
    weights = pixel_solid_angles(ROWS)
    return (radiance * (4.0 * np.pi / (radiance * weights).sum())).astype(np.float32)


def _unit(random: np.random.Generator) -> np.ndarray:
    vector = random.normal(size=3)
    return vector / np.linalg.norm(vector)
