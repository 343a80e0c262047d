# SPDX-License-Identifier: GPL-3.0-or-later
"""Light from everywhere: what it is made of, how it enters, and the laws that pictures lit by it obey."""

import math

import numpy as np
import pytest

from inference import (
    Camera,
    Environment,
    Medium,
    RenderCache,
    SceneError,
    Settings,
    Sun,
    Volume,
    available_models,
    render,
)
from inference.environments.blurred_environment import blurred
from inference.environments.environment_light import (
    ALBEDOS,
    DIRECTION_WEIGHTS,
    DIRECTIONS,
    ROWS,
    direction_radiance,
    image_in_frame,
    ordinate_radiance,
)
from inference.environments.open_depths import OpenDepths, direction_depths
from inference.models.abilities import abilities
from inference.models.weights_file import WEIGHTS
from inference.network import environment_features as features
from inference.network.baselines import register_baselines
from inference.network.environment_network import FOLDER, load_environment_network
from inference.network.network import load_network
from inference.network.predictor import VolumePredictor
from inference.plan.plan import make_plan
from inference.scene.environment import pixel_directions, pixel_solid_angles
from inference.scene.phase_function import henyey_greenstein
from inference.source_terms.cell_sources import EnteringLight
from inference.transport.discrete_ordinates import CELLS, DiscreteOrdinates
from inference.transport.ordinates import ORDINATE_WEIGHTS


def sky(rows=16, seed=0):
    """A smooth coloured sky, (rows, 2 rows, 3)."""
    random = np.random.default_rng(seed)
    directions = pixel_directions(rows)
    light = np.ones((rows, 2 * rows, 3))
    for c in range(3):
        light[..., c] += 0.8 * directions @ _unit(random) + 0.5 * np.exp(4.0 * (directions @ _unit(random) - 1.0))
    return light.astype(np.float32)


def _unit(random):
    vector = random.normal(size=3)
    return vector / np.linalg.norm(vector)


def blob(cells=32):
    """A lumpy ball of density up to 1, in a cube of edge 2 around the origin."""
    axis = (np.arange(cells) + 0.5) / cells * 2.0 - 1.0
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    density = np.clip(1.6 - 2.0 * np.sqrt(x**2 + y**2 + z**2) + 0.4 * np.sin(6 * x) * np.cos(5 * y), 0.0, 1.0)
    matrix = np.diag([2.0 / cells] * 3 + [1.0])
    matrix[:3, 3] = 1.0 / cells - 1.0
    return Volume(density.astype(np.float32), matrix, "blob")


#: Shared by all pictures, whose volume is the same.
BLOB, CACHE = blob(), RenderCache()


def camera(size=24):
    matrix = np.eye(4)
    matrix[2, 3] = 5.0
    return Camera(matrix, resolution=(size, size), fov=0.45)


def picture(lights, sigma=15.0, albedo=1.0, anisotropy=0.5, **options):
    medium = Medium(sigma, albedo, anisotropy)
    settings = Settings(**{"depth_samples": 4, **options})
    return render([(BLOB, medium)], lights, camera(), settings, cache=CACHE)


@pytest.mark.parametrize(
    "radiance, matrix, problem",
    [
        (np.ones((4, 4, 3)), None, "image"),
        (np.ones((4, 8)), None, "image"),
        (np.full((2, 4, 3), np.nan), None, "NaN"),
        (np.full((2, 4, 3), -1.0), None, "negative"),
        (np.ones((2, 4, 3)), np.eye(4), "3x3"),
        (np.ones((2, 4, 3)), 2.0 * np.eye(3), "orthonormal"),
    ],
)
def test_bad_input_is_refused_by_name(radiance, matrix, problem):
    with pytest.raises(SceneError, match=f"dome.*{problem}"):
        Environment(radiance, matrix, "dome")


def test_pixels_follow_the_convention():
    directions, rows = pixel_directions(4), 4
    for r, c in ((0, 0), (3, 5)):
        a, e = 2 * math.pi * (c + 0.5) / 8, math.pi * (0.5 - (r + 0.5) / 4)
        wanted = math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e)
        np.testing.assert_allclose(directions[r, c], wanted, atol=1e-12)
    assert pixel_solid_angles(rows).sum() * 2 * rows == pytest.approx(4 * math.pi)
    # A quarter turn about z carries the light of +x to +y.
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    radiance = np.clip(pixel_directions(64) @ [1.0, 0.0, 0.0], 0.0, None)[..., None] * np.ones(3)
    found = image_in_frame([Environment(radiance, turn)], np.eye(3))
    brightest = pixel_directions(ROWS).reshape(-1, 3)[found.reshape(-1).argmax()]
    assert brightest @ [0.0, 1.0, 0.0] > 0.95


@pytest.mark.parametrize("rows", [1, 16, 48, 500])
def test_turning_keeps_energy_and_even_light(rows):
    rotation = np.linalg.qr(np.random.default_rng(rows).normal(size=(3, 3)))[0]
    even = image_in_frame([Environment(np.full((rows, 2 * rows, 3), 0.7))], rotation)
    np.testing.assert_allclose(even, 0.7, rtol=1e-6)
    environment = Environment(sky(rows))
    found = (image_in_frame([environment], rotation) * pixel_solid_angles(ROWS)[..., None]).sum(axis=(0, 1))
    np.testing.assert_allclose(found, environment.fluence(), rtol=0.01)


def test_peaks_become_suns_and_no_light_is_lost():
    light = sky(64)
    light[10, 20] += 400.0
    light[40, 100] += 300.0
    environment = Environment(light, name="studio")
    rest, suns = environment.without_peaks()
    assert len(suns) == 2 and all(sun.name == "sun of studio" for sun in suns)
    assert suns[0].direction @ pixel_directions(64)[40, 100] > 0.999
    total = rest.fluence() + sum(sun.irradiance for sun in suns)
    np.testing.assert_allclose(total, environment.fluence(), rtol=1e-5)
    smooth = Environment(sky(64))
    assert smooth.without_peaks() == (smooth, [])


def test_blurring_is_convolution_with_the_phase_function():
    image, directions = sky(32).astype(np.float64), pixel_directions(32)
    found = blurred(image, [0.7, 0.0, -0.5])
    for r, c in ((5, 9), (16, 40), (30, 2)):
        for b, g in enumerate((0.7, 0.0, -0.5)):
            phase = henyey_greenstein(directions @ directions[r, c], g) * pixel_solid_angles(32)
            wanted = (phase[..., None] * image).sum(axis=(0, 1)) / phase.sum()
            np.testing.assert_allclose(found[r, c, b], wanted, rtol=0.01)


def test_coarse_transport_is_linear_and_keeps_even_light():
    density = blob(CELLS).density
    radiance = ordinate_radiance(sky().astype(np.float64))
    np.testing.assert_allclose(ORDINATE_WEIGHTS @ radiance, Environment(sky()).fluence() / (4 * math.pi), rtol=1e-6)
    solver = DiscreteOrdinates(density, 80.0, 0.857)
    even = solver.solve(EnteringLight(np.ones(26)))
    np.testing.assert_allclose(even[0], 4 * math.pi, rtol=1e-5)
    np.testing.assert_allclose(even[1:], 0.0, atol=1e-4)
    first, second = (solver.solve(EnteringLight(one)) for one in radiance.T[:2])
    both = solver.solve(EnteringLight(radiance[:, 0] + 2.0 * radiance[:, 1]))
    # The iterations may end one sweep apart.
    np.testing.assert_allclose(both, first + 2.0 * second, atol=0.02 * both[0].mean())


def test_directions_integrate_polynomials():
    """Lebedev's rule of 50 points is exact to degree 11; what arrives from them has all the light."""
    assert DIRECTION_WEIGHTS.sum() == pytest.approx(1.0) and DIRECTIONS.shape == (50, 3)
    np.testing.assert_allclose(np.linalg.norm(DIRECTIONS, axis=1), 1.0)
    axis = _unit(np.random.default_rng(3))
    for degree in range(12):
        wanted = 0.0 if degree % 2 else 1.0 / (degree + 1.0)
        assert DIRECTION_WEIGHTS @ (DIRECTIONS @ axis) ** degree == pytest.approx(wanted, abs=1e-12)
    radiance = direction_radiance(sky().astype(np.float64))
    np.testing.assert_allclose(DIRECTION_WEIGHTS @ radiance, Environment(sky()).fluence() / (4 * math.pi), rtol=1e-6)


def test_depths_of_what_is_open_are_sharp_near_faces():
    """In a slab, points a fraction of a coarse cell below its face know how far it is."""
    levels = [np.zeros((n, n, n), np.float32) for n in (256, 128, 64)]
    for level in levels:
        level[:, :, : len(level) // 2] = 1.0
    random = np.random.default_rng(4)
    positions = random.uniform(-0.1, 0.1, (200, 3))
    positions[:, 2] = -random.uniform(0.0, 0.03, 200)
    found = OpenDepths(levels[:2], direction_depths(levels[2]))(positions)
    up = DIRECTIONS[:, 2] > 0.5
    wanted = -positions[:, 2, None] / DIRECTIONS[up, 2]
    # Samples stand for up to 5 cells of level 0, those near the point for fewer.
    error = np.abs(found[:, up] - wanted)
    assert error.max() < 2.5 / 256 / 0.5 and error[positions[:, 2] > -0.01].mean() < 0.5 / 256
    # Downwards it is far, sideways farther still.
    down = DIRECTIONS[:, 2] < -0.9
    np.testing.assert_allclose(found[:, down], (positions[:, 2, None] + 0.5) / -DIRECTIONS[down, 2], rtol=0.02)


@pytest.mark.parametrize("anisotropy", [0.0, 0.857])
@pytest.mark.parametrize("albedo", [0.8, 0.98])
def test_coarse_transport_in_absorbing_media(albedo, anisotropy):
    """Converged, even light in the middle of an absorbing medium decays as diffusion theory says."""
    n, sigma = 32, 40.0
    solver = DiscreteOrdinates(np.ones((n, n, n), np.float32), sigma, anisotropy, albedo=albedo)
    fluence, *flux = solver.solve(EnteringLight(np.full(26, 1.0 / (4.0 * math.pi))))
    assert -1e-3 < fluence.min() and fluence.max() < 1.0
    # Absorbed light is what enters: the divergence of the flux.
    inside = slice(8, 24)
    loss = sum(np.gradient(part, 1.0 / n, axis=axis) for axis, part in enumerate(flux))[inside, inside, inside]
    absorbed = -sigma * (1.0 - albedo) * fluence[inside, inside, inside]
    assert np.abs(loss - absorbed).mean() < 0.1 * np.abs(absorbed).mean() + 0.02
    thinner = DiscreteOrdinates(np.ones((n, n, n), np.float32), sigma, anisotropy, albedo=0.5 + 0.5 * albedo)
    assert np.all(thinner.solve(EnteringLight(np.full(26, 1.0 / (4.0 * math.pi))))[0] >= fluence - 1e-3)


def test_every_candidate_is_the_radiance_of_even_light():
    random = np.random.default_rng(1)
    count = 50
    omega = random.normal(size=(count, 3))
    omega /= np.linalg.norm(omega, axis=1, keepdims=True)
    depths = random.random((count, 50)).astype(np.float32) * np.geomspace(1e-3, 1e4, count)[:, None].astype(np.float32)
    opened = features.OpenMeans(depths, features.lobe_weights(omega), 1.0)
    light = np.zeros((count, features.PROBES, 4, 2), np.float32)
    light[:, :, 0] = [3.0, 5.0]
    ahead = np.broadcast_to(np.float32([3.0, 5.0]), (count, len(features.blurs(0.5)), 2))
    # Light in absorbing media, next to none in some, and a little less than none by the solution's error.
    absorbed = np.zeros((count, features.PROBES, len(ALBEDOS), 4, 3), np.float32)
    left = np.geomspace(1.0, 1e-6, count) - 1e-4
    absorbed[:, :, :, 0] = left[:, None, None, None] * np.float32([3.0, 5.0, 1.0])
    absorbed[:, :, :, 1:] = 0.3 * absorbed[:, :, :, :1]
    seldom, even = features.seldom_scattered(light, absorbed, omega)
    assert seldom.shape[:2] == even.shape == (count, len(ALBEDOS) * len(features.SELDOM))
    found = features.candidates(ahead, opened.radiance(np.tile([3.0, 5.0], (50, 1))), light, seldom, omega, 0.5)
    assert found.shape == (count, features.CANDIDATES, 2)
    np.testing.assert_allclose(found, np.broadcast_to([3.0, 5.0], found.shape), rtol=1e-4)
    inputs = features.inputs(np.zeros((count, 40), np.float32), np.zeros((count, 2)), opened, even, omega, 10.0, 0.5)
    assert inputs.shape == (count, features.COLUMNS) and np.isfinite(inputs).all()


@pytest.mark.parametrize("albedo, anisotropy", [(1.0, 0.857), (0.7, 0.0)])
def test_even_light_is_that_of_a_nearly_even_world(albedo, anisotropy):
    # Of even light the transport is not solved. A speck makes it uneven, which takes the long way.
    radiance = np.tile(np.float32([0.2, 0.5, 1.0]), (16, 32, 1))
    even, speck = Environment(radiance), Environment(radiance * (1.0 + 1e-5 * (np.arange(32)[None, :, None] == 7)))
    assert even.even and not speck.even
    found, expected = (picture([light], 60.0, albedo, anisotropy).rgb for light in (even, speck))
    assert np.sqrt(np.mean((found - expected) ** 2)) < 5e-4 * expected.mean() and expected.mean() > 0.05


def test_every_network_for_environments_stands_beside_one_for_suns():
    beside = {path.stem for path in (WEIGHTS / FOLDER).glob("*.onnx")}
    assert beside == {name for name in available_models() if abilities(name).every_light} == {"mrpnn"}
    network = load_environment_network("mrpnn")
    random = np.random.default_rng(2)
    x = random.normal(size=(30, features.COLUMNS)).astype(np.float32)
    found = network.run(x, np.full((30, features.CANDIDATES, 3), 2.0, np.float32), np.array([1.0]))
    np.testing.assert_allclose(found.sum(axis=1), 2.0, rtol=1e-4)


@pytest.mark.parametrize("anisotropy", [-0.2, 0.0, 0.857])
@pytest.mark.parametrize("sigma", [0.5, 30.0, 600.0])
def test_white_furnace(anisotropy, sigma):
    """Even light of radiance L, scattered without loss, cannot be told from no volume at all."""
    layer = picture([Environment(np.full((1, 2, 3), 0.4))], sigma, 1.0, anisotropy)
    seen = layer.rgb + (1.0 - layer.alpha[..., None]) * 0.4
    np.testing.assert_allclose(seen, 0.4, rtol=0.005)
    assert layer.alpha.max() > 0.3 and layer.report.counts["environments"] == 1


@pytest.mark.slow
def test_pictures_are_linear_additive_and_continuous():
    first, second = sky(seed=1), sky(seed=2)
    a, b = (picture([Environment(light)]).rgb for light in (first, second))
    np.testing.assert_allclose(picture([Environment(3.0 * first)]).rgb, 3.0 * a, rtol=1e-3, atol=1e-5)
    together = picture([Environment(first), Environment(second)]).rgb
    assert np.abs(together - a - b).mean() < 0.003 * together.mean()
    np.testing.assert_allclose(picture([Environment(first + second)]).rgb, together, rtol=1e-4, atol=1e-5)
    # Also around even light, whose flux vanishes everywhere.
    even = np.ones_like(first)
    still = picture([Environment(even)]).rgb
    for size in (1e-4, 1e-2):
        changed = picture([Environment(even + size * first)]).rgb
        assert np.abs(changed - still).max() < 4.0 * size * first.max()


def test_colours_do_not_mix_and_the_environment_is_not_in_the_layer():
    light = sky()
    coloured = picture([Environment(light)])
    for c in range(3):
        grey = picture([Environment(np.repeat(light[..., c : c + 1], 3, axis=2))])
        np.testing.assert_allclose(coloured.rgb[..., c], grey.rgb[..., c], rtol=0.05, atol=0.01)
    assert np.all(coloured.rgb[coloured.alpha == 0.0] == 0.0)
    np.testing.assert_allclose(coloured.single + coloured.multiple, coloured.rgb, rtol=1e-4, atol=1e-6)


def test_without_multiple_scattering_there_is_single_scattering():
    dome, sun = Environment(sky()), Sun((0.3, 0.4, 0.8), 2.0)
    whole, only, both = (
        picture(lights, multiple=multiple) for lights, multiple in (([dome], 1), ([dome], 0), ([sun, dome], 0))
    )
    assert whole.single.mean() > 0.05 and not both.multiple.any()
    np.testing.assert_allclose(only.rgb, whole.single, rtol=0.02, atol=0.01)
    np.testing.assert_allclose(both.rgb, only.rgb + picture([sun], multiple=False).rgb, rtol=0.02, atol=0.01)


def test_beside_a_sun_it_adds_up():
    sun, dome = Sun((0.3, 0.4, 0.8), 2.0), Environment(sky())
    both = picture([sun, dome]).rgb
    np.testing.assert_allclose(both, picture([sun]).rgb + picture([dome]).rgb, rtol=0.03, atol=0.01)


def test_where_it_cannot_be_taken_as_a_whole_it_is_parallel_light():
    """Beside surfaces, and with networks that know suns alone."""
    register_baselines()
    dome = Environment(sky(), name="dome")
    layer = picture([dome], model="single-scattering")
    assert layer.report.counts["suns"] == 12 and layer.report.counts["environments"] == 0
    assert any("12 directions" in sentence for sentence in layer.report.planned)


def test_volumes_apart_are_lit_one_by_one():
    far = np.eye(4)
    far[0, 3] = 2.5
    other = Volume(BLOB.density, far @ BLOB.world_from_index, "other")
    medium, settings = Medium(15.0, 1.0, 0.5), Settings(depth_samples=4)
    dome, even = Environment(sky()), Environment(np.full((1, 2, 3), 0.4))
    whole = render([(BLOB, medium), (other, medium)], [dome], camera(), settings)
    assert whole.report.counts["environments"] == 1 and whole.report.counts["suns"] == 0
    np.testing.assert_allclose(whole.rgb, picture([dome]).rgb, rtol=0.05, atol=0.02)
    # The white furnace holds for all of them.
    layer = render([(BLOB, medium), (other, medium)], [even], camera(), settings)
    np.testing.assert_allclose(layer.rgb + (1.0 - layer.alpha[..., None]) * 0.4, 0.4, rtol=0.005)


def test_the_estimate_of_memory_includes_the_lattices():
    medium, settings = Medium(15.0, 1.0, 0.5), Settings()
    dome, sun = Environment(sky()), Sun((0.3, 0.4, 0.8))
    with_dome, without = (make_plan([(BLOB, medium)], lights, camera(), settings) for lights in ([sun, dome], [sun]))
    predictor = VolumePredictor(load_network("mrpnn"), BLOB, 0.5)
    network = load_environment_network("mrpnn")
    prepared = predictor.prepare_environment(network, [dome], 15.0)
    held = sum(values.nbytes for values in vars(prepared).values() if isinstance(values, np.ndarray))
    held += prepared.depths.lattice.nbytes
    # While they are padded, both copies are held.
    assert 4 * prepared.light.nbytes + held < with_dome.memory - without.memory
