# SPDX-License-Identifier: GPL-3.0-or-later
"""MRPNN-Narrow of A.6: MRPNN without squeeze-and-excitation; the sub-networks meet in the albedo stage."""

import torch
from torch import nn

from inference.features.stencil import LAYER_POINTS, LOW_LAYERS

from .layers import ChannelLinear, block_graph, run_blocks
from .stencil_network import StencilNetwork

LOW, HIGH = LAYER_POINTS[LOW_LAYERS - 1], LAYER_POINTS[-1]


class MRPNNNarrow(StencilNetwork):
    """Eqs. 14 and 15."""

    name = "mrpnn-narrow"

    def __init__(self):
        super().__init__()
        self.blocks = nn.ModuleList(ChannelLinear(n, n) for n in LAYER_POINTS)
        self.low_latent = ChannelLinear(LOW, LOW)
        self.high_latent = ChannelLinear(HIGH, HIGH)

    def feature_stage(self, features, anisotropy, gamma):
        """features (3, N, 192) -> latents (N, 120)."""

        def block(i, f, o):
            return torch.relu(self.blocks[i](f if o is None else o + f))

        low, high = run_blocks(features, block)
        return torch.cat([*torch.relu(self.low_latent(low)), *torch.relu(self.high_latent(high))], dim=1)

    def fuse(self, latents, albedo, anisotropy, gamma):
        return latents

    def feature_graph(self, g, parts, angles):
        def block(i, f, o):
            return g.relu(g.channel_linear(f if o is None else g.op("Add", o, f), self.blocks[i]))

        low, high = block_graph(g, parts, block)
        h1 = g.channels_last(g.relu(g.channel_linear(low, self.low_latent)), 3 * LOW)
        h2 = g.channels_last(g.relu(g.channel_linear(high, self.high_latent)), 3 * HIGH)
        return [(g.concat([h1, h2], axis=1), 3 * (LOW + HIGH))]

    def fuse_graph(self, g, rows, albedo, anisotropy, gamma):
        return rows[0]
