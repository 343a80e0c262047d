# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights with an angular extent, which one direction represents.

A phase function may be much narrower than the angular extent of the light. Its mean over the light replaces its value
at the representative direction, so that light scatters forward wherever it comes from. Light that is hardly deflected,
often most of it, comes along the camera ray itself, from behind everything that the ray crosses; the rest is shadowed
like the one direction. The means vary smoothly across the image: they are tabulated at knots and interpolated.
"""

from collections.abc import Callable, Sequence

import numpy as np

from ..numerics.small_matmul import product
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.camera import Camera
from ..scene.camera_rays import image_rays, widest_angle
from ..scene.description import Sun
from ..scene.phase_function import henyey_greenstein

# Angle between knots in radians, and maximal number of knots along the longer edge of the image.
KNOT_SPACING, MAX_KNOTS = np.radians(2.0), 96
# Light deflected by less than this angle in radians counts as coming along the camera ray, the more the less it is
# deflected.
FORWARD_ANGLE = np.radians(32.0)
# Scattering order that represents multiple scattering, fitted for clouds and smoke; and the anisotropy after that many
# scatterings below which the direction of the light hardly matters.
ORDER, MIN_ANISOTROPY = 4, 0.02
# The image of a camera that sees all directions, for rays of no camera.
EVERYWHERE = Camera(np.eye(4), "equirectangular", resolution=(2 * MAX_KNOTS, MAX_KNOTS))
# Values of a phase function that are evaluated at a time.
VALUES_PER_BATCH = 1 << 20


class ExtendedLights:
    """Mean phase functions of suns with an angular extent, across a camera's image.

    suns: L of them, each with its `spread`. phases: V functions of the cosine between the directions before and after
    scattering. split_forward: whether the forward part is returned separately, because what shadows light along each
    ray is known. A region of the image has the knots of the whole. Raises Cancelled.
    """

    def __init__(
        self,
        camera: Camera,
        suns: Sequence[Sun],
        phases: Sequence[Callable[[np.ndarray], np.ndarray]],
        split_forward: bool = True,
        cancel: CancelToken = NEVER,
    ):
        width, height = camera.resolution
        self.step = max(width, height) / np.clip(np.ceil(widest_angle(camera) / KNOT_SPACING), 1, MAX_KNOTS)
        self.count = [int(np.ceil(size / self.step)) + 1 for size in (height, width)]
        rows, columns = (self.step * np.arange(count) for count in self.count)
        x, y = (values.ravel() for values in np.meshgrid(columns, rows))
        _, directions, _ = image_rays(camera, x, y)
        table = np.array([[_means(directions, sun, phase, split_forward, cancel) for sun in suns] for phase in phases])
        #: float64 (rows, columns, V, L, 2)
        self.table = np.moveaxis(table, 2, 0).reshape(*self.count, len(phases), len(suns), 2)

    def phase(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Mean phase functions (2, N, V, L) at points (N,) of the image, in pixels from its upper left corner.

        First for the light from the suns' directions, then for the light from ahead; they sum to the mean of the phase
        function.
        """
        cells, fractions = [], []
        for position, count in zip((y, x), self.count):
            cells.append(np.minimum((position / self.step).astype(int), count - 2))
            fractions.append((position / self.step - cells[-1])[:, None, None, None])
        (i, j), (u, v) = cells, fractions
        above, below = ((1.0 - v) * self.table[row, j] + v * self.table[row, j + 1] for row in (i, i + 1))
        return np.moveaxis((1.0 - u) * above + u * below, -1, 0)


class EquivalentDirections:
    """Camera rays, rotated such that the phase function at one direction of light takes its mean over the sun's extent.

    A network that knows a single direction of light then predicts approximately the mean over the extent. The phase
    function is Henyey-Greenstein's of light scattered ORDER times, whose anisotropy is that power.

    camera: None for rays of no camera. sun: with or without an extent. Raises Cancelled.
    """

    def __init__(self, camera: Camera | None, sun: Sun, anisotropy: float, cancel: CancelToken = NEVER):
        g = np.copysign(abs(anisotropy) ** ORDER, anisotropy)
        self.sun, self.g, self.lights, self.camera = sun.direction, g, None, camera
        if sun.spread is not None and abs(g) >= MIN_ANISOTROPY:
            phases = [lambda cosine: henyey_greenstein(cosine, g)]
            self.lights = ExtendedLights(camera or EVERYWHERE, [sun], phases, split_forward=False, cancel=cancel)

    def __call__(self, directions: np.ndarray, image: tuple[np.ndarray, np.ndarray] | None = None) -> np.ndarray:
        """Unit directions (N, 3) in the plane of ray and sun.

        directions: unit (N, 3) in the world. image: where the camera's rays are in its image, (N,) pixels each from the
        left and from above.
        """
        if self.lights is None:
            return directions
        if self.camera is None:
            (width, height), (x, y, z) = EVERYWHERE.resolution, directions.T
            image = (
                (0.5 + np.arctan2(x, -z) / (2.0 * np.pi)) * width,
                (0.5 - np.arcsin(np.clip(y, -1.0, 1.0)) / np.pi) * height,
            )
        assert image is not None
        x, y = image
        mean = self.lights.phase(x, y)[0][:, 0, 0]
        # Invert the Henyey-Greenstein phase function for the cosine.
        g = self.g
        cosine = np.clip((1.0 + g**2 - ((1.0 - g**2) / (4.0 * np.pi * mean)) ** (2.0 / 3.0)) / (2.0 * g), -1.0, 1.0)
        across = directions - product(directions, self.sun)[:, None] * self.sun
        across /= np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
        return cosine[:, None] * self.sun + np.sqrt(1.0 - cosine**2)[:, None] * across


def _means(
    directions: np.ndarray,
    sun: Sun,
    phase: Callable[[np.ndarray], np.ndarray],
    split_forward: bool,
    cancel: CancelToken,
) -> np.ndarray:
    """Means (P, 2) of a phase function over the sun's extent: without the light from ahead, and of that light.

    directions: unit (P, 3) of the camera rays.
    """
    assert sun.spread is not None
    towards, weights = sun.spread
    rows = max(VALUES_PER_BATCH // len(weights), 1)
    means = []
    for start in range(0, len(directions), rows):
        cancel.check()
        cosine = product(directions[start : start + rows], towards.T)
        values = phase(cosine)
        ahead = np.clip((cosine - np.cos(FORWARD_ANGLE)) / (1.0 - np.cos(FORWARD_ANGLE)), 0.0, 1.0) * split_forward
        means.append(np.stack([product(values * weight, weights) for weight in (1.0 - ahead, ahead)], axis=1))
    return np.concatenate(means)
