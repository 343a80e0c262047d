"""Light from a part of the sphere, for which one direction stands.

A phase function may be far narrower than that part. Its mean over the part's light takes the place of its value at the one
direction, so that light scatters forward wherever it comes from. What hardly turns, which may be most of it, comes along the
camera ray itself, behind all that the ray meets; the rest is shadowed as the one direction is. The means are smooth across
an image: they are taken at places all over it, and interpolated between.
"""

import numpy as np

from ..numerics.small_matmul import product
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.camera import Camera
from ..scene.camera_rays import image_rays, widest_angle
from ..scene.phase_function import henyey_greenstein

# Angle from place to place, and places along an image's longer edge at most.
SPACING, MOST = np.radians(2.0), 96
# Light that turns by no more than this counts, the more the less it turns, as coming along the camera ray; radians.
AHEAD = np.radians(32.0)
# How often light that counts as multiple scattering has been scattered, of light in clouds and smoke that fits best; the
# anisotropy after that below which it matters little where light comes from.
ORDER, LEAST = 4, 0.02
# Values of a phase function that are made at a time.
VALUES_PER_BATCH = 1 << 20


class ExtendedLights:
    """Mean phase functions of suns across a camera's image.

    suns: L of them, each with its `spread`; phases: V functions of the cosine between the directions before and after
    scattering; see_ahead: whether it is known of each ray what keeps light from ahead. A part of the
    image has the places of the whole.
    """

    def __init__(self, camera: Camera, suns, phases, see_ahead: bool = True, cancel: CancelToken = NEVER):
        width, height = camera.resolution
        self.step = max(width, height) / np.clip(np.ceil(widest_angle(camera) / SPACING), 1, MOST)
        self.count = [int(np.ceil(size / self.step)) + 1 for size in (height, width)]
        rows, columns = (self.step * np.arange(count) for count in self.count)
        x, y = (values.ravel() for values in np.meshgrid(columns, rows))
        _, directions, _ = image_rays(camera, x, y)
        table = [[_means(directions, sun, phase, see_ahead, cancel) for sun in suns] for phase in phases]
        #: float64 (rows, columns, V, L, 2)
        self.table = np.moveaxis(table, 2, 0).reshape(*self.count, len(phases), len(suns), 2)

    def phase(self, x, y):
        """(N, V, L) at places (N,) of the image, in pixels from its upper left corner: from the suns' directions, and from
        ahead; together they are the mean of the phase function.
        """
        cells, parts = [], []
        for place, count in zip((y, x), self.count):
            cells.append(np.minimum((place / self.step).astype(int), count - 2))
            parts.append((place / self.step - cells[-1])[:, None, None, None])
        (i, j), (u, v) = cells, parts
        above, below = ((1.0 - v) * self.table[row, j] + v * self.table[row, j + 1] for row in (i, i + 1))
        return np.moveaxis((1.0 - u) * above + u * below, -1, 0)


def turned(camera: Camera, pixel, directions, sun, anisotropy: float) -> np.ndarray:
    """Unit directions (N, 3) of camera rays, turned in their planes with the sun to where a phase function has its mean over
    the sun's light: Henyey and Greenstein's of light scattered ORDER times, whose anisotropy is that power.

    Of a network that knows one direction of light this makes about the mean over all that the sun stands for.
    pixel: int (N,) of the camera's window.
    """
    g = np.copysign(abs(anisotropy) ** ORDER, anisotropy)
    if abs(g) < LEAST:
        return directions
    x0, y0, x1, _ = camera.window
    row, column = np.divmod(pixel, x1 - x0)
    spread = ExtendedLights(camera, [sun], [lambda cosine: henyey_greenstein(cosine, g)], see_ahead=False)
    mean = spread.phase(column + x0 + 0.5, row + y0 + 0.5)[0][:, 0, 0]
    # Henyey and Greenstein's phase function, solved for the cosine.
    cosine = np.clip((1.0 + g**2 - ((1.0 - g**2) / (4.0 * np.pi * mean)) ** (2.0 / 3.0)) / (2.0 * g), -1.0, 1.0)
    across = directions - (directions @ sun.direction)[:, None] * sun.direction
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
    return cosine[:, None] * sun.direction + np.sqrt(1.0 - cosine**2)[:, None] * across


def _means(directions, sun, phase, see_ahead, cancel) -> np.ndarray:
    """(P, 2): at unit directions (P, 3) the mean of a phase function over the sun's light, without and of what is ahead."""
    towards, shares = sun.spread
    rows = max(VALUES_PER_BATCH // len(shares), 1)
    means = []
    for start in range(0, len(directions), rows):
        cancel.check()
        cosine = product(directions[start : start + rows], towards.T)
        values = phase(cosine)
        ahead = np.clip((cosine - np.cos(AHEAD)) / (1.0 - np.cos(AHEAD)), 0.0, 1.0) * see_ahead
        means.append(np.stack([product(values * part, shares) for part in (1.0 - ahead, ahead)], axis=1))
    return np.concatenate(means)
