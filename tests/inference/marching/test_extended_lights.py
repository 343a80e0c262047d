# SPDX-License-Identifier: GPL-3.0-or-later
"""Single scattering of light from cones of directions."""

from dataclasses import replace

import numpy as np
import pytest

from inference import Medium, Settings, Sun, render
from inference.marching.extended_lights import ORDER, EquivalentDirections, ExtendedLights
from inference.scene.camera_rays import camera_rays
from inference.scene.phase_function import PhaseFunction, henyey_greenstein
from tests.support.surfaces import rectangle
from tests.support.volumes import box, camera, cloud

ONCE = Settings(multiple=False)


def sphere(count=15000):
    """Unit vectors (count, 3) evenly over the sphere (Fibonacci spiral)."""
    n = np.arange(count)
    z, turn = (2 * n + 1) / count - 1, n * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


def even_suns(radiance=1.0):
    """Uniform light as six suns, one for each face of a cube."""
    directions = sphere()
    face = np.abs(directions).argmax(axis=1)
    face = 2 * face + (directions[np.arange(len(face)), face] > 0.0)
    suns = []
    for number in range(6):
        inside = face == number
        share = inside.mean()
        suns.append(
            Sun(
                directions[inside].mean(axis=0),
                4 * np.pi * radiance * share,
                "sky",
                (directions[inside], np.full(inside.sum(), 1.0 / inside.sum())),
            )
        )
    return suns


@pytest.mark.parametrize("anisotropy", [*(pytest.param(g, marks=pytest.mark.slow) for g in (-0.5, 0.0, 0.5)), 0.857])
@pytest.mark.parametrize(
    "view",
    [
        camera(),
        camera(projection="orthographic", ortho_scale=1.6),
        camera(0.2, projection="equirectangular", resolution=(48, 24)),
    ],
)
def test_thin_media_in_uniform_light_have_the_lights_radiance(anisotropy, view):
    """Radiance is the light's times alpha, whatever the phase function, where nothing casts shadows."""
    layer = render([(box(), Medium(0.01, 1.0, anisotropy))], even_suns(0.7), view, ONCE)
    seen = layer.alpha > 1e-4
    assert seen.sum() > 20
    np.testing.assert_allclose(layer.single[seen, 1] / layer.alpha[seen], 0.7, rtol=0.02)


def test_an_extended_sun_equals_many_suns_within_its_cone():
    """In a medium too thin for shadows; a sun of no angular extent beside it is unaffected."""
    random = np.random.default_rng(2)
    towards = random.normal(size=(40, 3)) * 0.3 + [0.3, 0.2, -1.0]
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    shares = random.random(40)
    shares /= shares.sum()
    lamp = Sun((0.5, 0.1, 0.3), 2.0)
    volume, view = (cloud(), Medium(0.01, 1.0, 0.7)), camera()
    wide = render([volume], [lamp, Sun(shares @ towards, 3.0, spread=(towards, shares))], view, ONCE)
    many = render([volume], [lamp, *(Sun(one, 3.0 * share) for one, share in zip(towards, shares))], view, ONCE)
    seen = many.alpha > 1e-5
    np.testing.assert_allclose(wide.single[seen], many.single[seen], rtol=0.01)


@pytest.mark.slow
def test_means_interpolated_between_nodes_equal_those_at_pixels():
    view = camera(resolution=(90, 60), fov=0.9)
    phase = PhaseFunction(((0.6, "henyey_greenstein", (0.8,)), (0.4, "draine", (0.3, 1.0))))
    suns = even_suns()
    _, directions, _, _ = camera_rays(view)
    rows, columns = np.divmod(np.arange(len(directions)), 90)
    turned, ahead = ExtendedLights(view, suns, [phase]).phase(columns + 0.5, rows + 0.5)
    wanted = np.stack([phase(directions @ sun.spread[0].T) @ sun.spread[1] for sun in suns], axis=1)
    assert np.abs((turned + ahead)[:, 0] - wanted).max() < 0.01 * wanted.max()
    assert ahead.min() >= 0.0 and ahead.max() > 0.5 * wanted.max()
    # Where surfaces may be in the way, light from ahead is unknown.
    every, none = ExtendedLights(view, suns, [phase], split_forward=False).phase(columns + 0.5, rows + 0.5)
    assert not none.any()
    np.testing.assert_allclose(every, turned + ahead, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("anisotropy, most", [(0.5, 0.11), (0.857, 0.06), (0.95, 0.05)])
def test_light_from_behind_is_occluded_as_the_camera_ray_is(anisotropy, most):
    """A hemisphere as one sun, whose axis is not behind the cloud, against many small suns."""
    towards = sphere(700)
    towards = towards[towards @ [0.6, 0.0, -0.8] > 0.0]
    shares = np.full(len(towards), 1.0 / len(towards))
    volume, view = (cloud(), Medium(12.0, 1.0, anisotropy)), camera(resolution=(12, 8))
    many = render([volume], [Sun(one, share) for one, share in zip(towards, shares)], view, ONCE).single
    wide = render([volume], [Sun(shares @ towards, 1.0, spread=(towards, shares))], view, ONCE).single
    assert np.sqrt(((wide - many) ** 2).mean()) < most * many.max()


@pytest.mark.parametrize("anisotropy", [-0.9, 0.5, 0.857, 0.95])
def test_directions_are_turned_to_where_the_phase_function_equals_its_mean(anisotropy):
    """Within the plane of ray and sun. Point-like suns and isotropic scattering leave directions as they are."""
    view = camera(resolution=(70, 50), fov=1.2)
    sun, g = even_suns()[4], np.copysign(abs(anisotropy) ** ORDER, anisotropy)
    _, directions, _, _ = camera_rays(view)
    pixel = np.arange(len(directions))

    def equivalent(sun, anisotropy):
        row, column = np.divmod(pixel, view.resolution[0])
        return EquivalentDirections(view, sun, anisotropy)(directions, (column + 0.5, row + 0.5))

    found = equivalent(sun, anisotropy)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    mean = henyey_greenstein(directions @ sun.spread[0].T, g) @ sun.spread[1]
    assert np.abs(henyey_greenstein(found @ sun.direction, g) - mean).max() < 0.02 * mean.max()
    assert np.abs((found * np.cross(directions, sun.direction)).sum(axis=1)).max() < 1e-12
    point = Sun(sun.direction, 1.0, spread=(sun.direction[None], np.ones(1)))
    np.testing.assert_allclose(equivalent(point, anisotropy), directions, atol=0.03)
    assert equivalent(sun, 0.1) is directions


def test_a_wall_behind_the_volume_blocks_light_from_ahead():
    """All of it at pixels that the wall covers, half at those it covers half. The light's axis is not behind it."""
    towards = sphere(4000)
    towards = towards[towards @ [0.6, 0.0, -0.8] > 0.0]
    light = Sun(towards.mean(axis=0), 1.0, spread=(towards, np.full(len(towards), 1.0 / len(towards))))
    # The wall ends in the middle of column 19.
    view, wall = camera(projection="orthographic", ortho_scale=1.2), rectangle(-0.9, 0.375, -2.0, 2.0, -2.0)
    scene = [(cloud(), Medium(4.0, 1.0, 0.8))], [light], view, ONCE
    free, walled = (
        render(*scene).single[8, :, 0],
        render(*scene, surfaces=[replace(wall, shades=False)]).single[8, :, 0],
    )
    seen = np.flatnonzero(free)
    assert seen[0] < 5 and seen[-1] >= 20
    np.testing.assert_array_equal(walled[20:], free[20:])
    behind = seen[seen < 19]
    assert np.all(walled[behind] < 0.6 * free[behind])
    assert walled[19] == pytest.approx((walled[18] / free[18] + 1.0) / 2.0 * free[19], rel=0.03)


def test_regions_and_tiles_equal_the_whole_image():
    scene, view = [(cloud(), Medium(5.0, 0.9, 0.6))], camera(resolution=(60, 90))
    whole = render(scene, even_suns(), view, ONCE).rgb
    part = render(scene, even_suns(), replace(view, region=(10, 33, 51, 80)), ONCE).rgb
    np.testing.assert_array_equal(part, whole[33:80, 10:51])


def test_extended_suns_are_not_merged():
    suns = even_suns()[:1]
    layer = render([(cloud(), Medium(5.0, 0.9, 0.6))], [*suns, Sun(suns[0].direction, 1.0)], camera(), ONCE)
    assert not any("merged" in sentence for sentence in layer.report.left_out)
