# SPDX-License-Identifier: GPL-3.0-or-later
"""What is between lamps and points of volumes, and how much of their light volumes take."""

import numpy as np
import pytest

from inference import AreaLight, PointLight, SpotLight, Surface
from inference.grids.grid import Grid
from inference.grids.lamp_optical_depth import LampOpticalDepth
from inference.marching.lamp_in_media import place_lamp
from inference.scene.emitters import LampSource
from tests.support.volumes import box, cloud, integrals_of_density

CLOUD = cloud(voxels=32)


@pytest.mark.parametrize("lamp", [(0.9, 0.6, 0.5), (0.52, 0.0, 0.1), (0.1, -0.05, 0.12), (-7.0, 3.0, 0.4)])
def test_optical_depths_are_integrals_of_density(lamp):
    grid, lamp = Grid(CLOUD), np.array(lamp)
    depth = LampOpticalDepth(grid.density, grid.linear, grid.offset, LampSource(lamp, lamp))
    points = np.random.default_rng(3).uniform(-0.6, 0.6, (200, 3))
    found = depth(grid.index(points).T.astype(np.float32), 1.0)
    assert found == pytest.approx(integrals_of_density(grid, points, lamp), abs=0.003)
    assert depth(grid.index(points).T.astype(np.float32), 30.0) == pytest.approx(
        30.0 * integrals_of_density(grid, points, lamp), abs=0.06
    )


@pytest.mark.parametrize("soft_falloff", [False, True])
@pytest.mark.parametrize("volume, tolerance", [(box(voxels=32), 0.03), (CLOUD, 0.06)], ids=["even", "cloud"])
def test_light_of_a_sphere_inside_smoke_starts_at_its_surface(volume, tolerance, soft_falloff):
    """The mean light at a distance is the integral over the solid angle of the sphere, or of the disk for it."""
    radius, centre, sigma, random = 0.12, np.array([0.05, -0.03, 0.02]), 12.0, np.random.default_rng(7)
    grid = Grid(volume)
    lamp = place_lamp(PointLight(centre, 1.0, radius, soft_falloff=soft_falloff), [grid])
    for distance in np.array([0.3, 0.8, 1.2, 2.0, 3.0]) * radius:
        along = random.normal(size=(1500, 3))
        along /= np.linalg.norm(along, axis=1)[:, None]
        points = centre + distance * along
        index = grid.index(points).T.astype(np.float32)
        depths = [depth(index, sigma) for [depth] in lamp.depths]
        found = sum(part.fluence(points) * np.exp(-depth) for part, depth in zip(lamp.emitters, depths)).mean()
        across = np.cross(along, random.normal(size=along.shape))
        across /= np.linalg.norm(across, axis=1)[:, None]
        least = -1.0 if distance < radius else np.sqrt(1.0 - (radius / distance) ** 2)
        least = distance / np.hypot(distance, radius) if soft_falloff else least
        cosine = random.uniform(least, 1.0, (len(along), 1))
        way = cosine * -along + np.sqrt(1.0 - cosine**2) * across
        cosine = cosine[:, 0]
        reach = np.sqrt(np.maximum(radius**2 - distance**2 * (1.0 - cosine**2), 0.0))
        length = distance / cosine if soft_falloff else distance * cosine + reach * (1 if distance < radius else -1)
        passed = np.exp(-sigma * integrals_of_density(grid, points, points + length[:, None] * way, 60))
        radiance = 1.0 / (4.0 * np.pi**2 * radius**2)
        assert found == pytest.approx(2.0 * np.pi * (1.0 - least) * radiance * passed.mean(), rel=tolerance)


@pytest.mark.parametrize("height", [0.1, 0.49, 0.51, 0.9])
@pytest.mark.parametrize("kind", ["point", "spot", "area"])
def test_captured_light_is_that_of_its_rays(kind, height):
    """A wall halfway through the box ends them."""
    grid, position, down = Grid(box(voxels=16)), np.array([0.1, 0.2, height]), (0.0, 0.0, -1.0)
    lamp = {
        "point": PointLight(position, 1.0),
        "spot": SpotLight(position, down, 1.0, 0.6, 0.4),
        "area": AreaLight(np.block([[np.eye(3), position[:, None]], [np.zeros(3), 1.0]]), "square", 0.02, 1.0),
    }[kind]
    wall = np.array([[[-9.0, -9.0, -0.2], [9.0, -9.0, -0.2], [0.0, 18.0, -0.2]]])
    placed = place_lamp(lamp, [grid], [Surface(wall)])
    directions = np.random.default_rng(6).normal(size=(20000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    light = 4.0 * np.pi * 100.0**2 * lamp.fluence_at(position + 100.0 * directions)[:, 0]
    with np.errstate(divide="ignore"):
        way = np.where(directions[:, 2] < 0.0, (-0.2 - height) / directions[:, 2], np.inf)
    depth = 3.0 * integrals_of_density(grid, position + np.minimum(way, 2.0)[:, None] * directions, position, 200)
    assert placed.captured([grid], [3.0]) == pytest.approx((light * -np.expm1(-depth)).mean(), rel=0.04)
