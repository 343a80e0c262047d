# SPDX-License-Identifier: GPL-3.0-or-later
"""Irradiance of ground below a homogeneous slab, against photons that are followed one by one."""

import numpy as np
import pytest

from inference import Environment
from inference.environments.surface_irradiance import SurfaceIrradiance
from inference.grids.working_cube import fit_cube
from inference.transport.discrete_ordinates import DiscreteOrdinates
from tests.support.volumes import box

CELLS, HALF, PHOTONS = 32, 0.25, 200_000
# Columns of the slab's lower face, along an edge.
COLUMNS = 4


def slab_irradiance(sigma, albedo):
    """Of the columns of the face of a slab of edges 1, 1 and 2 HALF, in its working cube."""
    cube = fit_cube(box((1.0, 1.0, 2.0 * HALF)))
    height = (np.arange(CELLS) + 0.5) / CELLS - 0.5
    density = np.broadcast_to(np.abs(height) < HALF, (CELLS,) * 3).astype(np.float32)
    solver = DiscreteOrdinates(np.ascontiguousarray(density), sigma, 0.0, albedo=albedo)
    axis = (np.arange(4 * COLUMNS) + 0.5) / (4 * COLUMNS) - 0.5
    x, y = (values.ravel() for values in np.meshgrid(axis, axis, indexing="ij"))
    points = np.stack([x, y, np.full(len(x), -HALF)], axis=1)
    return SurfaceIrradiance(solver, cube, points, np.tile([0.0, 0.0, 1.0], (len(x), 1)))


def in_columns(values):
    return values.reshape(COLUMNS, 4, COLUMNS, 4).mean(axis=(1, 3))


def follow(random, photons, sigma, albedo):
    """Irradiance (COLUMNS, COLUMNS) of the lower face by unscattered light and by scattered light.

    photons: positions and directions (N, 3) of those that enter, and the power (N,) of each. They scatter alike in all
    directions.
    """
    points, directions, powers = photons
    found, least, scattered = np.zeros((2, COLUMNS, COLUMNS)), 1e-3 * powers.max(), 0
    while len(points):
        points = points + directions * random.exponential(1.0 / sigma, (len(points), 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            at = points - directions * ((points[:, 2] + HALF) / directions[:, 2])[:, None]
        below = (points[:, 2] < -HALF) & np.all(np.abs(at[:, :2]) < 0.5, axis=1)
        column = ((at[below, :2] + 0.5) * COLUMNS).astype(int)
        np.add.at(found[scattered], tuple(column.T), powers[below] * COLUMNS**2)
        inside = np.all(np.abs(points) < [0.5, 0.5, HALF], axis=1)
        points, powers = points[inside], powers[inside] * albedo
        # Russian roulette.
        chance = np.where(powers < least, 0.1, 1.0)
        survives = random.random(len(points)) < chance
        points, powers, scattered = points[survives], (powers / chance)[survives], 1
        directions = random.normal(size=(len(points), 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return found


def from_sun(random):
    """Photons of a sun of irradiance 1 in the zenith."""
    points = np.column_stack([random.uniform(-0.5, 0.5, (PHOTONS, 2)), np.full(PHOTONS, HALF)])
    return points, np.tile([0.0, 0.0, -1.0], (PHOTONS, 1)), np.full(PHOTONS, 1.0 / PHOTONS)


def from_dome(random):
    """Photons of a sky of radiance 1 over the upper half of the sphere, which enter through five faces."""
    down, angle = random.random(PHOTONS), random.uniform(0.0, 2.0 * np.pi, PHOTONS)
    sine = np.sqrt(1.0 - down**2)
    directions = np.column_stack([sine * np.cos(angle), sine * np.sin(angle), -down])
    areas = np.abs(directions) * [2.0 * HALF, 2.0 * HALF, 1.0]
    axis = (random.random(PHOTONS)[:, None] * areas.sum(axis=1)[:, None] > np.cumsum(areas, axis=1)).sum(axis=1)
    points, each = random.uniform(-1.0, 1.0, (PHOTONS, 3)), np.arange(PHOTONS)
    points[each, axis] = -np.sign(directions[each, axis])
    return points * [0.5, 0.5, HALF], directions, areas.sum(axis=1) * (2.0 * np.pi / PHOTONS)


@pytest.mark.parametrize("sigma, albedo", [(4.0, 0.9), (16.0, 1.0)])
def test_sunlight_scattered_to_ground_is_what_photons_bring(sigma, albedo):
    random = np.random.default_rng(0)
    _, expected = follow(random, from_sun(random), sigma, albedo)
    found = in_columns(slab_irradiance(sigma, albedo).scattered(np.array([0.0, 0.0, 1.0])))
    assert found.mean() == pytest.approx(expected.mean(), rel=0.1)
    assert found == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("sigma, albedo", [(4.0, 0.9), (16.0, 1.0)])
def test_ground_keeps_the_share_of_the_sky_that_photons_bring(sigma, albedo):
    dome = np.zeros((64, 128, 3), np.float32)
    dome[:32] = 1.0
    random = np.random.default_rng(1)
    expected = follow(random, from_dome(random), sigma, albedo).sum(axis=0) / np.pi
    found = in_columns(slab_irradiance(sigma, albedo).share([Environment(dome)]))
    assert found.mean() == pytest.approx(expected.mean(), rel=0.1)
    assert found == pytest.approx(expected, rel=0.25)


def test_all_of_the_sky_reaches_ground_in_a_vacuum():
    random = np.random.default_rng(2)
    dome = random.uniform(0.5, 1.0, (8, 16, 3)).astype(np.float32)
    dome[4:] = 0.0
    assert slab_irradiance(1e-6, 0.9).share([Environment(dome)]) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("sigma, albedo", [(4.0, 0.9), (16.0, 1.0)])
def test_light_from_below_the_ground_changes_nothing(sigma, albedo):
    """An even World has no net flux; its upper half alone lights ground."""
    dome = np.zeros((64, 128, 3), np.float32)
    dome[:32] = 1.0
    ground = slab_irradiance(sigma, albedo)
    assert ground.share([Environment(np.ones_like(dome))]) == pytest.approx(ground.share([Environment(dome)]), rel=0.01)


@pytest.mark.parametrize("rows", [slice(0, 4), slice(4, 8), slice(0, 8)])
@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0.0, 0.8), (-0.5, 0.5, -0.7071)])
def test_no_surface_gets_much_more_light_than_there_is(rows, normal):
    sky = np.zeros((8, 16, 3), np.float32)
    sky[rows] = 1.0
    ground = slab_irradiance(4.0, 0.9)
    ground.normals = np.broadcast_to(np.array(normal) / np.linalg.norm(normal), ground.normals.shape)
    share = ground.share([Environment(sky)])
    assert np.isfinite(share).all() and 0.0 <= share.min() and share.max() <= 1.25
