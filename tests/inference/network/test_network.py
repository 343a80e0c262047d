# SPDX-License-Identifier: GPL-3.0-or-later
"""Exported networks on onnxruntime against PyTorch, and invalid weights files."""

import numpy as np
import pytest
import torch

from inference.features.stencil import Stencil
from inference.models import weights_file
from inference.network import network
from inference.scene import SceneError
from training.data.stencil import load_stencil
from training.export import export, save
from training.networks import NETWORKS
from training.networks.mrpnn import GATHERED, RAY_INPUTS
from training.networks.mrpnn import POINTS as SPARSE_POINTS
from training.rpnn import rpnn_lattice

CONFIGURATION = {"anisotropy_range": [-0.3, 0.95], "sigma_hat_range": [1, 2000]}
POINTS, POINTS_A_RAY = 77, 7
LARGEST_FILE = 8_000_000


def make_net(name):
    torch.manual_seed(3)
    return NETWORKS[name]().eval()


def make_inputs(kind):
    """Inputs of a network as PyTorch takes them, without the albedo; points of a ray share their angle to the sun."""
    random = np.random.default_rng(4)
    gamma = random.uniform(0, np.pi, POINTS // POINTS_A_RAY).astype(np.float32).repeat(POINTS_A_RAY)
    if kind == "lattice":
        return {
            "lattice": random.random((POINTS, rpnn_lattice.LEVELS, rpnn_lattice.POINTS), np.float32),
            "gamma": gamma,
        }
    anisotropy = np.full(POINTS, 0.857, np.float32)
    if kind == "ray":
        stencil, light, gathered = (
            random.random((POINTS, *shape), np.float32) for shape in ((SPARSE_POINTS,), (RAY_INPUTS,), GATHERED)
        )
        return {"stencil": stencil, "ray": light, "gathered": gathered, "anisotropy": anisotropy, "gamma": gamma}
    features = random.random((3, POINTS, 192), np.float32)
    return {"features": features, "anisotropy": anisotropy, "gamma": gamma}


def fed(inputs, points):
    """The same, of some points, as onnxruntime takes them."""
    inputs = {key: values.take(points, axis=1 if key == "features" else 0) for key, values in inputs.items()}
    if "ray" in inputs:
        inputs["gamma"], first, inputs["view"] = np.unique(inputs["gamma"], return_index=True, return_inverse=True)
        inputs["anisotropy"] = inputs["anisotropy"][first]
    return inputs


def weights_folder(folder, monkeypatch, model):
    save(model, str(folder / "test.onnx"))
    monkeypatch.setattr(weights_file, "WEIGHTS", folder)


@pytest.mark.parametrize("name", sorted(NETWORKS))
def test_onnxruntime_equals_pytorch(name, tmp_path, monkeypatch):
    net = make_net(name)
    weights_folder(tmp_path, monkeypatch, export(net, CONFIGURATION))
    assert (tmp_path / "test.onnx").stat().st_size < LARGEST_FILE
    loaded = network.load_network("test")
    assert loaded.configuration["network"] == name
    inputs = make_inputs(net.kind)
    albedos = np.array([0.0, 0.3, 1.0], np.float32)
    with torch.no_grad():
        tensors = [torch.from_numpy(value) for value in inputs.values()]
        expected = net(*tensors, torch.from_numpy(np.repeat(albedos[:, None], POINTS, axis=1))).numpy()
    result = loaded.run(**fed(inputs, np.arange(POINTS)), albedo=albedos)
    assert result.shape == (3, POINTS)
    np.testing.assert_allclose(result, expected, rtol=1e-5, atol=1e-12)
    # A point's result does not depend on its neighbours in the batch.
    np.testing.assert_array_equal(loaded.run(**fed(inputs, [5]), albedo=albedos)[:, 0], result[:, 5])


@pytest.mark.parametrize("name", sorted(set(NETWORKS) - {"rpnn"}))
def test_light_is_positive_and_none_is_scattered_without_albedo(name):
    net = make_net(name)
    albedo = torch.tensor([[0.0], [0.5], [1.0]]).expand(3, POINTS)
    with torch.no_grad():
        radiance = net(*(torch.from_numpy(value) for value in make_inputs(net.kind).values()), albedo)
    assert torch.all(radiance[0] == 0.0) and torch.all(radiance[1:] > 0.0)


def test_a_network_states_what_it_was_trained_for(tmp_path, monkeypatch):
    """RPNN: one anisotropy and albedo, whatever the data; the stencil networks: every albedo."""
    weights_folder(tmp_path, monkeypatch, export(make_net("rpnn"), CONFIGURATION))
    loaded = network.load_network("test")
    assert loaded.anisotropy_range == (0.857, 0.857) and loaded.albedo_range == (1.0, 1.0)
    assert loaded.sigma_hat_range == (1, 2000)
    np.testing.assert_array_equal(loaded.points.points, rpnn_lattice.make_sun_lattice().points)
    weights_folder(tmp_path, monkeypatch, export(make_net("mrpnn-narrow"), CONFIGURATION))
    loaded = network.load_network("test")
    assert loaded.anisotropy_range == (-0.3, 0.95) and loaded.albedo_range == (0.0, 1.0)
    assert loaded.points.digest == load_stencil().digest


def test_stencil_points_of_another_network_are_refused(tmp_path, monkeypatch):
    stencil, lattice = load_stencil(), rpnn_lattice.make_sun_lattice()
    moved = {
        "mrpnn-paper": Stencil(stencil.low * 1.01, stencil.high),
        "rpnn": rpnn_lattice.SunLattice(lattice.points * 1.01),
    }
    for name, points in moved.items():
        net = make_net(name)
        model = export(net, CONFIGURATION)
        for entry in model.metadata_props:
            if entry.key == "points_sha256":
                entry.value = points.digest
        weights_folder(tmp_path, monkeypatch, model)
        with pytest.raises(SceneError, match=f"their {net.kind} do not belong together"):
            network.load_network("test")


def test_damaged_and_unknown_weights_are_refused(tmp_path, monkeypatch):
    weights_folder(tmp_path, monkeypatch, export(make_net("mrpnn-paper"), CONFIGURATION))
    whole = (tmp_path / "test.onnx").read_bytes()
    (tmp_path / "test.onnx").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SceneError, match="'test' cannot be read"):
        network.load_network("test")
    with pytest.raises(SceneError, match="available: .*test"):
        network.load_network("nothing")
