"""Targets, the loss and the trainer, on data small enough for a test."""

import numpy as np
import pytest
import torch

from inference import Medium, Sun, Volume
from inference.cube import fit_cube
from inference.multiple import MultipleField
from training import evaluate, train
from training.networks import MRPNN
from training.targets import ALBEDOS, SUNS, make_targets, rays_towards, unit_vectors


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Files of three small volumes."""
    folder = tmp_path_factory.mktemp("data")
    for seed in (3, 4, 5):
        np.savez(folder / f"{seed:07d}.npz", **make_targets(seed, points=96, paths=4))
    return folder


def test_rows_are_complete_and_plausible(data):
    with np.load(data / "0000003.npz") as rows:
        count = len(rows["gamma"])
        assert 0 < count <= 96 * SUNS and count % SUNS == 0
        assert rows["features"].shape == (count, 3, 192)
        assert rows["radiance"].shape == rows["albedo"].shape == (count, ALBEDOS)
        assert np.all(rows["radiance"] >= 0.0) and rows["radiance"].max() > 0.0
        # The same walks weighted with a smaller albedo bring less light.
        order = np.argsort(rows["albedo"], axis=1)
        radiance = np.take_along_axis(rows["radiance"], order, axis=1)
        assert np.all(np.diff(radiance, axis=1) >= 0.0)
        assert np.all(rows["albedo"][:, 0] == 1.0)


def test_targets_follow_from_the_seed(data):
    again = make_targets(3, points=96, paths=4)
    with np.load(data / "0000003.npz") as rows:
        np.testing.assert_array_equal(again["radiance"], rows["radiance"])
        np.testing.assert_array_equal(again["features"], rows["features"])


def test_rays_are_even_in_the_angle_to_the_sun():
    random = np.random.default_rng(0)
    sun = unit_vectors(random, 1)
    gamma = np.arccos(np.clip(rays_towards(random, sun, 20000) @ sun[0], -1, 1))
    counts, _ = np.histogram(gamma, bins=10, range=(0, np.pi))
    np.testing.assert_allclose(counts, 2000, atol=5 * np.sqrt(2000))


def test_loss_is_smallest_at_the_mean_of_noisy_targets():
    """Log-space L2 would settle at the median, exp(-1/2) = 0.61 of the mean here."""
    torch.manual_seed(0)
    target = torch.exp(torch.randn(200_000) - 0.5)
    y = torch.zeros(1, requires_grad=True)
    optimizer = torch.optim.Adam([y], lr=0.02)
    for _ in range(300):
        optimizer.zero_grad()
        train.relative_l2(torch.exp(y).expand_as(target), target).backward()
        optimizer.step()
    assert torch.exp(y).item() == pytest.approx(target.mean().item(), rel=0.01)


def run(data, folder, steps):
    train.main(["--data", str(data), "--run", str(folder), "--steps", str(steps), "--validation", "1",
                "--report-every", "10", "--threads", "2"])
    return torch.load(folder / "checkpoint.pt", weights_only=True)


def test_training_learns_and_goes_on_where_it_stopped(data, tmp_path, monkeypatch):
    monkeypatch.setattr(train, "BATCH", 256)
    monkeypatch.setattr(train, "WARM_UP", 5)
    # A learning rate that does not depend on the number of steps, so that runs can be compared.
    monkeypatch.setattr(train, "rate", lambda step, steps: 1.0)
    whole = run(data, tmp_path / "whole", 40)
    run(data, tmp_path / "parts", 20)
    resumed = run(data, tmp_path / "parts", 40)
    for key, value in whole["net"].items():
        torch.testing.assert_close(resumed["net"][key], value, rtol=1e-4, atol=1e-6)
    torch.manual_seed(0)
    held = train.load([data / "0000003.npz"])
    trained = MRPNN()
    trained.load_state_dict(whole["net"])
    # The mean radiance of a volume it has not seen: far off before, near after.
    before, after = train.validate(MRPNN(), held)[1], train.validate(trained, held)[1]
    assert abs(before) > 5.0 and abs(after) < 2.0


def test_evaluation_bins_every_row(data, tmp_path, capsys):
    checkpoint = tmp_path / "checkpoint.pt"
    torch.save({"averaged": MRPNN().state_dict()}, checkpoint)
    evaluate.main(["--data", str(data), "--checkpoint", str(checkpoint), "--volumes", "3"])
    lines = [line.split("|") for line in capsys.readouterr().out.splitlines() if "| gamma" in line]
    rows = sum(len(np.load(file)["gamma"]) for file in data.glob("*.npz"))
    assert sum(int(line[4]) for line in lines) == rows


def test_features_are_those_that_rendering_uses(monkeypatch):
    """A target's descriptor equals the one that inference builds for the same point and sun."""
    from inference import network
    from inference.descriptors import describe
    from training import targets
    from training.volumes import make_volume

    seen = {}
    def keep(density, suns, tau, positions, omega, *rest):
        seen.update(suns=suns, positions=positions, omega=omega)
        return trace(density, suns, tau, positions, omega, *rest)
    trace = targets.trace_points
    monkeypatch.setattr(targets, "trace_points", keep)
    rows = make_targets(5, points=16, paths=1)
    points = len(seen["positions"])
    sample = make_volume(5, targets.RESOLUTION)
    n = sample.density.shape[0]
    matrix = np.diag([1 / n] * 3 + [1.0])
    matrix[:3, 3] = 0.5 / n - 0.5
    volume = Volume(sample.density, matrix)
    cube = fit_cube(volume)
    loaded = network.load_network("mrpnn")
    for k, i in ((0, 0), (1, points // 2), (SUNS - 1, points - 1)):
        row = k * points + i
        sigma_t = rows["sigma_hat"][row] / cube.edge
        field = MultipleField(loaded, volume, Medium(sigma_t, 1.0, rows["anisotropy"][row]))
        position, omega = seen["positions"][i : i + 1].astype(float), seen["omega"][i : i + 1].astype(float)
        field.light(sigma_t, Sun(seen["suns"][k]).direction, *field.bounds(position))
        features, gamma = describe(
            loaded.stencil, field.lattices, field.phase, cube.positions(position), cube.directions(omega), field.sun
        )
        assert gamma[0] == pytest.approx(rows["gamma"][row], abs=1e-3)
        # Half precision in the file; a point at a cell's border may fall on either side.
        close = np.isclose(features[:, 0], rows["features"][row], rtol=2e-3, atol=2e-3)
        assert close.mean() > 0.99
