# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedos that vary in space: laws that single and multiple scattering obey, for every kind of light and grid."""

import numpy as np
import pytest

from inference import Environment, Medium, PointLight, SceneError, Settings, Sun, Volume, render
from inference.grids.working_cube import fit_cube, mean_density
from inference.network.albedos import VaryingAlbedos
from inference.numerics.interpolation import halved_means
from inference.scene.optimizations import ALL
from inference.scene.sparse_grid import SparseGrid
from inference.source_terms.cell_sources import EnteringLight, SunBeam
from inference.transport.discrete_ordinates import DiscreteOrdinates
from inference.transport.mean_free_path import mean_free_path
from inference.transport.varying_albedo import CoarseAlbedo
from tests.support.volumes import SUN, camera, cloud
from training.tracer.density_grid import prepare
from training.tracer.light_paths import AlbedoField, Lights, LitMedium, trace_lights
from training.tracer.scene import Sampling

COLOUR = np.array([0.95, 0.6, 0.85], np.float32)
LIGHTS = {
    "sun": SUN,
    "soft sun": Sun(
        SUN.direction, 2.0, spread=(np.array([[0.4, 0.3, 0.8], [0.3, 0.4, 0.8]]) / np.sqrt(0.89), np.array([0.5, 0.5]))
    ),
    "lamp": PointLight(np.array([2.0, 1.0, 1.5]), 60.0),
    "lamp inside": PointLight(np.array([0.05, 0.1, 0.0]), 10.0),
    "environment": Environment(np.random.default_rng(3).random((16, 32, 3))),
}


def draw(albedo, light=SUN, volume=None, anisotropy=0.4, exact=True, **settings):
    """The layer of a cloud; exact: without what decides anew for each picture and medium, interpolation between pixels
    and larger cells.
    """
    left = ALL - {"shared_pixels", "level_of_detail"} if exact else ALL
    medium = Medium(12.0, albedo, anisotropy)
    return render([(volume or cloud(), medium)], [light], camera(), Settings(threads=1, optimizations=left, **settings))


def close(found, expected, tolerance):
    assert np.abs(found - expected).max() <= tolerance * expected.max()


def grid_of(colour, noise=0.0, seed=1):
    shape = cloud().density.shape
    values = np.broadcast_to(colour, (*shape, len(colour))) + noise * np.random.default_rng(seed).uniform(
        -1.0, 1.0, (*shape, len(colour))
    )
    return np.clip(values, 0.0, 1.0).astype(np.float32)


def halves(low, high):
    """Two albedos (nx, ny, nz) that meet in the middle."""
    shape = cloud().density.shape
    return np.where((np.arange(shape[0]) < shape[0] // 2)[:, None, None], low, high) * np.ones(shape, np.float32)


def test_a_grid_of_one_colour_is_that_colour():
    expected, found = draw(COLOUR, exact=False), draw(grid_of(COLOUR), exact=False)
    np.testing.assert_array_equal(found.rgb, expected.rgb)


@pytest.mark.slow
@pytest.mark.parametrize("light", LIGHTS)
def test_almost_one_colour_is_almost_that_colour(light):
    expected = draw(COLOUR, LIGHTS[light])
    found = draw(grid_of(COLOUR, 5e-5), LIGHTS[light])
    assert expected.multiple.max() > 0.0
    # The environments' network bends more between the uniform albedos that enclose the colour, and light paths correct
    # all that it predicts.
    close(found.single, expected.single, 2e-3 if light == "environment" else 1e-4)
    close(found.rgb, expected.rgb, 2e-3 if light == "environment" else 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("light", ["sun", "lamp", "environment"])
def test_channels_are_those_of_grey_albedos(light):
    greys = [halves(0.9, 0.3), halves(0.2, 0.8), halves(0.95, 0.6)]
    coloured = draw(np.stack(greys, axis=3), LIGHTS[light])
    for c, grey in enumerate(greys):
        alone = draw(grey, LIGHTS[light])
        close(coloured.single[..., c], alone.single[..., c], 1e-2 if light == "environment" else 1e-6)
        # Other uniform albedos enclose them.
        close(coloured.rgb[..., c], alone.rgb[..., c], 1e-2)


def test_single_scattering_is_linear_in_the_albedo():
    low, high = halves(1.0, 0.0), halves(0.0, 1.0)
    parts = [draw(albedo, multiple=False).single for albedo in (low, high)]
    whole = draw(1.0, multiple=False).single
    assert all(part.max() > 0.1 * whole.max() for part in parts)
    close(parts[0] + parts[1], whole, 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("anisotropy", [0.0, 0.8])
def test_radiance_does_not_grow_where_the_albedo_falls(light, anisotropy):
    random = np.random.default_rng(5)
    albedo = random.uniform(0.3, 1.0, cloud().density.shape).astype(np.float32)
    fallen = albedo.copy()
    fallen[:12] *= 0.7
    before, after = (draw(one, LIGHTS[light], anisotropy=anisotropy).rgb for one in (albedo, fallen))
    # Other uniform albedos enclose them, which shows in few pixels.
    growth = (after - before) / before.max()
    assert growth.max() <= 2.5e-2 and (growth > 2e-3).mean() < 0.03
    assert after.mean() < 0.95 * before.mean()


def test_sparse_albedos_are_dense_ones():
    dense = cloud()
    sparse = SparseGrid.of_dense(dense.density)
    albedo = [halves(0.9, 0.3), halves(0.2, 0.8), halves(0.95, 0.6)]
    volume = Volume(sparse, dense.world_from_index, "cloud")
    blocks = sparse.table > 0
    grids = []
    for values in albedo:
        padded = np.zeros(8 * np.array(sparse.table.shape), np.float32)
        padded[tuple(slice(a, a + n) for a, n in zip(sparse.first, values.shape))] = values
        rows = np.zeros_like(sparse.values)
        for place in np.argwhere(blocks):
            rows[sparse.table[tuple(place)]] = padded[tuple(slice(8 * a, 8 * a + 8) for a in place)]
        grids.append(sparse.with_values(rows))
    expected, found = draw(np.stack(albedo, axis=3)), draw(tuple(grids), volume=volume)
    # Dense grids are refined, and are marched in shorter steps.
    close(found.single, expected.single, 2e-2)
    close(found.rgb, expected.rgb, 2e-2)


def test_transport_of_one_albedo_is_that_of_a_grid_of_it():
    random = np.random.default_rng(2)
    density = random.random((32, 32, 32)).astype(np.float32)
    for anisotropy in (0.0, 0.8):
        one = DiscreteOrdinates(density, 30.0, anisotropy, albedo=0.9)
        grid = DiscreteOrdinates(density, 30.0, anisotropy, albedo=np.full_like(density, 0.9))
        sun = np.array([0.6, 0.0, 0.8])
        np.testing.assert_allclose(grid.solve(SunBeam(sun))[0], one.solve(SunBeam(sun))[0], rtol=1e-3)
        even = np.ones(26)
        np.testing.assert_allclose(grid.solve(EnteringLight(even))[0], one.solve(EnteringLight(even))[0], rtol=1e-3)


@pytest.mark.parametrize(
    "albedo, named",
    [
        (np.ones((3, 4, 5), np.float32), "voxels"),
        (np.full((24, 24, 24), 1.5, np.float32), r"\[0, 1\]"),
        (np.full((24, 24, 24), np.nan, np.float32), r"\[0, 1\]"),
        (np.ones((24, 24, 24, 2), np.float32), "one grid or three"),
    ],
)
def test_bad_grids_are_refused(albedo, named):
    with pytest.raises(SceneError, match=named):
        draw(albedo)


def test_overlapping_volumes_of_different_albedo_keep_their_colours():
    """Of two clouds side by side in one group, each is about as bright as the cloud of both that has its albedo."""
    whole, left, right = cloud(), cloud(), cloud()
    middle = whole.density.shape[0] // 2
    left.density = left.density.copy()
    right.density = right.density.copy()
    left.density[middle + 1 :], right.density[:middle] = 0.0, 0.0
    left.density[middle] *= 0.5
    right.density[middle] *= 0.5
    settings = Settings(threads=1, optimizations=ALL - {"shared_pixels"})
    volumes = [(left, Medium(12.0, 0.9, 0.4)), (right, Medium(12.0, 0.4, 0.4))]
    found = render(volumes, [SUN], camera(), settings).rgb
    albedo = halves(0.9, 0.4)
    albedo[middle] = 0.65
    expected = draw(albedo).rgb
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.05 * expected[expected > 0.0].mean()


@pytest.mark.slow
@pytest.mark.parametrize("light", ["sun", "lamp", "environment"])
def test_a_volume_per_colour_channel_is_the_chromatic_medium(light):
    """So an extinction whose colour varies is rendered: overlapping volumes of different channels do not mix."""
    exact = ALL - {"shared_pixels", "level_of_detail"}
    sigma_t, settings = np.array([16.0, 8.0, 4.0]), Settings(threads=1, optimizations=exact)
    whole = [(cloud(), Medium(sigma_t, COLOUR, 0.4))]
    parts = [(cloud(), Medium(sigma_t * channel, albedo, 0.4)) for channel, albedo in zip(np.eye(3), COLOUR)]
    expected, found = (render(volumes, [LIGHTS[light]], camera(), settings) for volumes in (whole, parts))
    close(found.rgb, expected.rgb, 1e-4)
    close(found.multiple, expected.multiple, 1e-4)
    close(found.alpha, expected.alpha, 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("anisotropy", [0.0, 0.857])
def test_the_albedo_that_light_has_met_is_that_of_traced_paths(anisotropy):
    """Light of uniform albedos, as paths tell it, becomes that of patches of two albedos."""
    n, sigma, suns, random = 48, 40.0, np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.2]]), np.random.default_rng(8)
    axis = (np.arange(n) + 0.5) / n - 0.5
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    density = np.clip(3.0 - 7.0 * np.sqrt(x**2 + y**2 + z**2), 0.0, 1.0).astype(np.float32)
    mask = np.clip(0.5 + np.sin(12.0 * x) * np.sin(12.0 * y) * np.sin(12.0 * z) / 0.3, 0.0, 1.0).astype(np.float32)
    frame = np.diag([1.0 / n] * 3 + [1.0])
    frame[:3, 3] = 0.5 / n - 0.5
    volume = Volume(density, frame, scattering=(density * (0.95 - 0.65 * mask),))
    cube = fit_cube(volume)
    coarse = CoarseAlbedo(volume, cube, halved_means(halved_means(mean_density(volume, cube))))
    points = random.uniform(-0.28, 0.28, (160, 3))
    omega = random.normal(size=(160, 3))
    omega /= np.linalg.norm(omega, axis=1, keepdims=True)
    low, high = (np.append(coarse.uniform, end).astype(np.float32) for end in (0.95, 0.3))
    lights = Lights(suns, (), np.zeros((0, 2, 4), np.float32), np.zeros((n, n, n, 0), np.float32))
    medium = LitMedium(sigma, anisotropy, AlbedoField(low, high, mask))
    traced, _ = trace_lights(prepare(density), lights, medium, (points, omega), Sampling(1024, 1))
    sigma_hat, errors = sigma * cube.edge, []
    for number, sun in enumerate(suns / np.linalg.norm(suns, axis=1, keepdims=True)):
        albedos = VaryingAlbedos(
            values=coarse.uniform.tolist(),
            enclosing=coarse.enclosing,
            light=coarse.light(lambda albedo: coarse.solver(sigma_hat, anisotropy, None, albedo), SunBeam(sun)),
            cube=cube,
            indices=[0],
            sigma_hat=sigma_hat,
            anisotropy=anisotropy,
            free_path=mean_free_path(coarse.density, sigma_hat),
        )
        ((_, found),) = albedos.by_channel(traced[:, number, :-1].T, points, omega)
        expected = traced[:, number, -1]
        errors.append([np.sqrt(((found - expected) ** 2).mean()), (found - expected).mean()] / expected.mean())
    error, bias = np.abs(errors).max(axis=0)
    assert error < 0.3
    assert bias < 0.05
