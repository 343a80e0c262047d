# SPDX-License-Identifier: GPL-3.0-or-later
"""Cones of spot lights with a radius, against sums over all directions in which their points are seen."""

import numpy as np
import pytest

from inference import Camera, Medium, PointLight, Settings, SpotLight, render
from inference.grids.grid import Grid
from inference.marching.lamp_in_media import place_lamp
from tests.reference.lamp_march import light_directions
from tests.support.volumes import box

LOW, HIGH = np.full(3, -1.0), np.ones(3)
AXIS = np.array([0.36, -0.48, 0.8])


def spot(angle, blend, radius, soft_falloff=True):
    return SpotLight((0.1, 0.2, -0.1), AXIS, 1.0, angle, blend, radius, soft_falloff=soft_falloff)


def around(lamp, least, most, count=300, seed=3):
    """Points at some distances from a lamp."""
    random = np.random.default_rng(seed)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return lamp.position + random.uniform(least, most, (count, 1)) * directions


def passed(lamp, point, count=120):
    """Share of the light of a lamp's disk, which faces the point, that its cone lets pass."""
    away = point - lamp.position
    distance = np.linalg.norm(away)
    away /= distance
    x = np.cross(away, [0.6, 0.0, 0.8])
    x /= np.linalg.norm(x)
    y = np.cross(away, x)
    part = (np.arange(count) + 0.5) / count
    height = 1.0 - part * (1.0 - distance / np.hypot(distance, lamp.radius))
    aside, turn = np.sqrt(1.0 - height**2)[:, None], 2.0 * np.pi * part
    level = height[:, None] * (away @ AXIS) + aside * (np.cos(turn) * (x @ AXIS) + np.sin(turn) * (y @ AXIS))
    edge = np.cos(0.5 * lamp.angle)
    inside = np.clip((level - edge) / max((1.0 - edge) * lamp.blend, 1e-9), 0.0, 1.0)
    return float((inside * inside * (3.0 - 2.0 * inside)).mean())


@pytest.mark.parametrize("most", [1, 16])
@pytest.mark.parametrize("least, farthest", [(0.02, 0.3), (0.3, 1.0), (1.0, 2.0), (2.0, 6.0)])
@pytest.mark.parametrize("angle, blend", [(0.3, 0.0), (0.7, 0.3), (1.5, 0.15), (2.8, 1.0)])
def test_the_cone_of_a_soft_spot_is_averaged_over_its_disk(angle, blend, least, farthest, most):
    """most: parts of the lamp. Distances are over its radius."""
    lamp = spot(angle, blend, 0.5)
    points = around(lamp, 0.5 * least, 0.5 * farthest)
    point_light = PointLight(lamp.position, 1.0, 0.5, soft_falloff=True).emitters(LOW, HIGH, 1)[0].fluence(points)
    found = sum(part.fluence(points) for part in lamp.emitters(LOW, HIGH, most)) / point_light
    expected = np.array([passed(lamp, point) for point in points])
    assert found.mean() == pytest.approx(expected.mean(), abs=0.002, rel=0.03)
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.025


def test_light_travels_within_the_cone_also_close_to_the_disk():
    """A point near the disk sees its parts from all sides, but only what they shine along the cone arrives."""
    lamp = spot(0.7, 0.3, 0.5)
    for part in lamp.emitters(LOW, HIGH):
        points = around(lamp, 0.01, 4.0)
        away = points - part.position
        away /= np.linalg.norm(away, axis=1)[:, None]
        found = light_directions(part, points)
        within = away @ AXIS >= np.cos(0.35)
        assert found[within] == pytest.approx(away[within])
        assert found[~within] @ AXIS == pytest.approx(np.full(np.count_nonzero(~within), np.cos(0.35)))
        assert np.linalg.norm(found, axis=1) == pytest.approx(np.ones(len(found)))
        # Towards where they would travel without the cone.
        assert np.all((found[~within] * away[~within]).sum(axis=1) > away[~within] @ AXIS - 1e-9)


@pytest.mark.parametrize("angle", [1e-9, 1e-6, 1e-5, 1e-4])
@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_a_cone_as_narrow_as_rounding_gives_finite_light(angle, radius):
    lamp = spot(angle, 0.5, radius)
    placed = place_lamp(lamp, [Grid(box(voxels=4))])
    points = lamp.position + np.linspace(-1.0, 1.0, 41)[:, None] * AXIS
    found = placed.fluence(np.concatenate([points, points + [1e-7, 0.0, 0.0], around(lamp, 0.0, 2.0)]))
    assert np.all(np.isfinite(found)) and np.all(found >= 0.0)


def test_a_sphere_shines_within_itself_in_all_directions():
    """Cycles has no cone there."""
    lamp, ball = spot(0.7, 0.3, 0.5, soft_falloff=False), PointLight((0.1, 0.2, -0.1), 1.0, 0.5)
    points = around(lamp, 0.0, 0.499)
    found, expected = (sum(part.fluence(points) for part in one.emitters(LOW, HIGH)) for one in (lamp, ball))
    assert found == pytest.approx(expected)


@pytest.mark.parametrize("angle", [0.02, 0.7, 2.0, 3.1, np.pi])
@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_rays_are_lit_between_the_ends_of_the_cone_alone(angle, radius):
    lamp, random = spot(angle, 0.0, radius), np.random.default_rng(5)
    emitter = lamp.emitters(LOW, HIGH, 1)[0]
    through = lamp.position + random.uniform(-1.0, 2.0, (200, 1)) * AXIS + random.normal(size=(200, 3)) * 0.2 * angle
    origins = random.uniform(-2.0, 2.0, (200, 3))
    directions = through - origins
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    begin, end = emitter.lit_between(origins, directions)
    along = np.linspace(-4.0, 4.0, 1601)
    points = origins[:, None] + along[:, None] * directions[:, None]
    lit = emitter.fluence(points.reshape(-1, 3)).reshape(points.shape[:2]) > 0.0
    between = (along >= begin[:, None]) & (along <= end[:, None])
    assert lit.any() and not lit.all()
    assert not np.any(lit & ~between)
    if radius == 0.0:
        assert np.mean(lit != between) < 1e-5


FRAMES = {"wide": np.diag([0.5, 1.0, 1.0]), "sheared": np.array([[0.7, 0.3, 0.0], [0.0, 1.5, 0.2], [0.0, 0.0, 1.0]])}


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("angle, blend", [(0.3, 0.0), (1.5, 0.4)])
def test_an_elliptic_cone_is_round_in_its_frame(frame, angle, blend):
    """Its light, its power, the rays that it lights, and where its light travels, from the definition."""
    linear = FRAMES[frame]
    # The direction that the frame takes to +Z.
    axis = np.linalg.solve(linear, [0.0, 0.0, 1.0])
    axis /= np.linalg.norm(axis)
    lamp = SpotLight((0.1, 0.2, -0.1), axis, 1.0, angle, blend, frame=linear)
    [part] = lamp.emitters(LOW, HIGH, 1)
    points = lamp.position + np.random.default_rng(2).normal(size=(200000, 3))
    directions = points - lamp.position
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    seen = directions @ linear.T
    edge = np.cos(0.5 * angle)
    inside = np.clip((seen[:, 2] / np.linalg.norm(seen, axis=1) - edge) / max((1.0 - edge) * blend, 1e-9), 0.0, 1.0)
    share = inside * inside * (3.0 - 2.0 * inside)
    bare = PointLight(lamp.position, 1.0).emitters(LOW, HIGH, 1)[0].fluence(points)
    assert part.fluence(points) == pytest.approx(share * bare, rel=1e-6, abs=1e-12)
    assert part.power == pytest.approx(share.mean(), rel=0.08)
    first, last = part.lit_between(np.tile(lamp.position, (len(points), 1)), directions)
    assert np.all((first <= 1.0) & (last >= 1.0) | (share == 0.0))
    lit = share > 0.0
    assert light_directions(part, points)[lit] == pytest.approx(directions[lit])


@pytest.mark.slow
def test_a_beam_narrower_than_steps_shows_no_grain():
    """Single scattering of a beam through even smoke, seen from the side, column by column."""
    sigma, half, image, height = 2.0, 0.01, 512, 0.02
    lamp = SpotLight((-1.0, 0.013, height), (1.0, 0.0, 0.0), 1.0, 2.0 * half)
    view = Camera(np.eye(4), "orthographic", (image, image), ortho_scale=1.0)
    view.world_matrix[2, 3] = 3.0
    layer = render([(box(voxels=16), Medium(sigma, 1.0))], [lamp], view, Settings(depth_samples=1))
    flux, x = 0.5 * (1.0 - np.cos(half)), (np.arange(image) + 0.5) / image - 0.5
    expected = flux * sigma / (4.0 * np.pi) * np.exp(-sigma * (x + 0.5)) * np.exp(-sigma * (0.5 - height))
    # Matter fades at the box's faces.
    inner = np.abs(x) < 0.4
    assert layer.single[:, inner, 0].mean(axis=0) == pytest.approx(expected[inner], rel=0.04)
