# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of environments corrected by light paths."""

import numpy as np
import pytest

from benchmarks.fidelity.environments import VIEWS, cameras, compare, environments, references
from inference import Camera, Environment, Medium, Settings, Sun, Surface, render
from inference.image import environment_correction
from tests.support.volumes import cloud
from training.procedural.seeded_volume import seeded_volume

WITHOUT = Settings(light_paths=False)
MEDIUM = Medium(40.0, 0.95, 0.8)


def view(**options) -> Camera:
    matrix = np.eye(4)
    matrix[2, 3] = 3.0
    return Camera(matrix, resolution=(48, 48), **options)


def grey(radiance: np.ndarray) -> Environment:
    return Environment(np.repeat(radiance[..., None], 3, axis=2))


def horizon(scale=1.0) -> Environment:
    return grey(np.float32(scale) * environments()["glowing horizon"])


def rendered(light=None, settings=None, medium=MEDIUM, camera=None, **options) -> np.ndarray:
    lights = [light or horizon()]
    return render([(cloud(), medium)], lights, camera or view(), settings or Settings(), **options).rgb


def test_a_bias_of_the_network_is_taken_back():
    """Of a cloud that a glowing horizon lights from the side, against paths of the tracer that trains networks."""
    volume, sigma, anisotropy = seeded_volume(1003000)[0], 150.0, 0.857
    light = environments()["glowing horizon"]
    camera, pinhole = cameras(VIEWS["level"], 40)
    halves, alpha = references(volume.density, (sigma, anisotropy), pinhole, light[None], 512)
    biases, shown = [], alpha > 0.02
    for settings in (WITHOUT, Settings()):
        layer = render([(volume, Medium(sigma, 1.0, anisotropy))], [grey(light)], camera, settings)
        biases.append(compare(layer.rgb[..., 0].ravel()[shown], halves[:, 0, 0][:, shown])[1])
    assert biases[0] > 0.05
    assert abs(biases[1]) < 0.03


def test_even_light_stays_even_where_nothing_absorbs():
    light, medium = Environment(np.full((4, 8, 3), 2.0)), Medium(40.0, 1.0, 0.8)
    corrected, predicted = (rendered(light, settings, medium) for settings in (Settings(), WITHOUT))
    np.testing.assert_allclose(corrected, predicted, rtol=1e-3, atol=1e-6)


@pytest.mark.slow
def test_every_colour_has_its_own_factor():
    """Red from above, green from below, blue from one side."""
    named = environments()
    light = Environment(np.stack([named[n] for n in ("gradient over dark ground", "from below", "from one side")], 2))
    ratio = rendered(light).sum(axis=(0, 1)) / rendered(light, WITHOUT).sum(axis=(0, 1))
    alone = []
    for c in range(3):
        one = Environment(np.repeat(light.radiance[..., c : c + 1], 3, axis=2))
        alone.append(rendered(one)[..., c].sum() / rendered(one, WITHOUT)[..., c].sum())
    np.testing.assert_allclose(ratio, alone, rtol=2e-2)
    assert np.ptp(ratio) > 1e-3


def test_the_picture_is_linear_in_the_light():
    np.testing.assert_allclose(rendered(horizon(7.0)), 7.0 * rendered(), rtol=1e-4, atol=1e-6)


def test_tiny_changes_of_the_light_are_tiny_in_the_picture():
    light, before = horizon(), rendered()
    random = np.random.default_rng(1).uniform(-1e-3, 1e-3, light.radiance.shape)
    after = rendered(Environment((light.radiance * (1.0 + random)).astype(np.float32)))
    np.testing.assert_allclose(after, before, rtol=3e-3, atol=1e-4 * before.max())


def test_a_region_is_a_part_of_the_whole_picture():
    part = rendered(camera=view(region=(10, 12, 40, 30)))
    np.testing.assert_allclose(part, rendered()[12:30, 10:40], rtol=2e-2, atol=2e-2 * part.max())
    np.testing.assert_allclose(part.sum(), rendered()[12:30, 10:40].sum(), rtol=1e-3)


def test_the_number_of_threads_does_not_matter():
    one, two = (rendered(settings=Settings(threads=threads)) for threads in (1, 2))
    np.testing.assert_allclose(one, two, rtol=1e-5, atol=1e-6)


def test_the_light_of_suns_stays_as_it_is():
    """Beside an environment, whose own part alone changes."""
    sun = Sun((0.3, 0.2, 0.9), 5.0)
    for settings in (Settings(), WITHOUT):
        both = render([(cloud(), MEDIUM)], [sun, horizon()], view(), settings).rgb
        alone = render([(cloud(), MEDIUM)], [sun], view(), settings).rgb
        np.testing.assert_allclose((both - alone).sum(), rendered(settings=settings).sum(), rtol=2e-3)


def test_noise_of_few_paths_counts_little():
    """In voxels a thousand times as thick there is no time for more than a few."""
    thick = Medium(1e6, 1.0, 0.0)
    corrected, predicted = (rendered(None, settings, thick) for settings in (Settings(), WITHOUT))
    assert corrected.sum() == pytest.approx(predicted.sum(), rel=0.01)


def floor(side: float) -> Surface:
    corners = np.array([[-side, -side, -0.1], [side, -side, -0.1], [side, side, -0.1], [-side, side, -0.1]])
    return Surface(corners[[[0, 1, 2], [0, 2, 3]]], reflectance=0.5)


def test_nothing_is_corrected_among_surfaces():
    without = rendered(None, WITHOUT, surfaces=[floor(5.0)])
    np.testing.assert_allclose(rendered(surfaces=[floor(5.0)]), without, rtol=1e-5, atol=1e-6)


def test_cameras_that_see_little_or_nothing_of_a_volume():
    """A volume of a few pixels, one behind the camera, and a picture of one pixel."""
    small = rendered(camera=view(fov=3.0)), rendered(None, WITHOUT, camera=view(fov=3.0))
    assert small[0].sum() == pytest.approx(small[1].sum(), rel=0.1)
    turned = np.diag([-1.0, 1.0, -1.0, 1.0])
    turned[2, 3] = 3.0
    assert not rendered(camera=Camera(turned, resolution=(16, 16))).any()
    matrix = np.eye(4)
    matrix[2, 3] = 3.0
    assert np.isfinite(rendered(camera=Camera(matrix, resolution=(1, 1)))).all()


def test_factors_are_shrunk_by_their_uncertainty():
    factor = environment_correction._factor
    predicted, traced = np.array([2.0, 2.0, 0.0]), np.array([2.2, 2.2, 1.0])
    expected = environment_correction.EXPECTED
    found = factor(predicted, traced, np.array([0.0, (2.0 * expected) ** 2, 1.0]))
    np.testing.assert_allclose(found, [1.1, 1.05, 1.0])
