# SPDX-License-Identifier: GPL-3.0-or-later
"""The networks in PyTorch: their structure according to A.5, A.6 and the method, and their inputs."""

import numpy as np
import pytest
import torch

from inference.features.stencil import LOW_POINTS
from inference.paper.phase_features import PhaseFeatures
from training.data.stencil import load_stencil
from training.networks import MRPNN, RPNN, MRPNNNarrow, MRPNNWide
from training.rpnn.rpnn_lattice import LEVELS, POINTS, SHAPE

COUNT = 9


@pytest.fixture
def stencil_inputs():
    random = torch.Generator().manual_seed(1)
    features = torch.rand(3, COUNT, 192, generator=random)
    return features, torch.full((COUNT,), 0.6), torch.rand(COUNT, generator=random) * 3.0


def parameters(net):
    return sum(p.numel() for p in net.parameters())


def test_sizes_follow_from_the_definitions():
    """A.5 gives about 50 thousand; Narrow lacks the SE modules' weights; Wide is considerably larger."""
    assert 45_000 < parameters(MRPNN()) < 55_000
    excitations = 12 * (8 * 8 + 8 * 3) + 75 * 16 + 16 * 6
    assert parameters(MRPNN()) - parameters(MRPNNNarrow()) == excitations
    layers = [3 * n for n in (8, 8, 16, 16, 16, 32, 32, 32, 8, 8, 8, 8)] + [3 * 32, 3 * 8]
    narrow_layers = sum(3 * (n // 3) * (n // 3 + 1) for n in layers)
    assert parameters(MRPNNWide()) - parameters(MRPNNNarrow()) == sum(n * (n + 1) for n in layers) - narrow_layers
    block = 226 * 200 + 200 + 200 * 200 + 200
    assert parameters(RPNN()) == 10 * block + 9 * 200 * 200 + 2 * (200 * 200 + 200) + 201


def test_channels_mix_in_the_feature_stage_except_in_narrow(stencil_inputs):
    """Changing the transmittance changes the density's latents, except in Narrow."""
    features, *angles = stencil_inputs
    changed = features.clone()
    changed[1] = 1.0 - changed[1]
    torch.manual_seed(0)
    paper, narrow, wide = MRPNN(), MRPNNNarrow(), MRPNNWide()
    density = slice(0, 32)
    with torch.no_grad():
        one, other = (narrow.feature_stage(f, *angles) for f in (features, changed))
        assert torch.equal(one[:, density], other[:, density]) and not torch.equal(one, other)
        one, other = (paper.feature_stage(f, *angles)[0][0] for f in (features, changed))
        assert not torch.equal(one, other)
        one, other = (wide.feature_stage(f, *angles) for f in (features, changed))
        assert not torch.equal(one[:, density], other[:, density])


@pytest.mark.parametrize("network", [MRPNN, MRPNNNarrow, MRPNNWide])
def test_low_and_high_frequencies_stay_separate(network, stencil_inputs):
    """The points towards the sun reach the high-frequency latents only."""
    features, *angles = stencil_inputs
    changed = features.clone()
    changed[:, :, LOW_POINTS:] *= 0.5
    torch.manual_seed(0)
    net = network()
    with torch.no_grad():
        one, other = (net.feature_stage(f, *angles) for f in (features, changed))
    if network is MRPNN:
        assert torch.equal(one[0], other[0]) and not torch.equal(one[1], other[1])
    else:
        assert torch.equal(one[:, :96], other[:, :96]) and not torch.equal(one[:, 96:], other[:, 96:])


def test_narrow_follows_equation_14(stencil_inputs):
    """The high-frequency sub-network of one channel, by hand."""
    features, *angles = stencil_inputs
    torch.manual_seed(0)
    net = MRPNNNarrow()
    o = torch.zeros(COUNT, 8)
    with torch.no_grad():
        for i in range(8, 12):
            f = features[2, :, LOW_POINTS + 8 * (i - 8) : LOW_POINTS + 8 * (i - 7)]
            o = torch.relu((o + f) @ net.blocks[i].weight[2] + net.blocks[i].bias[2]) + f
        expected = torch.relu(o @ net.high_latent.weight[2] + net.high_latent.bias[2])
        latents = net.feature_stage(features, *angles)
    torch.testing.assert_close(latents[:, 112:], expected)


def test_rpnn_follows_its_definition():
    torch.manual_seed(0)
    net = RPNN().double().eval()
    lattice, gamma = torch.rand(COUNT, LEVELS, POINTS).double(), torch.rand(COUNT).double()
    o = torch.zeros(COUNT, 200).double()
    with torch.no_grad():
        for k in range(LEVELS):
            sigma = torch.cat([lattice[:, k], gamma[:, None]], dim=1)
            carried = o @ net.carry[k - 1].weight.T if k else 0.0
            inner = torch.relu(sigma @ net.describe[k].weight.T + net.describe[k].bias + carried)
            o = torch.relu(o + inner @ net.update[k].weight.T + net.update[k].bias)
        for layer in net.head:
            o = layer(torch.relu(o) if layer is not net.head[0] else o)
        radiance = net(lattice, gamma, torch.ones(1, COUNT))
        seen_both_ways = net.train()(lattice, gamma, torch.ones(1, COUNT))
        mirror = lattice.reshape(COUNT, LEVELS, *SHAPE).flip(3).reshape(lattice.shape)
        mirrored = net.eval()(mirror, gamma, torch.ones(1, COUNT))
    torch.testing.assert_close(radiance, torch.exp(o).T)
    torch.testing.assert_close(seen_both_ways[:, 1::2], radiance[:, 1::2])
    torch.testing.assert_close(seen_both_ways[:, ::2], mirrored[:, ::2])


def test_inputs_include_the_phase_feature():
    """P of every row follows its own G and gamma; mu and S are the file's."""
    random = torch.Generator().manual_seed(2)
    data = {
        "features": torch.rand(40, 2, 192, generator=random).half(),
        "anisotropy": torch.tensor([0.0, 0.5, -0.285, 0.857] * 10),
        "gamma": torch.rand(40, generator=random) * np.pi,
    }
    rows = torch.tensor([3, 0, 17, 17, 38, 6])
    features, anisotropy, gamma = MRPNN.inputs(data, rows)
    assert features.shape == (3, 6, 192) and features.dtype == torch.float32
    torch.testing.assert_close(features[:2], data["features"][rows].float().transpose(0, 1))
    stencil = load_stencil()
    for column, row in enumerate(rows.tolist()):
        assert anisotropy[column] == data["anisotropy"][row] and gamma[column] == data["gamma"][row]
        expected = PhaseFeatures(stencil, float(data["anisotropy"][row]))(data["gamma"][row : row + 1].numpy())
        np.testing.assert_allclose(features[2, column].numpy(), expected[0], atol=1e-5)
