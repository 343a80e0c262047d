# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers of the paper's stencil networks.

A block's features are tensors (3, N, k), channels mu, S, P first: one batched product serves three sub-networks with
weights of their own.
"""

import math

import torch
from torch import nn

from inference.features.stencil import LAYER_POINTS, LOW_LAYERS

CHANNELS = 3
#: Last blocks of the low- and of the high-frequency sub-network.
LAST_BLOCKS = (LOW_LAYERS - 1, len(LAYER_POINTS) - 1)
#: Blocks whose output is a concatenation, since the next layer has twice their points (footnote 2).
WIDENING_BLOCKS = tuple(i for i, n in enumerate(LAYER_POINTS[:-1]) if i not in LAST_BLOCKS and LAYER_POINTS[i + 1] != n)


class ChannelLinear(nn.Module):
    """A fully connected layer per channel: (3, N, in) to (3, N, out)."""

    def __init__(self, inputs: int, outputs: int):
        super().__init__()
        bound = 1.0 / math.sqrt(inputs)
        self.weight = nn.Parameter(torch.empty(CHANNELS, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(CHANNELS, 1, outputs).uniform_(-bound, bound))

    def forward(self, x):
        return torch.baddbmm(self.bias, x, self.weight)


class Excitation(nn.Module):
    """SE_ex of eq. 5: two layers without bias, ReLU, then a sigmoid."""

    def __init__(self, inputs: int, hidden: int, outputs: int):
        super().__init__()
        self.squeeze = nn.Linear(inputs, hidden, bias=False)
        self.excite = nn.Linear(hidden, outputs, bias=False)

    def forward(self, e):
        return torch.sigmoid(self.excite(torch.relu(self.squeeze(e))))


def run_blocks(features, block):
    """Both sub-networks' last outputs: (3, N, 32) and (3, N, 8).

    features: (3, N, 192). block(i, f, o): activated output (3, N, n) of block i for its layer's features f (3, N, n)
    and its predecessor's output o, None for the first block of a sub-network. The result and f become the next o by
    eq. 7's sum or footnote 2's concatenation.
    """
    outputs, o = [], None
    for i, f in enumerate(features.split(LAYER_POINTS, dim=2)):
        h = block(i, f, o)
        o = torch.cat([h, f], dim=2) if i in WIDENING_BLOCKS else h + f
        if i in LAST_BLOCKS:
            outputs.append(o)
            o = None
    return outputs


def block_graph(g, parts, block):
    """As `run_blocks`, in an ONNX graph; parts: names of the twelve layers' features."""
    outputs, o = [], None
    for i, f in enumerate(parts):
        h = block(i, f, o)
        o = g.concat([h, f], axis=2) if i in WIDENING_BLOCKS else g.op("Add", h, f)
        if i in LAST_BLOCKS:
            outputs.append(o)
            o = None
    return outputs
