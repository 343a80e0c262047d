# SPDX-License-Identifier: GPL-3.0-or-later
"""Opaque surfaces in multiple scattering: energy conservation, closed forms, and what must not change."""

import numpy as np
import pytest

import training.rpnn  # noqa: F401  Lets settings name it.
from inference import Medium, PointLight, RenderCache, Settings, Sun, Surface, render
from inference.occluders.cell_boundaries import CellBoundaries
from inference.occluders.lamp_shadow_map import BLOCK, LampShadowMap
from inference.occluders.shadow_map import ShadowMap
from inference.transport.diffusion import couple, solve
from tests.support.surfaces import camera, fog, rectangle

CELLS = 24


def ball(radius, cells=40):
    """Triangles of a ball around the origin."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 2 * cells + 1), np.linspace(0, np.pi, cells + 1), indexing="ij")
    corners = radius * np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1)
    a, b, c, d = corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]
    return np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)


def spread():
    return 1.0 / (2.0 + np.random.default_rng(4).uniform(0.0, 60.0, (CELLS,) * 3))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_wall_bounds_diffusion_as_a_face_of_the_cube_does(axis):
    """A wall midway between two layers of cells."""
    corners = np.array([[-0.6, -0.6], [0.6, -0.6], [0.6, 0.6], [-0.6, 0.6]])
    square = np.insert(corners, axis, 0.0, axis=1)
    walls = CellBoundaries([square[[0, 1, 2]], square[[0, 2, 3]]], CELLS)
    assert not walls.inside.any()
    d, source = np.moveaxis(spread(), 0, axis), np.random.default_rng(5).random((CELLS,) * 3)
    below = tuple(slice(CELLS // 2) if a == axis else slice(None) for a in range(3))
    source[tuple(slice(CELLS // 2, None) if a == axis else slice(None) for a in range(3))] = 0.0
    found = solve(couple(d, 1.0 / CELLS, walls), source)
    expected = solve(couple(d[below], 1.0 / CELLS), source[below])
    # Boundaries are sought slightly off the cells' centres.
    np.testing.assert_allclose(found[below], expected, rtol=0.01)
    assert found.sum() == pytest.approx(found[below].sum(), rel=1e-12)


def test_cell_boundaries_match_a_balls_surface_and_volume():
    radius = 0.37
    walls = CellBoundaries(ball(radius), CELLS)
    centre = (np.arange(CELLS) + 0.5) / CELLS - 0.5
    distance = np.sqrt(sum(x**2 for x in np.meshgrid(centre, centre, centre, indexing="ij")))
    clear = np.abs(distance - radius) > 0.3 / CELLS
    np.testing.assert_array_equal(walls.inside[clear], (distance < radius)[clear])
    assert walls.facing.sum() / CELLS**2 == pytest.approx(4.0 * np.pi * radius**2, rel=0.03)
    # An open bowl has no inside.
    assert not CellBoundaries(ball(radius)[ball(radius)[..., 2].max(axis=1) < 1e-9], CELLS).inside.any()


def test_all_light_leaves_through_faces_and_walls():
    d, walls = spread(), CellBoundaries(ball(0.3), CELLS)
    source = np.where(walls.inside, 0.0, 1.0)
    diagonal, couplings = couple(d, 1.0 / CELLS, walls)
    fluence = solve((diagonal, couplings), source)
    assert np.all(fluence[walls.inside] == 0.0) and np.all(fluence[~walls.inside] > 0.0)
    inner = sum(couplings[a] + np.roll(couplings[a], 1, a) for a in range(3))
    assert ((diagonal - inner) * fluence).sum() == pytest.approx(source.sum(), rel=5e-3)
    free = solve(couple(d, 1.0 / CELLS), source)
    assert np.all(fluence <= free * 1.01) and fluence.sum() < 0.8 * free.sum()
    # Inside the ball, lookups read the nearest cells outside.
    assert walls.extrapolate_inside(np.log(fluence + 1e-6))[walls.inside].max() > -8.0


def test_the_lit_fraction_of_cells_is_what_a_wall_leaves():
    """Light straight down past a wall at x < 0.1."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    shadow_map = ShadowMap([rectangle(-9, 0.1, -9, 9, 3.0).triangles], np.array([0.0, 0.0, 1.0]), corners)
    share = shadow_map.cell_visibility(8, parts=16)
    expected = np.clip((np.arange(1, 9) / 8 - 0.5 - 0.1) * 8, 0.0, 1.0)
    np.testing.assert_allclose(share, np.broadcast_to(expected[:, None, None], share.shape), atol=0.04)
    np.testing.assert_allclose(
        shadow_map.cell_visibility(8, 1)[1:-1, 1:-1, 1:-1], shadow_map.cell_visibility(8), atol=1e-6
    )


@pytest.mark.parametrize("direction", [(0.6, 0.5, 0.62), (0.0, 0.0, 1.0), (0.1, -0.9, 0.1)])
def test_the_lit_fraction_of_cells_is_the_mean_of_samples(direction):
    """Most cells are not sampled, since all heights around them tell the same."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    direction = np.array(direction) / np.linalg.norm(direction)
    plates = [rectangle(-0.2, 0.15, -0.1, 0.2, height).triangles for height in (-0.1, 0.2)]
    shadow_map = ShadowMap(plates, direction, corners)
    cells, parts = 16, 3
    along = (np.arange(cells * parts) + 0.5) / (cells * parts) - 0.5
    points = np.stack(np.meshgrid(along, along, along, indexing="ij")).reshape(3, -1)
    index = shadow_map.linear @ points + shadow_map.offset[:, None]
    sampled = shadow_map.visibility(index.astype(np.float32)).reshape([cells, parts] * 3).mean(axis=(1, 3, 5))
    assert 0.0 < sampled.mean() < 1.0 and np.any((sampled > 0.1) & (sampled < 0.9))
    np.testing.assert_allclose(shadow_map.cell_visibility(cells, parts=parts), sampled, atol=1e-4)


@pytest.mark.parametrize("model", ["mrpnn", "mrpnn-paper"])
def test_no_light_no_scattering(model):
    """In the shadow of a wall there is no scattering of any order."""
    settings, medium, view = Settings(model=model), Medium(4.0, 0.9, 0.4), camera()
    wall = Surface(rectangle(-9, 9, -9, 9, 6.0).triangles, covers=False)
    lit, dark = (render([(fog(), medium)], [SUN], view, settings, surfaces=surfaces) for surfaces in ([], [wall]))
    assert dark.single.max() == 0.0 and np.all(dark.alpha == lit.alpha)
    if model == "mrpnn":
        assert dark.multiple.max() < 2e-3 * lit.multiple.mean()
    else:
        # It knows the light at the stencil only.
        assert dark.multiple.mean() < 0.5 * lit.multiple.mean()


SUN = Sun((0.2, 0.1, 1.0), 2.0)


@pytest.mark.parametrize("light", [Sun((0.6, 0.0, -0.8), 1.0), PointLight((6.0, 0.0, -9.5), 1.0)], ids=["sun", "lamp"])
def test_edges_of_shadows_lie_where_they_fall_and_not_at_steps(light):
    """Thin fog lit from below past a wall, seen from above: the part of each ray that is lit, by fine sums."""
    volume, wall = fog(), rectangle(-9, 0, -9, 9, -1.5)
    medium, view = Medium(1e-3, 0.9, 0.0), camera("orthographic", (90, 2), ortho_scale=1.8)
    settings = Settings(multiple=False)
    lit, free = (
        render([(volume, medium)], [light], view, settings, surfaces=surfaces).rgb[0, :, 0] for surfaces in ([wall], [])
    )
    x, z = (np.arange(90)[:, None] + 0.5) / 50.0 - 0.9, (np.arange(20_000) + 0.5) / 20_000 * 2.2 - 1.1
    density = np.clip((1.0625 - np.abs(z)) / 0.125, 0.0, 1.0)
    if isinstance(light, Sun):
        shown, across = density, x + (z + 1.5) * 0.75
    else:
        beam = light.position[:, None, None] - np.stack(np.broadcast_arrays(x, 0.0, z))
        shown, across = density / (beam**2).sum(axis=0), x - (z + 1.5) * beam[0] / beam[2]
    expected = (shown * (across > 0.0)).sum(axis=1) / (shown + 0.0 * across).sum(axis=1)
    assert 0.1 < expected.min() < expected.max() < 1.0 + 1e-9
    # A step is longer than 0.005 of the ray.
    np.testing.assert_allclose(lit / free, expected, atol=0.0015)


def test_surfaces_that_block_no_light_change_nothing():
    medium, view = Medium(4.0, 0.9, 0.4), camera()
    alone = render([(fog(), medium)], [SUN], view)
    behind = Surface(rectangle(-9, 9, -9, 9, -1.5).triangles, covers=False)
    unseen = Surface(rectangle(-1, 1, -1, 1, 0.3).triangles, covers=False, shades=False, stops=False)
    for surfaces in ([behind], [unseen], [behind, unseen]):
        np.testing.assert_array_equal(render([(fog(), medium)], [SUN], view, surfaces=surfaces).rgb, alone.rgb)


def test_a_surface_that_absorbs_scattered_light_darkens_its_surroundings():
    medium, view = Medium(4.0, 0.95, 0.4), camera(resolution=(24, 16))
    hole = Surface(ball(0.5), covers=False, shades=False)
    alone, stopped = (render([(fog(), medium)], [SUN], view, surfaces=surfaces) for surfaces in ([], [hole]))
    np.testing.assert_array_equal(stopped.single, alone.single)
    assert 0.3 * alone.multiple.mean() < stopped.multiple.mean() < 0.97 * alone.multiple.mean()


@pytest.mark.slow
def test_the_render_cache_follows_surfaces_and_suns():
    medium, view, cache = Medium(4.0, 0.9, 0.4), camera(), RenderCache()
    first, second = ([Surface(rectangle(-9, edge, -9, 9, 6.0).triangles, covers=False)] for edge in (0.4, 0.9))
    other = Sun((-0.5, 0.1, 1.0), 2.0)
    for surfaces, sun in ((first, SUN), (second, SUN), (second, other), ([], other), (first, SUN)):
        found = render([(fog(), medium)], [sun], view, cache=cache, surfaces=surfaces)
        anew = render([(fog(), medium)], [sun], view, cache=RenderCache(), surfaces=surfaces)
        np.testing.assert_array_equal(found.rgb, anew.rgb)


@pytest.mark.slow
def test_a_network_without_light_inputs_warns_of_surfaces():
    wall = Surface(rectangle(-9, 0, -9, 9, 6.0).triangles)
    layer = render(
        [(fog(), Medium(4.0, 0.9, 0.4))], [SUN], camera(resolution=(4, 4)), Settings(model="rpnn"), surfaces=[wall]
    )
    assert "fog: the network rpnn does not account for surfaces" in layer.report.warnings


@pytest.mark.slow
def test_suns_below_a_ground_are_skipped():
    ground, settings = rectangle(-9, 9, -9, 9, -2.0), Settings(2)
    pair = [(fog(), Medium(2.0, 0.9, 0.6))]
    above, below = Sun((0.3, 0.2, 0.9), 2.0), [Sun((0.1, 0.5, -0.8), 5.0), Sun((-0.6, 0.0, -0.7), 1.0)]
    alone = render(pair, [above], camera(), settings, surfaces=[ground])
    found = render(pair, [below[0], above, below[1]], camera(), settings, surfaces=[ground])
    assert any("2 suns" in reason for reason in found.report.left_out)
    np.testing.assert_array_equal(found.rgb, alone.rgb)
    assert found.report.counts["network points"] == alone.report.counts["network points"]
    # A ground that does not extend below the volume lets light through.
    half = rectangle(-9, 0, -9, 9, -2.0)
    lit = render(pair, [above, *below], camera(), settings, surfaces=[half])
    assert not any("suns" in reason for reason in lit.report.left_out)
    # Without light there is only alpha.
    dark = render(pair, below, camera(), settings, surfaces=[ground])
    assert dark.alpha.max() > 0.1 and dark.rgb.max() < 1e-3 * alone.rgb.max()


@pytest.mark.parametrize("cells", [12, 32, 40])
def test_squares_of_a_lamps_shadow_map_hold_what_filtering_reads(cells):
    """So that a point nearer than all of a square is lit, and one farther than all of it is not."""
    shadow_map = LampShadowMap([rectangle(-0.7, 0.3, -0.4, 0.9, -1.0)], np.zeros(3), cells)
    assert np.isinf(shadow_map.distances).any() and np.isfinite(shadow_map.distances).any()
    low, high = np.moveaxis(shadow_map.extremes, -1, 0)
    for face, row, column in np.ndindex(6, cells, cells):
        read = shadow_map.distances[face, row : row + 2, column : column + 2]
        square = face, row // BLOCK, column // BLOCK
        assert low[square] <= read.min() and high[square] >= read.max()
    assert low.min() == shadow_map.distances.min() and high.max() == shadow_map.distances.max()
