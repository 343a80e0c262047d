# SPDX-License-Identifier: GPL-3.0-or-later
"""A kind of light that `inference` does not know: a laser sheet, parallel light through a slit.

It is written here alone, as a descendant of `Sun` with a screen of its own, and takes every way that light takes.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from inference import Camera, Medium, RenderCache, Settings, Sun, Volume, bake, predict_multiple, render
from inference.plan.lights import brightest_light

# A thin medium in a cube from -1 to 1, so that single scattering tells where light falls.
CELLS = 16
FRAME = np.diag([2.0 / CELLS] * 3 + [1.0])
FRAME[:3, 3] = 1.0 / CELLS - 1.0
SMOKE = Volume(np.ones((CELLS,) * 3, np.float32), FRAME, "smoke")
MEDIUM, SETTINGS = Medium(0.6, 0.9, 0.3), Settings(threads=1)
WIDTH = 0.5


@dataclass
class LaserSheet(Sun):
    """Parallel light through a slit in the plane of `along` and the direction. width: of the sheet. middle: (3,)."""

    along: tuple[float, float, float] = (0.0, 1.0, 0.0)
    width: float = WIDTH
    middle: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def across(self) -> np.ndarray:
        """Unit vector (3,) across the sheet."""
        across = np.cross(self.direction, self.along)
        return across / np.linalg.norm(across)

    def screen(self, corners: np.ndarray) -> np.ndarray:
        """Two halves of a plane above the volumes, the slit between them."""
        size = 4.0 * float(np.linalg.norm(np.ptp(corners, axis=0)))
        foot = np.asarray(self.middle) + ((corners - self.middle) @ self.direction).max() * self.direction
        foot, forth = foot + 0.01 * size * self.direction, np.cross(self.across, self.direction) * size
        halves = []
        for side in (-1.0, 1.0):
            near, far = (foot + side * away * self.across for away in (0.5 * self.width, size))
            a, b, c, d = near - forth, near + forth, far + forth, far - forth
            halves += [(a, b, c), (a, c, d)]
        return np.array(halves)

    @property
    def screen_key(self) -> bytes:
        return np.array([*self.along, self.width, *self.middle]).tobytes()

    def fluence_at(self, points: np.ndarray) -> np.ndarray:
        inside = np.abs((points - self.middle) @ self.across) < 0.5 * self.width
        return inside[:, None] * self.irradiance


SHEET = LaserSheet((0.0, 1.0, 0.2), 4.0, "laser sheet", along=(0.0, 0.0, 1.0))


def camera(size: int = 32) -> Camera:
    """Looks along -Z at the sheet's edge, of which each row shows a section."""
    matrix = np.eye(4)
    matrix[2, 3] = 6.0
    return Camera(matrix, "orthographic", resolution=(size, size), ortho_scale=2.4)


@pytest.fixture(scope="module")
def layer():
    return render([(SMOKE, MEDIUM)], [SHEET], camera(), SETTINGS)


def columns(size: int = 32) -> np.ndarray:
    """World x of the columns of the picture."""
    return (np.arange(size) + 0.5) / size * 2.4 - 1.2


def test_only_the_sheet_scatters_once(layer):
    single, x = layer.single.mean(axis=(0, 2)), np.abs(columns())
    assert single[x > 0.5 * WIDTH + 0.1].max() < 1e-6 * single.max()
    sun = render([(SMOKE, MEDIUM)], [Sun(SHEET.direction, SHEET.irradiance)], camera(), SETTINGS)
    inside = x < 0.5 * WIDTH - 0.1
    np.testing.assert_allclose(single[inside], sun.single.mean(axis=(0, 2))[inside], rtol=1e-3)


def test_light_that_scattered_leaves_the_sheet(layer):
    multiple, x = layer.multiple.mean(axis=(0, 2)), np.abs(columns())
    beside = multiple[(x > 0.4) & (x < 0.8)].mean()
    assert 0.0 < beside < 0.8 * multiple[x < 0.2].mean()


def test_beside_a_sun_of_the_same_direction_each_keeps_its_own_light(layer):
    sun = Sun(SHEET.direction, SHEET.irradiance)
    both = render([(SMOKE, MEDIUM)], [SHEET, sun], camera(), SETTINGS)
    alone = render([(SMOKE, MEDIUM)], [sun], camera(), SETTINGS)
    np.testing.assert_allclose(both.single, layer.single + alone.single, atol=1e-5 * both.single.max())
    assert abs(both.multiple.mean() / (layer.multiple + alone.multiple).mean() - 1.0) < 0.02


def test_it_shows_in_the_steps_of_the_viewport(layer):
    # A coarse picture in the brightest light, a whole one from the same cache, and another after the sheet has moved.
    cache, scene = RenderCache(), [(SMOKE, MEDIUM)]
    wide, dim = replace(SHEET, width=1.5), Sun((1.0, 0.0, 0.0), 0.1)
    assert brightest_light([dim, wide], scene) == [wide]
    assert brightest_light([dim, replace(SHEET, middle=(9.0, 0.0, 0.0))], scene) == [dim]
    assert render(scene, [SHEET], camera(8), SETTINGS, cache=cache).multiple.mean() > 0.0
    whole = render(scene, [SHEET], camera(), SETTINGS, cache=cache)
    np.testing.assert_allclose(whole.rgb, layer.rgb, atol=1e-4 * layer.rgb.max())
    moved = render(scene, [replace(SHEET, middle=(0.5, 0.0, 0.0))], camera(), SETTINGS, cache=cache)
    centre = (moved.single.mean(axis=(0, 2)) @ columns()) / moved.single.mean(axis=(0, 2)).sum()
    assert abs(centre - 0.5) < 0.05


@pytest.mark.slow
def test_it_bakes():
    [lit] = bake([(SMOKE, MEDIUM)], [SHEET], camera(), SETTINGS)
    light = lit.scattered[1:-1, 1:-1, 1:-1].mean(axis=(1, 2, 3))
    middle = len(light) // 2
    assert light[middle] > 1.2 * light[-3] > 0.0


def test_it_is_asked_at_points():
    # Light that scattered more than once: most in the sheet, less the farther away.
    positions = np.stack([np.array([0.0, 0.4, 0.8]), np.zeros(3), np.zeros(3)], axis=1)
    towards = np.broadcast_to([0.0, 0.0, -1.0], positions.shape)
    light = predict_multiple(SMOKE, MEDIUM, SHEET, positions, towards)[:, 0]
    assert light[0] > light[1] > light[2] > 0.0
    whole = predict_multiple(SMOKE, MEDIUM, Sun(SHEET.direction, SHEET.irradiance), positions, towards)[:, 0]
    assert np.all(light < whole)
