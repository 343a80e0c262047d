"""The exported network on onnxruntime against PyTorch, and weights files that are not right."""

import numpy as np
import pytest
import torch

from inference import network
from inference.scene import SceneError
from inference.stencil import Stencil, make_stencil
from training.export import export, save
from training.networks import MRPNN

CONFIGURATION = {"anisotropy_range": [-0.3, 0.95], "sigma_hat_range": [1, 2000]}


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(3)
    return MRPNN()


def weights_folder(folder, monkeypatch, model):
    save(model, str(folder / "test.onnx"))
    monkeypatch.setattr(network, "WEIGHTS", folder)


def test_parameters_are_the_papers(net):
    """A.5 gives about 50 thousand parameters, and a 128-vector before the reduction."""
    assert 45_000 < sum(p.numel() for p in net.parameters()) < 55_000


def test_onnxruntime_equals_pytorch(net, tmp_path, monkeypatch):
    weights_folder(tmp_path, monkeypatch, export(net, make_stencil(), CONFIGURATION))
    loaded = network.load_network("test")
    random = np.random.default_rng(4)
    features = random.random((3, 77, 192), np.float32)
    gamma = random.uniform(0, np.pi, 77).astype(np.float32)
    albedos = np.array([0.0, 0.3, 1.0], np.float32)
    with torch.no_grad():
        expected = net(
            torch.from_numpy(features),
            torch.full((77,), 0.857),
            torch.from_numpy(gamma),
            torch.from_numpy(np.repeat(albedos[:, None], 77, axis=1)),
        ).numpy()
    result = loaded.multiple(features, 0.857, gamma, albedos)
    np.testing.assert_allclose(result, expected, rtol=1e-5, atol=1e-12)
    assert np.all(result[0] == 0.0) and np.all(result[1:] > 0.0)
    # A point's result does not depend on its neighbours in the batch.
    one = loaded.multiple(np.ascontiguousarray(features[:, 5:6]), 0.857, gamma[5:6], albedos)
    np.testing.assert_allclose(one[:, 0], result[:, 5], rtol=1e-5)


def test_a_stencil_that_does_not_belong_is_refused(net, tmp_path, monkeypatch):
    stencil = make_stencil()
    model = export(net, stencil, CONFIGURATION)
    moved = Stencil(stencil.low * 1.01, stencil.high)
    for entry in model.metadata_props:
        if entry.key == "stencil_sha256":
            entry.value = moved.digest
    weights_folder(tmp_path, monkeypatch, model)
    with pytest.raises(SceneError, match="do not belong together"):
        network.load_network("test")


def test_damaged_and_unknown_weights_are_refused(net, tmp_path, monkeypatch):
    weights_folder(tmp_path, monkeypatch, export(net, make_stencil(), CONFIGURATION))
    whole = (tmp_path / "test.onnx").read_bytes()
    (tmp_path / "test.onnx").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SceneError, match="'test' cannot be read"):
        network.load_network("test")
    with pytest.raises(SceneError, match="available: test"):
        network.load_network("nothing")
