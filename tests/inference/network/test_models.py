# SPDX-License-Identifier: GPL-3.0-or-later
"""Models by name: what each is for, the path tracer included."""

import subprocess
import sys

import numpy as np
import pytest

import training.reference
import training.rpnn
from inference import Camera, Medium, Settings, Sun, Volume, available_models, predict_multiple, render
from inference.scene import SceneError
from training.procedural.seeded_volume import cube_volume
from training.tracer.path_tracer import PinholeCamera, Sampling, Scene, Vertices, trace_pixels, trace_points

SUN = Sun((0.6, 0.5, 0.62))


@pytest.fixture(scope="module")
def ball():
    """A ball of fog with a dense side, in a grid whose cells fill the cube."""
    axis = (np.arange(32) + 0.5) / 32 - 0.5
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.where(x**2 + y**2 + z**2 < 0.16, 0.5 + x, 0.0).astype(np.float32)


def camera(pixels):
    """An orthographic view along -z that shows the cube."""
    eye = np.eye(4)
    eye[2, 3] = 2.0
    return Camera(eye, "orthographic", (pixels, pixels), ortho_scale=1.0)


def test_rpnn_says_which_values_it_used(ball):
    """It was trained for one anisotropy and albedo 1, and uses them for all others."""
    volume = cube_volume(ball, "fog")
    settings = Settings(depth_samples=2, model="rpnn")
    own = render([(volume, Medium(20.0, 1.0, 0.857))], [SUN], camera(8), settings)
    assert own.report.model == "rpnn" and own.report.warnings == [] and own.multiple.max() > 0.0
    other = render([(volume, Medium(20.0, (0.5, 0.9, 1.0), 0.2))], [SUN], camera(8), settings)
    assert other.report.warnings == [
        "fog: anisotropy 0.2 is outside the network's range; multiple scattering uses 0.857",
        "fog: albedo 0.5 is outside the network's range; multiple scattering uses 1",
        "fog: albedo 0.9 is outside the network's range; multiple scattering uses 1",
    ]
    # The last scattering event has the medium's own albedo.
    np.testing.assert_allclose(other.multiple, own.multiple * np.float32([0.5, 0.9, 1.0]), rtol=1e-5)


def test_rendering_does_not_depend_on_threads(ball):
    medium, settings = Medium(20.0, 1.0, 0.857), dict(depth_samples=2, model="rpnn")
    layers = [
        render([(cube_volume(ball), medium)], [SUN], camera(40), Settings(threads=threads, **settings))
        for threads in (1, 3)
    ]
    np.testing.assert_array_equal(layers[0].rgb, layers[1].rgb)


@pytest.mark.slow
def test_the_reference_equals_the_path_tracers_image(ball):
    """Rendered at depth samples or traced from the camera: one image up to noise."""
    volume, medium = cube_volume(ball), Medium(30.0, (1.0, 0.8, 0.5), 0.5)
    eye = np.eye(4)
    eye[2, 3] = 3.0
    view = Camera(eye, resolution=(16, 16), fov=np.radians(25.0))
    layer = render([(volume, medium)], [SUN], view, Settings(depth_samples=24, model="reference"))
    assert "reference" in available_models() and layer.report.model == "reference"
    pinhole = PinholeCamera((0, 0, 3), (0, 0, 0), (0, 1, 0), 25.0, 16)
    traced = trace_pixels(Scene(ball, SUN.direction), pinhole, medium, Sampling(512, seed=1))
    shown = layer.alpha > 0.1
    np.testing.assert_allclose(layer.rgb[shown].mean(axis=0), traced[shown, :3].mean(axis=0), rtol=0.02)
    # Two references of different seeds are independent: their halves give their noise.
    other = render([(volume, medium)], [SUN], view, Settings(depth_samples=24, model="reference", seed=1))
    assert np.all(other.multiple[shown] != layer.multiple[shown])


def test_the_reference_follows_the_volume_in_the_world(ball):
    """A grid that is translated, rotated, mirrored, scaled and padded scatters as before."""
    positions = np.array([[0.1, 0.05, -0.1], [-0.2, 0.1, 0.0]])
    omega = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]])
    vertices = Vertices(positions, omega, 20.0, 0.4, [1.0])
    expected = trace_points(Scene(ball, SUN.direction), vertices, Sampling(10000, seed=1))[:, 0, 0]
    turn = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, 0.8], [0.8, 0.0, -0.6]])
    scale, shift = 7.0, np.array([3.0, -20.0, 1.0])
    world_from_index = np.eye(4)
    world_from_index[:3, :3] = turn * scale / 32
    # Two empty voxels before the grid: the cube's corner is at index 1.5.
    world_from_index[:3, 3] = shift + turn @ np.full(3, -0.5 - 1.5 / 32) * scale
    volume = Volume(np.pad(ball, ((2, 3), (2, 0), (2, 7))), world_from_index)
    copies = 1000
    found = predict_multiple(
        volume,
        Medium(20.0 / scale, 1.0, 0.4),
        Sun(turn @ SUN.direction),
        (shift + scale * positions @ turn.T).repeat(copies, 0) + 1e-6 * np.arange(2 * copies)[:, None],
        (omega @ turn.T).repeat(copies, 0),
        model="reference",
    )
    np.testing.assert_allclose(found[:, 0].reshape(2, copies).mean(axis=1), expected, rtol=0.05)


def test_the_reference_requires_cubic_voxels(ball):
    volume = Volume(ball, np.diag([1.0, 1.0, 2.0, 1.0]), "fog")
    with pytest.raises(SceneError, match="fog: .*cubic voxels"):
        predict_multiple(volume, Medium(1.0), SUN, np.zeros((1, 3)), [[0.0, 0.0, 1.0]], model="reference")


@pytest.mark.parametrize("name", ["reference", "rpnn"])
def test_what_only_the_repository_has_is_named_and_refused(name):
    """As in the extension, which has no training code: a process of its own, since here it is registered."""
    assert training.reference.PathTracer.name == "reference" and training.rpnn.NAME == "rpnn"
    code = (
        "import sys\n"
        "from inference import SceneError\n"
        "from inference.network.network import available_models, load_network\n"
        f"assert {name!r} not in available_models()\n"
        f"try: load_network({name!r})\n"
        "except SceneError as error: print(error)\n"
        "assert not {'numba', 'training', 'bpy'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "repository" in done.stdout and "mrpnn" in done.stdout
