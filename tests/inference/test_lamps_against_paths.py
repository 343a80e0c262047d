# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering of lamps inside a box and outside, against photons followed from them."""

import numpy as np
import pytest

from inference import Camera, Medium, PointLight, Settings, render
from inference.scene.phase_function import henyey_greenstein
from tests.support.volumes import box


@pytest.mark.parametrize(
    "sigma, albedo, anisotropy", [(4.0, 0.9, 0.0), (12.0, 0.9, 0.0), (12.0, 0.5, 0.0), (12.0, 0.9, 0.8)]
)
def test_the_light_of_a_lamp_inside_smoke_is_that_of_traced_paths(sigma, albedo, anisotropy):
    lamp, medium = np.array([0.28, -0.2, 0.1]), Medium(sigma, albedo, anisotropy)
    expected, noise = traced_towards_z(lamp, medium, 40000)
    assert rendered_towards_z(lamp, medium) == pytest.approx(expected, rel=0.07, abs=3.0 * noise)


@pytest.mark.parametrize("lamp", [(0.0, 1.1, -0.6), (0.2, -1.0, -1.0)])
@pytest.mark.parametrize("sigma", [4.0, 12.0])
def test_the_light_of_a_lamp_outside_smoke_is_that_of_traced_paths(lamp, sigma):
    """A narrow phase function tells the direction to the lamp from where light is scattered, before and at last."""
    lamp, medium = np.array(lamp), Medium(sigma, 0.9, 0.857)
    expected, noise = traced_towards_z(lamp, medium, 1_000_000)
    assert noise < 0.025 * expected
    assert rendered_towards_z(lamp, medium) == pytest.approx(expected, rel=0.08)


def rendered_towards_z(lamp, medium):
    """Intensity along z of the multiple scattering of a lamp of power 1 in a unit box, as rendered."""
    view = Camera(np.eye(4), "orthographic", (24, 24), ortho_scale=1.1)
    view.world_matrix[2, 3] = 3.0
    layer = render([(box(voxels=16), medium)], [PointLight(lamp, 1.0)], view, Settings(depth_samples=24))
    return layer.multiple[..., 0].mean() * 1.1**2


def traced_towards_z(lamp, medium, photons, seed=8):
    """Intensity along z of collisions after the first, of photons of a lamp, in a unit box; and its standard error."""
    random = np.random.default_rng(seed)
    sigma, albedo, g = medium.sigma_t[0], medium.albedo[0], medium.anisotropy

    def turned(along):
        """Directions at Henyey and Greenstein's angles to others (N, 3)."""
        u, angle = random.uniform(-1.0, 1.0, len(along)), random.uniform(0.0, 2.0 * np.pi, len(along))
        cosine = (1.0 + g * g - ((1.0 - g * g) / (1.0 + g * u)) ** 2) / (2.0 * g) if g else u
        across = np.cross(along, np.where(np.abs(along[:, :1]) > 0.5, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]]))
        across /= np.linalg.norm(across, axis=1)[:, None]
        sideways = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(along, across)
        return cosine[:, None] * along + np.sqrt(np.maximum(1.0 - cosine**2, 0.0))[:, None] * sideways

    found, along = np.zeros(photons), random.normal(size=(photons, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    # Those that meet the box begin where they enter it.
    ends = np.sort([(-0.5 - lamp) / along, (0.5 - lamp) / along], axis=0)
    first, last = np.maximum(ends[0].max(axis=1), 0.0), ends[1].min(axis=1)
    number, weight = np.flatnonzero(first < last), albedo
    along = along[number]
    place = lamp + first[number, None] * along
    for order in range(400):
        place = place + along * random.exponential(1.0 / sigma, (len(place), 1))
        inside = np.abs(place).max(axis=1) < 0.5
        place, number, along = place[inside], number[inside], along[inside]
        if order:
            phase = henyey_greenstein(along[:, 2], g)
            found[number] += weight * np.exp(-sigma * (0.5 - place[:, 2])) * phase
        weight *= albedo
        along = turned(along)
    return found.mean(), found.std() / photons**0.5
