"""Single scattering of light from a part of the sphere, for which one direction stands.

A phase function may be far narrower than that part. Its mean over the part's light takes the place of its value at the one
direction, so that light scatters forward wherever it comes from; shadows are those of the one direction. The mean is smooth
across an image: it is taken at places all over it, and interpolated between.
"""

import numpy as np

from .products import product
from .rays import image_rays, widest_angle
from .scene import Camera

# Angle from place to place, and places along an image's longer edge at most.
SPACING, MOST = np.radians(1.5), 96
# Values of a phase function that are made at a time.
AT_ONCE = 1 << 20


class SpreadLight:
    """Mean phase functions of suns across a camera's image.

    suns: L of them, each with its `spread`; phases: V functions of the cosine between the directions before and after
    scattering; check: called often. A part of the image has the places of the whole.
    """

    def __init__(self, camera: Camera, suns, phases, check=lambda: None):
        width, height = camera.resolution
        self.step = max(width, height) / np.clip(np.ceil(widest_angle(camera) / SPACING), 1, MOST)
        self.count = [int(np.ceil(size / self.step)) + 1 for size in (height, width)]
        rows, columns = (self.step * np.arange(count) for count in self.count)
        x, y = (values.ravel() for values in np.meshgrid(columns, rows))
        _, directions, _ = image_rays(camera, x, y)
        table = [[_means(directions, sun, phase, check) for sun in suns] for phase in phases]
        #: float64 (rows, columns, V, L)
        self.table = np.moveaxis(table, 2, 0).reshape(*self.count, len(phases), len(suns))

    def phase(self, x, y) -> np.ndarray:
        """(N, V, L) at places (N,) of the image, in pixels from its upper left corner."""
        cells, parts = [], []
        for place, count in zip((y, x), self.count):
            cells.append(np.minimum((place / self.step).astype(int), count - 2))
            parts.append((place / self.step - cells[-1])[:, None, None])
        (i, j), (u, v) = cells, parts
        above, below = ((1.0 - v) * self.table[row, j] + v * self.table[row, j + 1] for row in (i, i + 1))
        return (1.0 - u) * above + u * below


def _means(directions, sun, phase, check) -> np.ndarray:
    """(P,): at unit directions (P, 3) the mean of a phase function over the sun's light."""
    towards, shares = sun.spread
    rows = max(AT_ONCE // len(shares), 1)
    means = []
    for start in range(0, len(directions), rows):
        check()
        means.append(product(phase(product(directions[start : start + rows], towards.T)), shares))
    return np.concatenate(means)
