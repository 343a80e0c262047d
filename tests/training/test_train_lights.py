# SPDX-License-Identifier: GPL-3.0-or-later
"""The network for every light: the transport that it reads, features, fitting to noisy light, and the program."""

import json
import math

import numpy as np
import pytest
import torch

from training import train_lights
from training.data.light_fields import Cells, Transport
from training.data.light_scene import LightScene
from training.networks.any_light import AnyLight
from training.networks.light_features import TERMS, LightRecords, LitPoints, light_features
from training.tracer.light_paths import AlbedoField, Lights, LitMedium
from training.train_lights import Group, Rows, compare, load, predict, save, train

CELLS, COARSE, POINTS = 32, 16, 24


@pytest.fixture(scope="module")
def ball():
    axis = (np.arange(CELLS) + 0.5) / CELLS - 0.5
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    density = (x**2 + y**2 + z**2 < 0.16).astype(np.float32)
    mask = (x > 0.0).astype(np.float32)
    media = (
        LitMedium(10.0, 0.5, AlbedoField(np.array([1.0, 0.8]), np.array([1.0, 0.8]))),
        LitMedium(10.0, 0.5, AlbedoField(np.array([1.0, 0.8]), np.array([0.5, 0.8]), mask)),
    )
    emission = (density * (z > 0.0))[..., None]
    lights = Lights(np.array([[0.0, 0.0, 1.0]]), (), np.ones((1, 8, 16), np.float32), emission.astype(np.float32))
    return LightScene(0, density, lights, media, ("uniform", "sharp"))


def test_even_light_stays_even_without_absorption(ball):
    cells = Cells.of(ball)
    light = Transport(ball, cells).solve(ball.media[0], cells.masks[0], 1, 0)
    # Scattered and unscattered light together, everywhere.
    np.testing.assert_allclose(light[0] + light[4], 4.0 * np.pi, rtol=0.03)


def test_a_mask_that_changes_nothing_and_one_that_absorbs(ball):
    cells = Cells.of(ball)
    transport, (even, varying) = Transport(ball, cells), ball.media
    for light in range(3):
        uniform, masked = transport.solve(even, None, light, 1), transport.solve(varying, cells.masks[1], light, 1)
        np.testing.assert_allclose(masked[0], uniform[0], rtol=0.02, atol=0.01 * uniform[0].max())
        absorbed, kept = transport.solve(varying, cells.masks[1], light, 0), transport.solve(even, None, light, 0)
        assert absorbed[0].sum() < 0.9 * kept[0].sum()
        # More is absorbed where the albedo is lower.
        lost = 1.0 - absorbed[0] / np.maximum(kept[0], 1e-6)
        assert lost[40:48, 24:40, 24:40].mean() > lost[16:24, 24:40, 24:40].mean()


def _lit_points(g: float, factor: float = 1.0) -> LitPoints:
    """A sun, a lamp, an environment and an emission in matter at random; their light, but the sun's, times a factor."""
    random = np.random.default_rng(7)

    def tensor(*shape):
        return torch.from_numpy(random.random(shape).astype(np.float32))

    directions = random.normal(size=(POINTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    fields = tensor(4, 8, COARSE, COARSE, COARSE) + 0.5
    fields[:, 1:4] -= 1.0
    fields[:, 5:] -= 1.0
    fields[:2, 4:] = 0.0
    lamp = torch.zeros(4, 11)
    lamp[:, 9:] = torch.tensor([-2.0, 1.0])
    lamp[1, :5] = torch.tensor([0.3, 0.2, 0.8, 2.0 * factor, 0.05])
    scale = torch.tensor([1.0, factor, factor, factor])[:, None, None, None, None]
    return LitPoints(
        density=tensor(1, 1, CELLS, CELLS, CELLS),
        emission=tensor(1, 1, COARSE, COARSE, COARSE) * factor,
        environments=tensor(1, 8, 16) * factor,
        sigma=6.0,
        g=g,
        low=torch.tensor([0.9, 1.0, 0.7, 0.8]),
        high=torch.tensor([0.9, 0.5, 0.9, 0.8]),
        mask=tensor(1, 1, COARSE, COARSE, COARSE),
        fields=fields * scale,
        lights=LightRecords(
            torch.arange(4), torch.tensor([[0.6, 0.0, 0.8]]).repeat(4, 1), lamp, torch.zeros(4, dtype=torch.int64)
        ),
        positions=torch.from_numpy(random.uniform(-0.4, 0.4, (POINTS, 3)).astype(np.float32)),
        omega=torch.from_numpy(directions.astype(np.float32)),
    )


def test_terms_grow_with_the_light_and_inputs_do_not():
    (terms, inputs), (brighter, same) = (light_features(_lit_points(0.6, factor)) for factor in (1.0, 8.0))
    assert terms.shape == (4, POINTS, TERMS) and bool((terms >= 0.0).all()) and bool((terms.sum(dim=2) > 0.0).all())
    torch.testing.assert_close(brighter[1:], 8.0 * terms[1:], rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(brighter[0], terms[0])
    torch.testing.assert_close(same, inputs, rtol=1e-3, atol=1e-3)


def test_features_do_not_depend_on_the_axes():
    points = _lit_points(0.6)

    def turned(vectors):
        """By a quarter turn around z."""
        return torch.stack([-vectors[..., 1], vectors[..., 0], vectors[..., 2]], dim=-1)

    def cells(values):
        return torch.rot90(values, 1, (-3, -2))

    fields = cells(points.fields).clone()
    for first in (1, 5):
        fields[:, first : first + 3] = turned(fields[:, first : first + 3].movedim(1, -1)).movedim(-1, 1)
    lamp = points.lights.lamp.clone()
    lamp[:, :3] = turned(lamp[:, :3])
    other = points._replace(
        density=cells(points.density),
        emission=cells(points.emission),
        mask=cells(points.mask),
        environments=points.environments.roll(4, dims=2),
        fields=fields,
        lights=points.lights._replace(towards=turned(points.lights.towards), lamp=lamp),
        positions=turned(points.positions),
        omega=turned(points.omega),
    )
    # A direction on the border of two pixels of the environment may see either.
    for values, expected in zip(light_features(other), light_features(points)):
        assert float(((values - expected).abs() < 0.02 * expected.abs() + 0.02).float().mean()) > 0.98


def test_even_scattering_is_the_fluence_over_the_sphere():
    points = _lit_points(0.0)
    terms, _ = light_features(points)
    fluence = torch.nn.functional.grid_sample(
        points.fields[:, :1],
        points.positions.flip(-1).reshape(1, -1, 1, 1, 3).expand(4, -1, -1, -1, -1) * 2.0,
        padding_mode="border",
        align_corners=False,
    )
    torch.testing.assert_close(terms[..., 0], fluence.reshape(4, -1) / (4.0 * math.pi), rtol=1e-4, atol=1e-5)


def _noisy_rows(count: int = 6000) -> tuple[Rows, list[Group]]:
    random = torch.Generator().manual_seed(3)
    inputs = torch.randn(count, 4, generator=random)
    terms = torch.rand(count, TERMS, generator=random)
    light = terms[:, 1] * torch.exp(0.5 * inputs[:, 0]) + 0.5 * terms[:, 5]
    noise = 2.0 * torch.rand(count, 2, generator=random)
    nothing = torch.zeros(count)
    groups = [Group(0, 0, 0, 0, 1.0, 0.4, 1.0, 0.0)]
    return Rows(terms, inputs, light[:, None] * noise, nothing, light, torch.zeros(count, dtype=torch.int64)), groups


@pytest.mark.slow
def test_training_finds_the_mean_of_noisy_light(monkeypatch):
    rows, groups = _noisy_rows()
    # The first guess is far off, as its comparison says; that of the light itself says 0, whatever the noise.
    assert compare(predict(AnyLight(4), rows), rows, groups)["sun"]["rms"] > 0.3
    assert compare(rows.today, rows, groups)["sun"]["rms"] < 0.15
    monkeypatch.setattr(train_lights, "BATCH", 512)
    network = train(rows, groups, 60.0, log=lambda text: None)
    found = predict(network, rows)
    assert float((found - rows.today).square().mean().sqrt()) < 0.12 * float(rows.today.mean())
    assert float(found.mean()) == pytest.approx(float(rows.today.mean()), rel=0.04)


def test_files_between_processes_keep_what_arrays_share(tmp_path):
    shared = np.random.default_rng(0).random((5, 3)).astype(np.float32)
    path = save({"a": shared, "b": [shared, np.arange(7, dtype=np.int8)], "none": np.zeros((0, 3))}, tmp_path)
    found = load(path)
    assert found["a"] is found["b"][0] and found["a"].flags.aligned and not path.exists()
    np.testing.assert_array_equal(found["a"], shared)
    np.testing.assert_array_equal(found["b"][1], np.arange(7))
    assert found["none"].shape == (0, 3)


@pytest.mark.slow
def test_the_program_trains_and_compares(tmp_path, monkeypatch):
    monkeypatch.setattr(train_lights, "HELD_JOBS", [(0, 1), (7, 2), (12, 1)])
    monkeypatch.setattr(train_lights, "EPOCHS", 2)
    options = ["--volumes", "20001", "--held", "1000101", "--out", str(tmp_path), "--points", "64"]
    train_lights.main([*options, "--paths", "32", "256", "--processes", "1"])
    results = json.loads((tmp_path / "results.json").read_text())
    assert set(results) == {"training", "held", "today"}
    assert set(results["held"]) == set(results["today"]) == {"sun", "environment", "emission"}
    # Already the sum of the terms, with which training begins, has about as much light as there is.
    assert all(abs(values["bias"]) < 0.5 for values in results["held"].values())
    weights = torch.load(tmp_path / "network.pt", weights_only=True)
    AnyLight(weights["inputs"]).load_state_dict(weights["weights"])
