# SPDX-License-Identifier: GPL-3.0-or-later
"""Training for light from everywhere: traced exits, the rows made of them, and the network."""

import json
import math

import numpy as np
import pytest
import torch

from benchmarks.fidelity.environments import cameras
from benchmarks.fidelity.shaded_environments import rectangle
from inference import Environment, Medium, Settings, Surface, render
from inference.network.conditions import RayPoints
from inference.network.environment_network import load_environment_network
from inference.network.network import load_network
from inference.network.predictor import VolumePredictor
from training import export_environment, train_environment
from training.data import environment_targets
from training.procedural.seeded_volume import cube_volume, seeded_volume
from training.tracer.density_grid import prepare
from training.tracer.exits import _encode, decode_directions, optical_depths, trace_camera_exits, trace_exits
from training.tracer.path_tracer import Sampling
from training.tracer.scene import PinholeCamera, Vertices

SEED = 5


def unit_vectors(count):
    vectors = np.random.default_rng(0).normal(size=(count, 3))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


@pytest.fixture(scope="module")
def ball():
    """A homogeneous ball of radius 0.4 in the cube."""
    axis = (np.arange(48) + 0.5) / 48 - 0.5
    radius = np.sqrt(sum(values**2 for values in np.meshgrid(axis, axis, axis)))
    return prepare((radius < 0.4).astype(np.float32))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A file of few rows."""
    found = tmp_path_factory.mktemp("exits")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("POINTS", 128), ("PATHS", 32), ("MEDIA", 2), ("ENVIRONMENTS", 2)):
            patch.setattr(environment_targets, name, value)
        np.savez(found / f"{SEED:07d}.npz", **environment_targets.make_rows(SEED))
    return found


def test_directions_survive_their_code():
    vectors = unit_vectors(2000)
    decoded = decode_directions(np.array([_encode(*vector) for vector in vectors], np.uint16))
    assert np.degrees(np.arccos(np.clip((decoded * vectors).sum(axis=1), -1.0, 1.0))).max() < 1.0


@pytest.mark.slow
def test_unscattered_paths_follow_the_phase_function_and_the_transmittance(ball):
    omega = unit_vectors(400)
    centre = np.zeros((len(omega), 3), np.float32)
    for g in (0.0, 0.8):
        exits = trace_exits(ball, Vertices(centre, omega, 2.0, g, 1.0), Sampling(256, 1))
        single = exits.scatterings == 0
        # From the middle of a ball every direction is as far.
        assert single.mean() == pytest.approx(math.exp(-2.0 * 0.4), abs=0.01)
        cosine = (decode_directions(exits.directions) * omega[:, None]).sum(axis=2)
        assert cosine[single].mean() == pytest.approx(g, abs=0.01)
    again = trace_exits(ball, Vertices(centre, omega, 2.0, 0.8, 1.0), Sampling(256, 1))
    np.testing.assert_array_equal(again.directions, exits.directions)
    np.testing.assert_allclose(optical_depths(ball, centre, omega), 0.4, atol=0.01)


def test_camera_paths_scatter_as_often_as_the_medium_is_opaque(ball):
    camera = PinholeCamera((0.0, -2.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 2.0, 4)
    exits, _, hit = trace_camera_exits(ball, camera, 2.0, 0.5, Sampling(4096, 1))
    assert hit.mean() == pytest.approx(1.0 - math.exp(-2.0 * 0.8), abs=0.02)
    assert np.all(exits.scatterings[~hit] == 0)


def test_rows_give_even_light_and_fall_with_the_albedo(folder):
    rows = train_environment.read_file(folder / f"{SEED:07d}.npz", SEED)
    targets = rows["targets"].astype(np.float32)
    assert targets.shape[1:] == (2, 1 + train_environment.ALBEDOS, 2) and len(targets) > 64
    order = np.argsort(rows["albedo"], axis=1)
    multiple = np.take_along_axis(targets[:, :, 1:], order[:, None, :, None], axis=2)
    assert np.all(np.diff(multiple, axis=2) >= -1e-3)
    even = train_environment.environment_values(np.ones((1, 8, 16)), np.arange(65536, dtype=np.uint16)[None])
    np.testing.assert_array_equal(even, 1.0)


def test_training_and_rendering_read_the_same(folder):
    """The shipped network, on rows of training data and at the same points of the same volume."""
    path = folder / f"{SEED:07d}.npz"
    rows, network = train_environment.read_file(path, SEED), load_environment_network("mrpnn")
    volume, _ = seeded_volume(SEED)
    with np.load(path) as data:
        d = {key: data[key] for key in data.files}
    for sigma_hat, g in sorted({*zip(d["sigma_hat"], d["anisotropy"])}):
        own = np.flatnonzero((d["sigma_hat"] == sigma_hat) & (d["anisotropy"] == g))
        predictor = VolumePredictor(load_network("mrpnn"), volume, float(g))
        for e, image in enumerate(d["environments"].astype(np.float32)):
            environment = Environment(np.repeat(image[..., None], 3, axis=2))
            sigma = float(sigma_hat) / predictor.cube.edge
            prepared = predictor.prepare_environment(network, [environment], sigma)
            assert prepared.skies.channels == 1
            positions = predictor.cube.centre + predictor.cube.edge * d["position"][own] @ predictor.cube.rotation.T
            directions = d["omega"][own] @ predictor.cube.rotation.T
            found = prepared.predict(RayPoints(positions, directions), d["along"][own], [1.0])[..., 0]
            candidates = rows["candidates"][own][..., e : e + 1].astype(np.float32)
            expected = network.run(rows["x"][own], candidates, np.array([1.0]))[..., 0].T
            assert np.abs(found - expected).mean() < 0.01 * expected.mean()


def test_a_run_trains_resumes_and_is_exported(folder, tmp_path):
    options = ["--data", str(folder), "--held", str(folder), "--run", str(tmp_path)]
    options += ["--report-every", "2", "--width", "64"]
    train_environment.main([*options, "--steps", "2"])
    train_environment.main([*options, "--steps", "4"])
    lines = [json.loads(line) for line in (tmp_path / "progress.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [2, 4] and math.isfinite(lines[-1]["rmse"])
    export_environment.main([str(tmp_path / "checkpoint.pt"), str(tmp_path / "net.onnx")])
    assert (tmp_path / "net.sha256").exists()
    checkpoint = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    assert checkpoint["configuration"]["volumes"] == 1


def test_a_world_beside_a_wall_is_that_of_traced_paths():
    """The wall, black and endless in y and upwards, hides nearly half of the sky from one side of a ball of fog."""
    axis = (np.arange(32) + 0.5) / 32 - 0.5
    density = (np.sqrt(sum(values**2 for values in np.meshgrid(axis, axis, axis))) < 0.4).astype(np.float32)
    volume, albedo, sigma, at, low = cube_volume(density), 0.9, 10.0, 0.55, -0.2
    wall = rectangle(0, at, (-50.0, low), (50.0, 50.0))
    camera, pinhole = cameras((0.0, -2.2, 0.15), 16)
    exits, places, hit = trace_camera_exits(prepare(density), pinhole, sigma, 0.4, Sampling(512, 1))
    towards = decode_directions(exits.directions)
    with np.errstate(divide="ignore"):
        height = places[..., 2] + (at - places[..., 0]) / towards[..., 0] * towards[..., 2]
    seen = hit & ~((towards[..., 0] > 0.0) & (height > low))
    expected = (seen * albedo ** (exits.scatterings + 1.0)).mean(axis=1).reshape(16, 16)
    even = Environment(np.ones((8, 16, 3), np.float32))
    settings = Settings(depth_samples=8, threads=1)
    layer = render([(volume, Medium(sigma, albedo, 0.4))], [even], camera, settings, surfaces=[Surface(wall, "wall")])
    assert layer.report.counts["suns"] == 0
    found = layer.rgb[..., 0]
    assert found.mean() == pytest.approx(expected.mean(), rel=0.05)
    # Each half of the picture: the wall is on the right.
    for columns in (slice(0, 8), slice(8, 16)):
        assert found[:, columns].mean() == pytest.approx(expected[:, columns].mean(), rel=0.08)
    assert expected[:, 8:].mean() < 0.8 * expected[:, :8].mean()
