# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that shine, as lamps."""

from dataclasses import replace

import numpy as np
import pytest

from inference import AreaLight, Camera, Medium, PointLight, Settings, Surface, render
from inference.plan.lights import mesh_lights
from inference.scene.mesh_light import MeshLight
from tests.support.surfaces import rectangle
from tests.support.volumes import box

LOW, HIGH = np.full(3, -0.5), np.full(3, 0.5)
CORNERS = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
POINTS = np.random.default_rng(3).uniform(-0.5, 0.5, (200, 3))


def fluence(light, points=POINTS):
    return sum(part.fluence(points) for part in light.emitters(LOW, HIGH)) * light.power[0]


def panel(z=1.0, half=0.3, **values):
    return Surface(rectangle(-half, half, -half / 3.0, half / 3.0, z).triangles, "panel", **{"emission": 2.0, **values})


def ball(centre, radius):
    """An octahedron, divided, on a sphere."""
    ends = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[ends[i], ends[1 + j], ends[2 + k]] for i in (0, 3) for j in (0, 3) for k in (0, 3)])
    for _ in range(4):
        a, b, c = faces.swapaxes(0, 1)
        u, v, w = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        faces = np.concatenate([np.stack(one, axis=1) for one in ((a, u, w), (u, b, v), (w, v, c), (u, v, w))])
    faces = faces / np.linalg.norm(faces, axis=2, keepdims=True)
    # Corners in order around each, seen from outside.
    turned = (np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]) * faces[:, 0]).sum(axis=1) < 0.0
    faces[turned] = faces[turned][:, ::-1]
    return Surface(radius * faces + centre, "ball", emission=2.0)


def area_light(z, sign=1.0, half=0.3):
    """The side of a panel that looks along -z, or z."""
    matrix = np.diag([1.0, sign, sign, 1.0])
    matrix[2, 3] = z
    return AreaLight(matrix, "rectangle", (2.0 * half, 2.0 / 3.0 * half), np.pi * 4.0 / 3.0 * half**2 * 2.0)


def test_a_panel_is_an_area_light():
    assert fluence(MeshLight(panel())) == pytest.approx(fluence(area_light(1.0)), rel=1e-4)


def test_a_panel_inside_shines_to_both_sides():
    above, below = (fluence(area_light(0.1, sign)) for sign in (1.0, -1.0))
    found = fluence(MeshLight(panel(0.1)))
    far = np.abs(POINTS[:, 2] - 0.1) > 0.1
    assert above[POINTS[:, 2] > 0.1].max() == 0.0
    assert found[far] == pytest.approx((above + below)[far], rel=0.05)


@pytest.mark.parametrize("centre, radius", [((1.0, 0.2, 0.3), 0.3), ((3.0, 0.2, 0.3), 0.05), ((0.0, 0.0, 0.0), 0.1)])
def test_a_ball_is_a_spherical_light(centre, radius):
    light = MeshLight(ball(np.array(centre), radius))
    assert light.closed and light.power[0] == pytest.approx(4.0 * np.pi**2 * radius**2 * 2.0, rel=0.01)
    far = np.linalg.norm(POINTS - centre, axis=1) > 2.0 * radius
    sphere = fluence(PointLight(centre, light.power, radius))
    assert fluence(light)[far] == pytest.approx(sphere[far], rel=0.15)
    assert fluence(light)[far].mean() == pytest.approx(sphere[far].mean(), rel=0.06)


def test_rounding_does_not_decide_how_a_ball_is_divided():
    surface = ball(np.zeros(3), 0.1)
    noise = np.random.default_rng(0).uniform(-1e-9, 1e-9, surface.triangles.shape)
    shaken = fluence(MeshLight(replace(surface, triangles=surface.triangles + noise)))
    assert shaken == pytest.approx(fluence(MeshLight(surface)), rel=1e-5)


def test_surfaces_that_surround_volumes_are_no_lamps():
    floor, small = (Surface(rectangle(-s, s, -s, s, -0.6).triangles, emission=1.0) for s in (9.0, 0.2))
    assert not mesh_lights([floor], CORNERS)
    assert [light.surface for light in mesh_lights([floor, small], CORNERS)] == [small]


@pytest.mark.slow
def test_the_picture_of_a_panel_is_that_of_an_area_light():
    view = Camera(np.eye(4), "orthographic", (12, 12), ortho_scale=1.1)
    view.world_matrix[2, 3] = 3.0
    volumes, settings = [(box(voxels=16), Medium(4.0, 0.9, 0.3))], Settings(depth_samples=4)
    by_mesh, by_lamp, linked = (
        render(volumes, lights, view, settings, surfaces=surfaces)
        for lights, surfaces in (
            ([], [panel(-0.8, covers=False)]),
            ([area_light(-0.8, -1.0)], []),
            ([], [panel(-0.8, covers=False, receivers=frozenset())]),
        )
    )
    assert by_mesh.report.counts["lamps"] == 1
    assert by_mesh.rgb == pytest.approx(by_lamp.rgb, rel=0.01)
    assert not linked.rgb.any()
    brighter = render(volumes, [], view, settings, surfaces=[replace(panel(-0.8, covers=False), emission=6.0)])
    assert brighter.rgb == pytest.approx(3.0 * by_mesh.rgb, rel=1e-4)


def ring(radius=1.0, thickness=0.05, segments=24, sides=6):
    """A torus in the XY plane around the origin."""
    around, across = (2.0 * np.pi * np.arange(count + 1) / count for count in (segments, sides))
    out = radius + thickness * np.cos(across)
    points = np.stack(
        [
            np.cos(around)[:, None] * out,
            np.sin(around)[:, None] * out,
            np.broadcast_to(thickness * np.sin(across), (segments + 1, sides + 1)),
        ],
        axis=2,
    )
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    triangles = np.concatenate([np.stack(one, axis=2).reshape(-1, 3, 3) for one in ((a, b, c), (a, c, d))])
    return Surface(triangles, "ring", emission=2.0)


def two_balls():
    """On both sides of the box, in one mesh."""
    halves = [ball(np.array([x, 0.0, 0.0]), 0.1).triangles for x in (-1.0, 1.0)]
    return Surface(np.concatenate(halves), "balls", emission=2.0)


def summed(surface, points=POINTS):
    """What all triangles of a closed surface give points, without those that face away."""
    triangles = surface.triangles
    vectors = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    away = points[:, None] - triangles.mean(axis=1)
    cosines = np.maximum((away * vectors).sum(axis=2), 0.0)
    return 2.0 * (cosines / np.linalg.norm(away, axis=2) ** 3).sum(axis=1)


@pytest.mark.parametrize("surface", [ring(), two_balls()], ids=["ring", "two balls"])
@pytest.mark.parametrize("most", [16, 6])
def test_a_mesh_around_volumes_does_not_shine_from_their_middle(surface, most):
    light, exact = MeshLight(surface), summed(surface)
    found = sum(part.fluence(POINTS) for part in light.emitters(LOW, HIGH, most)) * light.power[0]
    assert np.sqrt(((found - exact) ** 2).mean()) < 0.2 * exact.mean()
    assert found.mean() == pytest.approx(exact.mean(), rel=0.15)


def band(radius, height, segments=48):
    """A tube along Z around the origin, open at both ends."""
    around = 2.0 * np.pi * np.arange(segments + 1) / segments
    low = np.stack([radius * np.cos(around), radius * np.sin(around), np.full(segments + 1, -0.5 * height)], axis=1)
    high = low + (0.0, 0.0, height)
    a, b, c, d = low[:-1], low[1:], high[1:], high[:-1]
    return Surface(np.concatenate([np.stack(one, axis=1) for one in ((a, b, c), (a, c, d))]), "band", emission=2.0)


def test_a_band_around_volumes_shines_inwards():
    surface = band(1.2, 0.3)
    light, inwards = MeshLight(surface), replace(surface, triangles=surface.triangles[:, ::-1])
    assert not light.closed and light.power[0] == pytest.approx(4.0 * np.pi * light.area, rel=1e-6)
    found, exact = fluence(light), summed(inwards)
    assert np.sqrt(((found - exact) ** 2).mean()) < 0.2 * exact.mean()
    assert found.mean() == pytest.approx(exact.mean(), rel=0.1)


def bars(count=5):
    """Boxes behind each other, seen from the volumes."""
    corners = np.array(np.meshgrid((-0.1, 0.1), (-0.4, 0.4), (-0.4, 0.4), indexing="ij")).reshape(3, -1).T
    faces = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    one = corners[np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])]
    return Surface(np.concatenate([one + (3.0 + 0.4 * n, 0.0, 0.0) for n in range(count)]), "bars", emission=2.0)


@pytest.mark.parametrize("surface", [ring(), ball(np.zeros(3), 0.3), band(0.02, 2.0), bars()], ids=lambda one: one.name)
@pytest.mark.parametrize("turned", [1, -1])
def test_closed_meshes_and_thin_tubes_shine_outwards(surface, turned):
    light = MeshLight(replace(surface, triangles=surface.triangles[:, ::turned]))
    assert light.closed and light.power[0] == pytest.approx(2.0 * np.pi * light.area, rel=1e-6)


def seen_first(surface, places):
    """Fluence at places (N, 3) of a closed surface, by rays through a fine image each: the first triangle is seen."""
    triangles, found = surface.triangles, []
    middle = triangles.reshape(-1, 3).mean(axis=0)
    for place in places:
        forward = (middle - place) / np.linalg.norm(middle - place)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        grid = np.linspace(-0.6, 0.6, 96)
        x, y = np.meshgrid(grid, grid)
        rays = forward + x[..., None] * right + y[..., None] * np.cross(right, forward)
        hit = np.zeros(x.shape, bool)
        for a, b, c in triangles:
            # Moeller and Trumbore.
            u, v = b - a, c - a
            across = np.cross(rays, v)
            determinant = across @ u
            with np.errstate(all="ignore"):
                first = (across @ (place - a)) / determinant
                second = rays @ np.cross(place - a, u) / determinant
            hit |= (first >= 0.0) & (second >= 0.0) & (first + second <= 1.0)
        solid = (grid[1] - grid[0]) ** 2 / (1.0 + x**2 + y**2) ** 1.5
        found.append(2.0 * solid[hit].sum())
    return np.array(found)


def test_what_a_mesh_hides_of_itself_does_not_shine():
    places, surface = POINTS[::20], bars()
    expected, found = seen_first(surface, places), fluence(MeshLight(surface), places)
    assert found.mean() == pytest.approx(expected.mean(), rel=0.15)
    # Without what is hidden, the bars would shine more.
    assert summed(surface, places).mean() > 1.5 * expected.mean()


def test_slivers_change_nothing():
    """Divided into smaller triangles, a sliver has no area left."""
    sliver = [(0.0, 0.9, 1.0), (0.3, 0.9, 1.0), (0.1, np.nextafter(0.9, 1.0), 1.0)]
    found = MeshLight(replace(panel(), triangles=np.concatenate([panel().triangles, [sliver]])))
    np.testing.assert_allclose(fluence(found), fluence(MeshLight(panel())), rtol=1e-6)
