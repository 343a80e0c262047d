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
    (_, expected), (_, noise) = traced_towards_z(lamp, medium, 40000)
    assert rendered_towards_z(lamp, medium)[1] == pytest.approx(expected, rel=0.1, abs=3.0 * noise)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.05, 0.15])
def test_the_light_of_a_sphere_inside_smoke_is_that_of_traced_paths(radius):
    """What it scatters within itself, too."""
    lamp, medium = np.array([0.2, -0.2, 0.1]), Medium(12.0, 0.9)
    expected, noise = traced_towards_z(lamp, medium, 400_000, radius)
    found = rendered_towards_z(lamp, medium, radius)
    assert np.all(noise < 0.01 * expected)
    assert found == pytest.approx(expected, rel=0.07)


@pytest.mark.slow
@pytest.mark.parametrize("anisotropy", [0.0, 0.857])
@pytest.mark.parametrize("radius", [0.05, 0.15])
def test_the_light_of_a_soft_falloff_inside_smoke_is_that_of_traced_paths(radius, anisotropy):
    """It is weaker near its middle than that of a point, and so is what goes straight on after it scattered there.

    Single scattering knows a few places of the disk, of which a narrow phase function sees different ones.
    """
    lamp, medium = np.array([0.2, -0.2, 0.1]), Medium(12.0, 0.9, anisotropy)
    expected, noise = traced_towards_z(lamp, medium, 400_000, radius, soft_falloff=True)
    found = rendered_towards_z(lamp, medium, radius, soft_falloff=True)
    assert np.all(noise < 0.015 * expected)
    assert found[0] == pytest.approx(expected[0], rel=0.15)
    assert found[1] == pytest.approx(expected[1], rel=0.1)


@pytest.mark.parametrize("lamp", [(0.0, 1.1, -0.6), (0.2, -1.0, -1.0)])
@pytest.mark.parametrize("sigma", [4.0, 12.0])
def test_the_light_of_a_lamp_outside_smoke_is_that_of_traced_paths(lamp, sigma):
    """A narrow phase function tells the direction to the lamp from where light is scattered, before and at last."""
    lamp, medium = np.array(lamp), Medium(sigma, 0.9, 0.857)
    (_, expected), (_, noise) = traced_towards_z(lamp, medium, 1_000_000)
    assert noise < 0.025 * expected
    assert rendered_towards_z(lamp, medium)[1] == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("height", [0.45, 0.52])
def test_light_that_comes_back_beside_a_lamp_is_that_of_traced_paths(height):
    """At wide angles a narrow phase function scatters little of what goes straight on."""
    lamp, medium = np.array([0.1, 0.2, height]), Medium(12.0, 0.9, 0.857)
    (_, expected), (_, noise) = traced_towards_z(lamp, medium, 400_000)
    assert noise < 0.015 * expected
    assert rendered_towards_z(lamp, medium)[1] == pytest.approx(expected, rel=0.12)


def rendered_towards_z(lamp, medium, radius=0.0, soft_falloff=False):
    """Intensity along z of the single and the multiple scattering of a lamp of power 1 in a unit box, as rendered."""
    view = Camera(np.eye(4), "orthographic", (24, 24), ortho_scale=1.1)
    view.world_matrix[2, 3] = 3.0
    light = PointLight(lamp, 1.0, radius, soft_falloff=soft_falloff)
    layer = render([(box(voxels=16), medium)], [light], view, Settings(depth_samples=24))
    return np.array([layer.single[..., 0].mean(), layer.multiple[..., 0].mean()]) * 1.1**2


def traced_towards_z(lamp, medium, photons, radius=0.0, seed=8, soft_falloff=False):
    """Intensity along z of the first and of later collisions of a lamp's photons, in a unit box; and standard errors.

    Of a sphere, whose radiance is the same within, as many go inwards as outwards, and no further than its far side.
    Those of a soft falloff start where they collide first, with light of a disk that faces this place.
    """
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

    found, along = np.zeros((2, photons)), random.normal(size=(photons, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    start, limit, weight = np.tile(lamp, (photons, 1)), np.full(photons, np.inf), np.full(photons, albedo)
    if radius and soft_falloff:
        far = np.max([(-0.5 - lamp) / along, (0.5 - lamp) / along], axis=0).min(axis=1)
        distance = random.uniform(0.0, far)
        across = np.cross(along, random.normal(size=along.shape))
        across *= (radius * np.sqrt(random.random(photons)) / np.linalg.norm(across, axis=1))[:, None]
        way = distance[:, None] * along - across
        length = np.linalg.norm(way, axis=1)
        weight *= sigma * far * (distance / length) ** 3 * np.exp(-sigma * length)
        start, along = lamp + distance[:, None] * along, way / length[:, None]
    elif radius:
        # Sums of normals and directions all around are distributed as cosines.
        start, normal, around = lamp + radius * along, along, random.normal(size=along.shape)
        along = normal + around / np.linalg.norm(around, axis=1)[:, None]
        along /= np.linalg.norm(along, axis=1)[:, None]
        along[::2] *= -1.0
        limit[::2] = -2.0 * radius * (along * normal).sum(axis=1)[::2]
        weight *= 2.0
    # Those that meet the box begin where they enter it.
    ends = np.sort([(-0.5 - start) / along, (0.5 - start) / along], axis=0)
    first, last = np.maximum(ends[0].max(axis=1), 0.0), ends[1].min(axis=1)
    number = np.flatnonzero(first < last)
    along, limit = along[number], limit[number]
    place = start[number] + first[number, None] * along
    for order in range(400):
        length = random.exponential(1.0 / sigma, len(place)) if order or not soft_falloff else np.zeros(len(place))
        place = place + along * length[:, None]
        inside = (np.abs(place).max(axis=1) < 0.5) & (length < limit)
        place, number, along, limit = place[inside], number[inside], along[inside], np.full(inside.sum(), np.inf)
        phase = henyey_greenstein(along[:, 2], g)
        found[min(order, 1), number] += weight[number] * np.exp(-sigma * (0.5 - place[:, 2])) * phase
        weight *= albedo
        along = turned(along)
    return found.mean(axis=1), found.std(axis=1) / photons**0.5
