# SPDX-License-Identifier: GPL-3.0-or-later
"""MRPNN-Wide of A.6: fully connected layers over all three features of a stencil layer."""

import torch
from torch import nn

from inference.features.stencil import LAYER_POINTS, LOW_LAYERS

from .layers import CHANNELS, block_graph, run_blocks
from .stencil_network import StencilNetwork

LOW, HIGH = LAYER_POINTS[LOW_LAYERS - 1], LAYER_POINTS[-1]


def _joined(x):
    """(3, N, k) to (N, 3 k): eq. 16's concatenation."""
    return x.transpose(0, 1).flatten(1)


class MRPNNWide(StencilNetwork):
    """Eqs. 16 to 20.

    Where the next layer has twice the points, outputs and features are concatenated channel by channel, so
    that each feature is added to the same feature of the next layer.
    """

    name = "mrpnn-wide"

    def __init__(self):
        super().__init__()
        self.blocks = nn.ModuleList(nn.Linear(CHANNELS * n, CHANNELS * n) for n in LAYER_POINTS)
        self.low_latent = nn.Linear(CHANNELS * LOW, CHANNELS * LOW)
        self.high_latent = nn.Linear(CHANNELS * HIGH, CHANNELS * HIGH)

    def feature_stage(self, features, anisotropy, gamma):
        """features (3, N, 192) -> latents (N, 120)."""

        def block(i, f, o):
            h = torch.relu(self.blocks[i](_joined(f if o is None else o + f)))
            return h.unflatten(1, (CHANNELS, -1)).transpose(0, 1)

        low, high = run_blocks(features, block)
        h1, h2 = self.low_latent(_joined(low)), self.high_latent(_joined(high))
        return torch.relu(torch.cat([h1, h2], dim=1))

    def fuse(self, latents, albedo, anisotropy, gamma):
        return latents

    def feature_graph(self, g, parts, angles):
        def block(i, f, o):
            joined = g.channels_last(f if o is None else g.op("Add", o, f), CHANNELS * LAYER_POINTS[i])
            h = g.reshape(g.relu(g.linear(joined, self.blocks[i])), (-1, CHANNELS, LAYER_POINTS[i]))
            return g.op("Transpose", h, perm=[1, 0, 2])

        low, high = block_graph(g, parts, block)
        h1 = g.linear(g.channels_last(low, CHANNELS * LOW), self.low_latent)
        h2 = g.linear(g.channels_last(high, CHANNELS * HIGH), self.high_latent)
        return [(g.relu(g.concat([h1, h2], axis=1)), CHANNELS * (LOW + HIGH))]

    def fuse_graph(self, g, rows, albedo, anisotropy, gamma):
        return rows[0]
