# SPDX-License-Identifier: GPL-3.0-or-later
"""Targets, the loss and the trainer, on small data."""

import json
import pathlib

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from scipy.ndimage import map_coordinates

import inference
from inference import Medium, Sun
from inference.features.descriptors import angle_to_sun
from inference.features.final_gather import DIRECTIONS, VALUES
from inference.features.stencil import SPARSE, frames
from inference.grids.bound_medium import BoundMedium
from inference.grids.grid import Grid
from inference.grids.working_cube import fit_cube
from inference.marching.marcher import ray_features_at
from inference.network.network import load_network
from inference.network.placed_lights import PlacedSun
from inference.network.predictor import VolumePredictor
from training import evaluate, export, memory, train
from training.data.targets import ALBEDOS, SUNS, make_targets, rays_towards, unit_vectors
from training.networks import RayMRPNN
from training.onnx_graph import linear_layers
from training.procedural.seeded_volume import seeded_volume
from training.procedural.volumes import make_volume

# They make volumes and trace paths in them.
pytestmark = pytest.mark.slow

WEIGHTS = pathlib.Path(inference.__file__).parent / "weights"


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Training files of three small volumes."""
    folder = tmp_path_factory.mktemp("data")
    for seed in (3, 4, 5):
        np.savez(folder / f"{seed:07d}.npz", **make_targets(seed, points=96, paths=4))
    return folder


def test_rows_are_complete_and_plausible(data):
    with np.load(data / "0000003.npz") as rows:
        count = len(rows["gamma"])
        assert 0 < count <= 96 * SUNS and count % SUNS == 0
        assert rows["features"].shape == (count, 2, 192)
        assert rows["albedo"].shape == (count, ALBEDOS) and rows["radiance"].shape == (count, 2, ALBEDOS)
        assert np.all(rows["radiance"] >= 0.0) and rows["radiance"].max() > 0.0
        # The same paths weighted with a smaller albedo carry less radiance.
        order = np.argsort(rows["albedo"], axis=1)
        radiance = np.take_along_axis(rows["radiance"], order[:, None], axis=2)
        assert np.all(np.diff(radiance, axis=2) >= 0.0)
        assert np.all(rows["albedo"][:, 0] == 1.0)


def test_targets_follow_from_the_seed(data):
    again = make_targets(3, points=96, paths=4)
    with np.load(data / "0000003.npz") as rows:
        np.testing.assert_array_equal(again["radiance"], rows["radiance"])
        np.testing.assert_array_equal(again["features"], rows["features"])


def test_rays_are_uniform_in_the_angle_to_the_sun():
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
        train.relative_l2(torch.exp(y).expand_as(target), target, torch.ones(1), torch.ones(1)).backward()
        optimizer.step()
    assert torch.exp(y).item() == pytest.approx(target.mean().item(), rel=0.01)


def run(data, folder, steps):
    train.main(
        [
            "--network",
            "mrpnn",
            "--data",
            str(data),
            "--held",
            str(data),
            "--run",
            str(folder),
            "--steps",
            str(steps),
            "--report-every",
            "10",
            "--threads",
            "2",
        ]
    )
    return torch.load(folder / "checkpoint.pt", weights_only=True)


def test_training_learns_and_resumes_where_it_stopped(data, tmp_path, monkeypatch):
    monkeypatch.setattr(train, "BATCH", 256)
    monkeypatch.setattr(train, "WARM_UP", 5)
    # A learning rate that does not depend on the number of steps, so that runs can be compared.
    monkeypatch.setattr(train, "rate", lambda step, steps: 1.0)
    whole = run(data, tmp_path / "whole", 60)
    run(data, tmp_path / "parts", 20)
    resumed = run(data, tmp_path / "parts", 60)
    for key, value in whole["net"].items():
        torch.testing.assert_close(resumed["net"][key], value, rtol=1e-4, atol=1e-6)
    progress = [json.loads(line) for line in (tmp_path / "whole" / "progress.jsonl").read_text().splitlines()]
    assert [line["step"] for line in progress] == [10, 20, 30, 40, 50, 60]
    losses = [line["loss"] for line in progress]
    assert np.mean(losses[3:]) < 0.8 * losses[0]
    assert abs(whole["configuration"]["held_bias"]) < 0.5


def test_a_batch_draws_from_the_folders_by_their_weights():
    random = torch.Generator().manual_seed(0)
    limits, shares = np.array([0, 10, 5000, 5003]), torch.tensor([0.5, 0.2, 0.3], dtype=torch.float64)
    rows = torch.cat([train.draw_rows(limits, shares, random) for _ in range(20)]).numpy()
    assert rows.min() == 0 and rows.max() == 5002
    counts, _ = np.histogram(rows, bins=limits)
    np.testing.assert_allclose(counts / len(rows), shares, atol=5 * np.sqrt(0.25 / len(rows)))
    # Within a folder every row is equally likely.
    few = np.bincount(rows[rows < 10], minlength=10)
    np.testing.assert_allclose(few, few.mean(), atol=5 * np.sqrt(few.mean()))


def test_training_resumes_from_exported_weights(data, tmp_path, monkeypatch):
    """They predict as onnxruntime does with the file, whatever the standardisation, and keep their history."""
    monkeypatch.setattr(train, "BATCH", 64)
    loaded, path = load_network("mrpnn"), WEIGHTS / "mrpnn.onnx"
    files = sorted(data.glob("*.npz"))
    net = RayMRPNN()
    rows = train.load(files, net.columns)
    inputs = net.inputs(rows, torch.arange(len(rows["gamma"])))
    net.calibrate(*(values[::3] for values in inputs))
    configuration = train.start_from(net, path)
    albedo = np.array([1.0, 0.8], np.float32)
    names = "stencil", "ray", "gathered", "anisotropy", "gamma"
    feed = dict(zip(names, (values.numpy() for values in inputs)))
    feed["view"] = np.arange(len(rows["gamma"]), dtype=np.int32)
    expected = onnxruntime.InferenceSession(path).run(None, {**feed, "albedo": albedo})[0]
    with torch.no_grad():
        predicted = net(*inputs, torch.from_numpy(albedo)[:, None].expand(2, len(rows["gamma"])))
    np.testing.assert_allclose(predicted, expected, rtol=1e-4)
    assert configuration == loaded.configuration
    train.main(
        [
            "--network",
            "mrpnn",
            "--data",
            str(data),
            str(data),
            "--shares",
            "3",
            "1",
            "--held",
            str(data),
            "--run",
            str(tmp_path),
            "--initial",
            str(path),
            "--learning-rate",
            "1e-5",
            "--steps",
            "2",
        ]
    )
    tuned = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["configuration"]
    assert tuned["initial"] == configuration and tuned["shares"] == [0.75, 0.25]
    # Two small steps change it little; randomly initialised weights have several times the error.
    assert tuned["held_rmse"] == pytest.approx(train.held_error(net, rows)[0], rel=0.02)


def test_interpolated_weights_are_exported(data, tmp_path, monkeypatch):
    """Halfway: every weight is the mean of both, and the file says so."""
    monkeypatch.setattr(train, "BATCH", 64)
    before, after = WEIGHTS / "mrpnn.onnx", tmp_path / "after.onnx"
    train.main(
        [
            "--network",
            "mrpnn",
            "--data",
            str(data),
            "--held",
            str(data),
            "--run",
            str(tmp_path),
            "--initial",
            str(before),
            "--learning-rate",
            "1e-2",
            "--steps",
            "2",
        ]
    )
    checkpoint = str(tmp_path / "checkpoint.pt")
    export.main([checkpoint, str(after)])
    export.main([checkpoint, str(tmp_path / "half.onnx"), "--with", str(before), "0.5"])
    ends, half = [linear_layers(onnx.load(path)) for path in (before, after)], onnx.load(tmp_path / "half.onnx")
    for one, other, mean in zip(*ends, linear_layers(half)):
        assert not torch.allclose(one[0], other[0], rtol=1e-4, atol=1e-6)
        torch.testing.assert_close(0.5 * (one[0] + other[0]), mean[0], rtol=1e-3, atol=1e-5)
    configuration = json.loads({entry.key: entry.value for entry in half.metadata_props}["configuration"])
    assert configuration["mean_with"][0]["share"] == 0.5 and "held_rmse" not in configuration
    with pytest.raises(SystemExit):
        export.main([checkpoint, str(after), "--with", str(after), "0.5"])


def test_only_the_default_network_starts_from_exported_weights(data, tmp_path):
    with pytest.raises(SystemExit):
        train.main(
            [
                "--network",
                "mrpnn-paper",
                "--data",
                str(data),
                "--held",
                str(data),
                "--run",
                str(tmp_path),
                "--initial",
                str(WEIGHTS / "mrpnn-paper.onnx"),
            ]
        )


def test_the_validation_error_excludes_the_targets_noise():
    """Targets with noise around the prediction: no error, where a plain RMSE would show the noise."""
    torch.manual_seed(0)
    net = RayMRPNN()
    count = 20000
    data = {
        "features": torch.rand(count, 2, 192),
        "ray": torch.rand(count, 7),
        "around": torch.randn(count, 7),
        "gathered": torch.rand(count, DIRECTIONS, VALUES),
        "anisotropy": torch.full((count,), 0.5),
        "gamma": torch.rand(count),
        "albedo": torch.ones(count, 1),
    }
    with torch.no_grad():
        truth = net(*net.inputs(data, torch.arange(count)), data["albedo"].T)
    noise = 0.5 * truth.std() + 0.3 * truth.mean()
    data["radiance"] = (truth.T[:, None] + noise * torch.randn(count, 2, 1)).float()
    plain = ((truth.T - data["radiance"][:, 0]) ** 2 / truth.T**2).mean().sqrt()
    error, bias = train.held_error(net, data)
    assert plain > 0.25 and error < 0.2 * plain and abs(bias) < 0.01
    data["radiance"] *= 1.1
    assert train.held_error(net, data)[0] == pytest.approx(0.1, rel=0.25)


def test_typical_radiance_is_the_mean_of_similar_rows():
    random = np.random.default_rng(0)
    sigma_hat = np.repeat([2.0, 1500.0], 500)
    radiance = np.where(sigma_hat < 10, 0.01, 0.4) * random.uniform(0.5, 1.5, 1000)
    data = {
        "sigma_hat": sigma_hat,
        "gamma": np.full(1000, 1.0),
        "anisotropy": np.zeros(1000),
        "radiance": radiance[:, None, None],
    }
    typical = train.typical_radiance({key: torch.from_numpy(value) for key, value in data.items()})
    np.testing.assert_allclose(typical[:500, 0], radiance[:500].mean(), rtol=1e-5)
    np.testing.assert_allclose(typical[500:, 0], radiance[500:].mean(), rtol=1e-5)


def test_noisy_rows_weigh_less_but_not_by_their_own_noise():
    """Two kinds of rows of one radiance, whose targets have relative noise 0.1 and 3."""
    random = np.random.default_rng(0)
    anisotropy = np.repeat([0.0, 0.95], 5000)
    noise = np.where(anisotropy > 0.5, 3.0, 0.1)[:, None] * random.normal(size=(10_000, 2))
    data = {
        "sigma_hat": np.full(10_000, 50.0),
        "gamma": np.ones(10_000),
        "anisotropy": anisotropy,
        "radiance": 1.0 + noise[..., None],
    }
    data = {key: torch.from_numpy(value) for key, value in data.items()}
    weights = train.trust(data, train.typical_radiance(data))[:, 0].numpy()
    assert weights.mean() == pytest.approx(1.0, rel=1e-5)
    # A target is the mean of two halves, with half their variance; the scale is 1 + 1/4.
    expected = (0.5 * 9.0 / 1.25 + train.NOISE_FLOOR) / (0.5 * 0.01 / 1.25 + train.NOISE_FLOOR)
    assert weights[0] / weights[-1] == pytest.approx(expected, rel=0.1)
    assert np.ptp(weights[:5000]) == np.ptp(weights[5000:]) == 0.0


def test_overfitting_is_told_from_error():
    """Predictions off by 0.1 of the truth, plus a fifth of the training noise."""
    random = np.random.default_rng(0)
    truth, noise = random.uniform(0.5, 2.0, 400_000), random.normal(size=400_000)
    y = truth * (1.0 + 0.1 * random.choice([-1.0, 1.0], 400_000)) + 0.2 * 0.3 * noise
    again = truth + 0.5 * random.normal(size=(2, 400_000))
    error, squares, shared, count = memory.remembered(y, truth + 0.3 * noise, again)
    scale = 1.0 / y**2
    assert shared / squares == pytest.approx(0.2, abs=0.03)
    assert error / count == pytest.approx(((y - truth) ** 2 * scale).mean(), rel=0.02)
    assert squares / count == pytest.approx(((0.3 * noise) ** 2 * scale).mean(), rel=0.02)


def test_targets_are_retraced_at_the_same_points(data, tmp_path, capsys):
    file = tmp_path / "0000003.npz"
    np.savez(file, **make_targets(3, points=96, paths=64))
    rows, again = memory.trace_again(file, paths=64)
    with np.load(file) as found:
        once = found["radiance"][rows, :, 0].mean(axis=1)
    assert len(rows) == len(once) >= 4 * 20
    # The same radiance with other random numbers: it agrees with both halves as these do with each other.
    known, *others = (
        np.corrcoef(np.log(a + 1e-3), np.log(b + 1e-3))[0, 1] for a, b in (again, (once, again[0]), (once, again[1]))
    )
    assert 0.7 < known < 1.0 and min(others) > 0.9 * known and max(others) < 0.9999
    assert once.mean() == pytest.approx(again.mean(), rel=0.2)
    checkpoint = tmp_path / "checkpoint.pt"
    torch.save({"averaged": RayMRPNN().state_dict(), "configuration": {"network": "mrpnn"}}, checkpoint)
    memory.main(["--data", str(data), "--checkpoint", str(checkpoint), "--every", "2", "--paths", "8"])
    assert capsys.readouterr().out.startswith("2 volumes, ")


def test_evaluation_bins_every_row(data, tmp_path, capsys):
    checkpoint = tmp_path / "checkpoint.pt"
    torch.save({"averaged": RayMRPNN().state_dict(), "configuration": {"network": "mrpnn"}}, checkpoint)
    evaluate.main(["--held", str(data), "--checkpoint", str(checkpoint)])
    lines = capsys.readouterr().out.splitlines()
    printed = [[cell.strip() for cell in line.split("|")] for line in lines if "|" in line]
    rows = sum(len(np.load(file)["gamma"]) for file in data.glob("*.npz"))
    for quantity in ("gamma", "anisotropy", "sigma_hat", "thickness", "kind", "folder"):
        assert sum(int(line[4]) for line in printed if line[1] == quantity) == rows, quantity
    assert {line[2] for line in printed if line[1] == "kind"} == {make_volume(seed, 48).kind for seed in (3, 4, 5)}


def test_thickness_is_the_radius_of_the_largest_inscribed_ball():
    """A slab 10 of 40 cells thick; a ball of a quarter of the cube."""
    slab = np.zeros((40, 40, 40), np.float32)
    slab[2:38, 2:38, 15:25] = 0.5
    assert evaluate.thickness(slab) == pytest.approx(5 / 40, abs=1 / 40)
    x, y, z = (np.mgrid[:40, :40, :40] + 0.5) / 40 - 0.5
    assert evaluate.thickness((x**2 + y**2 + z**2 < 0.25**2).astype(np.float32)) == pytest.approx(0.25, abs=1 / 40)


def test_noise_shared_by_suns_is_told_from_their_own():
    """A component shared by a point's suns and one of their own, of variances 1 and 3: correlation 1/4."""
    random = np.random.default_rng(0)
    sizes = (3000, 5000)
    files = [random.normal(size=n) + np.sqrt(3.0) * random.normal(size=(SUNS, n)) for n in sizes]
    noise, firsts = np.concatenate([file.ravel() for file in files]), np.cumsum([0, *(SUNS * n for n in sizes)])
    assert evaluate.noise_correlation(noise, firsts) == pytest.approx(0.25, abs=0.02)


def test_training_inputs_equal_those_of_rendering():
    """A target's descriptor and ray features equal those of inference for the same point and sun."""
    rows = make_targets(5, points=16, paths=2)
    volume, _ = seeded_volume(5)
    cube = fit_cube(volume)
    default, papers = load_network("mrpnn"), load_network("mrpnn-paper")
    points = len(rows["gamma"]) // SUNS
    grid = Grid(volume)
    for k, i in ((0, 0), (1, points // 2), (SUNS - 1, points - 1)):
        row = k * points + i
        sigma_t = float(rows["sigma_hat"][row] / cube.edge)
        position, omega = (rows[key][row : row + 1].astype(float) for key in ("position", "omega"))
        sun = Sun(rows["sun"][row]).direction
        x, w = cube.positions(position), cube.directions(omega)
        for loaded, expected in ((papers, rows["features"][row]), (default, rows["features"][row, :1, ::SPARSE])):
            predictor = VolumePredictor(loaded, volume, rows["anisotropy"][row])
            reader = predictor.prepare(sigma_t, PlacedSun(Sun(sun), cube)).prediction
            read = [reader.lookup.lattices, *([reader.transmittance] if loaded is papers else [])]
            features = np.empty((len(read), 1, len(loaded.points.mips)), np.float32)
            for span, index in reader.lookup.cells(x, w, np.zeros(1, int)):
                for lattices, values in zip(read, features):
                    lattices.read(index, values[span])
            features = features[:, 0]
            # Half precision in the file; a point at a cell's border may fall on either side.
            assert np.count_nonzero(~np.isclose(features, expected, rtol=2e-3, atol=2e-3)) <= max(
                0.01 * features.size, 1
            )
        assert angle_to_sun(w, reader.lookup.sun)[0] == pytest.approx(rows["gamma"][row], abs=1e-3)

        bound = BoundMedium(grid, Medium(sigma_t), sigma_t, grid.sun_depths([sun]))
        light = ray_features_at(bound, position, omega, predictor.fluence(sigma_t, [PlacedSun(Sun(sun), cube)])).of(
            slice(None), 0, 0
        )[0]
        around = reader.light.read(x, w, reader.lookup.sun, reader.anisotropy)[0]
        np.testing.assert_allclose(around, rows["around"][row], rtol=1e-3, atol=2e-3)
        np.testing.assert_allclose(light, rows["ray"][row], rtol=1e-3, atol=1e-4)
        gathered = reader.gather()(x, frames(w, reader.lookup.sun))[0]
        np.testing.assert_allclose(gathered, rows["gathered"][row], rtol=3e-3, atol=3e-3)
        cells = len(volume.density)
        step = 0.25 / cells
        way = np.arange(0.5 * step, 2.0, step)
        places = (position + way[:, None] * sun + 0.5) * cells + 0.5
        depth = sigma_t * step * map_coordinates(np.pad(volume.density, 1), places.T, order=1).sum()
        assert np.exp(-light[0]) == pytest.approx(np.exp(-depth), abs=0.02)
