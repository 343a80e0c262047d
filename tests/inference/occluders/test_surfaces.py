# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces in front of and within volumes, against closed forms and brute-force ray intersection."""

import time

import numpy as np
import pytest

from inference import Camera, Medium, SceneError, Settings, Sun, Surface, render
from inference.occluders import rasterization
from inference.occluders.depth_buffer import (
    DISTANCES,
    SAMPLES,
    DepthBuffer,
    EndedRays,
    end_rays_at_surfaces,
    split_rays_at_surfaces,
)
from inference.occluders.shadow_map import ShadowMap
from inference.scene.camera_rays import camera_rays
from inference.scene.optimizations import ALL
from tests.support.surfaces import camera, fog, rectangle

SUN = Sun((0.4, 0.3, 0.8), 2.0)


def met(triangles, origins, directions):
    """Distances to the nearest triangle, ray by ray (Moeller and Trumbore)."""
    nearest = np.full(len(origins), np.inf)
    for a, b, c in triangles:
        along, up = b - a, c - a
        p = np.cross(directions, up)
        area = p @ along
        with np.errstate(all="ignore"):
            off = origins - a
            u = (off * p).sum(axis=1) / area
            q = np.cross(off, along)
            v = (directions * q).sum(axis=1) / area
            t = (q @ up) / area
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        nearest[hit] = np.minimum(nearest[hit], t[hit])
    return nearest


@pytest.mark.parametrize("clip", [0.0, 1.5])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_depths_equal_brute_force_intersection(projection, clip):
    """Triangles anywhere, also behind the camera and across its plane and the near clipping plane."""
    random = np.random.default_rng(2)
    triangles = random.normal(0.0, 3.0, (60, 1, 3)) + random.normal(0.0, 2.0, (60, 3, 3)) + [0, 0, -2.0]
    view = camera(projection, shift=(0.1, -0.05), pixel_aspect=1.4, ortho_scale=5.0, clip=(clip, np.inf))
    turn = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    view.world_matrix[:3, :3] = turn
    window = (2, 1, 11, 8)
    found = DepthBuffer([Surface(triangles[:20]), Surface(triangles[20:])], view).distances(window)

    fine = Camera(view.world_matrix, projection, (12 * SAMPLES, 8 * SAMPLES), view.fov, 5.0, view.shift)
    fine.clip, fine.pixel_aspect = view.clip, view.pixel_aspect
    origins, directions, near, _ = camera_rays(fine)
    expected = near + met(triangles, origins + near[:, None] * directions, directions)
    expected = expected.reshape(8, SAMPLES, 12, SAMPLES).transpose(0, 2, 1, 3)[1:8, 2:11].reshape(-1, SAMPLES**2)
    same = np.isclose(found, expected, rtol=1e-6)
    assert np.isfinite(expected).mean() > 0.3
    # A sample on an edge may fall on either side.
    assert same.mean() > 0.995


def test_thousands_of_small_surfaces_cost_little_more_than_one(monkeypatch):
    """And show the same triangles at the same distances, in batches that end within the small ones and at large ones.

    Taken one by one they cost 70 times as much.
    """
    random, view, window, towards = np.random.default_rng(5), camera(clip=(0.5, np.inf)), (0, 0, 12, 8), np.eye(3)[2]
    triangles = random.normal(0.0, 2.0, (9000, 1, 3)) + random.normal(0.0, 0.3, (9000, 3, 3)) - [0.0, 0.0, 2.0]
    ends = np.cumsum([0, *random.integers(0, 4, 4000), 2000])
    assert ends[-1] <= len(triangles)
    triangles = triangles[: ends[-1]]
    parts = [Surface(triangles[first:last]) for first, last in zip(ends, ends[1:])]

    def made(surfaces):
        begin = time.process_time()
        buffer = DepthBuffer(surfaces, view)
        shadows = ShadowMap([surface.triangles for surface in surfaces], towards, triangles[:20].reshape(-1, 3))
        return time.process_time() - begin, buffer.triangles(window), buffer.distances(window), shadows.heights

    least, *expected = made([Surface(triangles)])
    spent, *found = made(parts)
    assert spent < 10.0 * least
    monkeypatch.setattr(rasterization, "TRIANGLES_PER_BATCH", 700)
    for several in (found, made(parts)[1:]):
        for values, whole in zip(several, expected):
            np.testing.assert_array_equal(values, whole)
    assert np.unique(expected[0]).size > 50 and np.isfinite(expected[2]).any()


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_a_wall_hides_what_lies_behind_it(projection):
    view = camera(projection, resolution=(9, 9), fov=0.05, ortho_scale=0.1)
    wall = rectangle(-5, 5, -5, 5, 0.4)
    layer = render([(fog(), Medium(1.5, 0.0))], [SUN], view, surfaces=[wall])
    np.testing.assert_allclose(layer.alpha, 1.0 - np.exp(-1.5 * 0.6), rtol=2e-3)
    # A surface in front of the volume hides it, one behind it does not.
    hidden = render([(fog(), Medium(1.5, 0.5))], [SUN], view, surfaces=[rectangle(-5, 5, -5, 5, 1.5)])
    assert hidden.alpha.max() == hidden.rgb.max() == 0.0 and np.all(np.isinf(hidden.depth))
    alone, behind = (
        render([(fog(), Medium(1.5, 0.5, 0.3))], [SUN], view, surfaces=surfaces)
        for surfaces in ([], [rectangle(-5, 5, -5, 5, -1.5)])
    )
    for name in ("rgb", "alpha", "depth", "single", "multiple", "uncertainty"):
        np.testing.assert_allclose(getattr(behind, name), getattr(alone, name), rtol=1e-5, err_msg=name)


def test_an_edge_covers_its_share_of_a_pixel():
    """A wall over the left 0.3 of a pixel that faces homogeneous fog."""
    view = camera("orthographic", resolution=(4, 4), ortho_scale=0.4)
    walls = [rectangle(-1.0, 0.03, -1.0, 1.0, 1.5), rectangle(0.03, 1.0, -1.0, 1.0, 0.0)]
    whole, half = 1.0 - np.exp(-2.0), 1.0 - np.exp(-1.0)
    near = render([(fog(), Medium(1.0, 0.7))], [SUN], view, surfaces=walls[:1])
    assert np.all(near.alpha[:, :2] == 0.0)
    np.testing.assert_allclose(near.alpha[:, 2], 0.7 * whole, atol=0.5 / SAMPLES * whole)
    np.testing.assert_allclose(near.alpha[:, 3], whole, rtol=1e-3)
    both = render([(fog(), Medium(1.0, 0.7))], [SUN], view, surfaces=walls[1:])
    np.testing.assert_allclose(both.alpha[:, 2], 0.3 * whole + 0.7 * half, atol=0.5 / SAMPLES * (whole - half))
    np.testing.assert_allclose(both.alpha[:, 3], half, rtol=2e-3)
    # A partly covered pixel has that share of its radiance.
    share = near.alpha[0, 2] / near.alpha[0, 3]
    np.testing.assert_allclose(near.rgb[:, 2], share * near.rgb[:, 3], rtol=0.02)


@pytest.mark.slow
def test_the_image_does_not_depend_on_tiles_and_threads():
    wall = rectangle(-1.0, 0.03, -1.0, 0.2, 0.3)
    view, medium = camera(resolution=(16, 12)), Medium(2.0, 0.8, 0.5)
    one, two = (render([(fog(), medium)], [SUN], view, Settings(threads=n), surfaces=[wall]) for n in (1, 2))
    np.testing.assert_array_equal(one.rgb, two.rgb)
    part = Camera(view.world_matrix, view.projection, view.resolution, view.fov, region=(3, 2, 13, 9))
    settings = Settings(optimizations=ALL - {"shared_pixels"})
    whole, cut_out = (render([(fog(), medium)], [SUN], seen, settings, surfaces=[wall]).rgb for seen in (view, part))
    np.testing.assert_allclose(cut_out, whole[2:9, 3:13], rtol=1e-4, atol=1e-6)


def test_broken_vertices_are_refused_by_name():
    with pytest.raises(SceneError, match="wall: its vertices"):
        Surface(np.full((1, 3, 3), np.nan), "wall")


def test_a_surface_casts_its_shadow_into_the_volume():
    """Single scattering of a slab across the sun's light, half of which a distant wall blocks."""
    wall = rectangle(-9, 0.0, -9, 9, 6.0)
    sun = Sun((0.0, 0.0, 1.0), 3.0)
    matrix = np.array([[1, 0, 0, 0], [0, 0, -1, -6], [0, 1, 0, 0], [0, 0, 0, 1]], float)
    view = Camera(matrix, "orthographic", (40, 8), ortho_scale=1.6)
    settings = Settings(multiple=False)
    lit, shaded = (
        render([(fog(), Medium(0.7, 0.9, 0.3))], [sun], view, settings, surfaces=surfaces) for surfaces in ([], [wall])
    )
    assert shaded.single[:, :19].max() < 1e-6
    np.testing.assert_allclose(shaded.single[:, 21:], lit.single[:, 21:], rtol=1e-5)
    np.testing.assert_array_equal(shaded.alpha, lit.alpha)
    # Behind the volume it casts no shadow, nor does a surface with shades=False.
    for harmless in (rectangle(-9, 0, -9, 9, -6.0), Surface(wall.triangles, "wall", shades=False)):
        one = render([(fog(), Medium(0.7, 0.9, 0.3))], [sun], view, settings, surfaces=[harmless])
        np.testing.assert_allclose(one.single, lit.single, rtol=1e-6)


def test_an_oblique_shadow_falls_along_the_suns_direction():
    """The shadow's edge moves with height by the tangent of the sun's angle."""
    sun = Sun((1.0, 0.0, 2.0), 3.0)
    matrix = np.array([[1, 0, 0, 0], [0, 0, -1, -6], [0, 1, 0, 0], [0, 0, 0, 1]], float)
    view = Camera(matrix, "orthographic", (64, 64), ortho_scale=1.9)
    walls = [rectangle(-9, 2.0, -9, 9, 4.0)]
    lit, shaded = (
        render([(fog(), Medium(0.5, 0.9))], [sun], view, Settings(multiple=False), surfaces=surfaces)
        for surfaces in ([], walls)
    )
    share = (shaded.single / lit.single)[..., 0]
    x = ((np.arange(64) + 0.5) / 64 - 0.5) * 1.9
    # Seen from -y: x to the right, z up. Light along (-1, 0, -2) from the edge at (2, 4).
    edge = 2.0 - (4.0 - x[::-1][:, None]) / 2.0
    away = np.abs(x[None] - edge) > 0.05
    np.testing.assert_allclose(share[away], (x[None] > edge)[away], atol=1e-3)


def ball(centre, radius, parts):
    """A sphere of triangles that share their corners."""
    polar, around = np.linspace(0.0, np.pi, parts + 1), np.linspace(0.0, 2.0 * np.pi, 2 * parts + 1)
    polar[-1], around = np.pi, np.append(around[:-1], 0.0)
    corner = np.stack(
        [
            np.outer(np.sin(polar), np.cos(around)),
            np.outer(np.sin(polar), np.sin(around)),
            np.outer(np.cos(polar), np.ones_like(around)),
        ],
        axis=-1,
    )
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    return Surface(centre + radius * np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3, 3))


SEEN = {
    "a floor": [rectangle(-50, 50, -50, 50, -0.7)],
    "a ball": [ball(np.array([0.3, 0.1, -0.4]), 0.8, 24)],
    "a ball through a floor": [ball(np.array([0.0, 0.0, -0.6]), 0.5, 24), rectangle(-50, 50, -50, 50, -0.7)],
    "shards": [Surface(np.random.default_rng(4).normal(0.0, 0.7, (40, 3, 3)))],
    "dust": [Surface(np.random.default_rng(5).normal(0.0, 0.9, (400, 1, 3)) + 0.01 * np.eye(3))],
    "nothing in sight": [rectangle(50, 51, 50, 51, -0.7)],
    "no triangles": [Surface(np.zeros((0, 3, 3)))],
}


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("name", SEEN)
def test_rays_end_where_all_samples_of_their_pixels_say(name, projection):
    """Coverage is that of the samples, and ends differ by less than what they distinguish."""
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [0.0, -0.8, 0.6]]).T
    view = camera(projection, resolution=(90, 70), ortho_scale=3.0)
    view.world_matrix[:3, :3], view.world_matrix[:3, 3] = turn, turn @ [0.0, 0.0, 4.0]
    buffer = DepthBuffer(SEEN[name], view)
    rows, columns = np.divmod(np.arange(90 * 70), 90)
    random = np.random.default_rng(6)
    near = random.uniform(2.5, 3.5, len(rows))
    far = near + random.uniform(-0.3, 3.0, len(rows))
    expected = EndedRays(*split_rays_at_surfaces(near, far, buffer.distances((0, 0, 90, 70))))
    found = end_rays_at_surfaces(buffer, (columns, rows), (near, far))
    assert np.all(np.diff(found.pixel) >= 0) and np.all(near[found.pixel] < found.far)
    assert np.all(found.far <= far[found.pixel] * (1.0 + 1e-12))

    def sums(rays, values):
        return np.bincount(rays.pixel, values, len(near))

    length = np.maximum(far - near, 0.0)
    shares = [sums(rays, rays.share) for rays in (expected, found)]
    # Where a surface lies about where the interval begins, a pixel may be hidden by a part of it.
    begins = np.abs(shares[1] - shares[0]) > 1e-9
    lengths = [sums(rays, rays.share * (rays.far - near[rays.pixel])) for rays in (expected, found)]
    assert begins.mean() < 0.03
    assert np.abs(lengths[1] - lengths[0]).max() < np.max(length) / DISTANCES
    assert np.all(np.abs(lengths[1] - lengths[0]) <= length / DISTANCES + 1e-12)
    free = [sums(rays, rays.share * rays.free) for rays in (expected, found)]
    assert np.abs(free[1] - free[0])[~begins].max() < 1e-9
    if name in ("a floor", "a ball"):
        assert len(found.pixel) < len(expected.pixel)
    # A part of the image has the same rays.
    part = np.flatnonzero((rows > 20) & (rows < 50) & (columns > 13) & (columns < 60))
    again = end_rays_at_surfaces(buffer, (columns[part], rows[part]), (near[part], far[part]))
    there = np.isin(found.pixel, part)
    np.testing.assert_array_equal(part[again.pixel], found.pixel[there])
    np.testing.assert_allclose(again.far, found.far[there], rtol=1e-12)
