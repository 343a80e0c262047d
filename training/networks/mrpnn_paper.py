# SPDX-License-Identifier: GPL-3.0-or-later
"""MRPNN as A.5 defines it."""

import torch
from torch import nn

from inference.features.stencil import LAYER_POINTS, LOW_LAYERS

from .layers import ChannelLinear, Excitation, block_graph, run_blocks
from .stencil_network import StencilNetwork

LOW, HIGH = LAYER_POINTS[LOW_LAYERS - 1], LAYER_POINTS[-1]


class MRPNN(StencilNetwork):
    """Eqs. 4 to 13."""

    name = "mrpnn-paper"

    def __init__(self):
        super().__init__()
        self.blocks = nn.ModuleList(ChannelLinear(n, n) for n in LAYER_POINTS)
        self.excitations = nn.ModuleList(Excitation(8, 8, 3) for _ in LAYER_POINTS)
        self.low_latent = ChannelLinear(LOW, LOW)
        self.high_latent = ChannelLinear(HIGH, HIGH)
        self.albedo_excitation = Excitation(6 * len(LAYER_POINTS) + 3, 16, 6)

    def feature_stage(self, features, anisotropy, gamma):
        """features (3, N, 192) -> latents (3, N, 32), (3, N, 8) and pooled values (N, 72)."""
        angles = torch.stack([anisotropy, gamma], dim=1)
        pooled = []

        def block(i, f, o):
            # Eq. 4: means, then maxima, of the three channels.
            pooled.append(torch.cat([f.mean(dim=2), f.amax(dim=2)]).T)
            weights = self.excitations[i](torch.cat([pooled[-1], angles], dim=1))
            scaled = f * weights.T.unsqueeze(2)
            return torch.relu(self.blocks[i](scaled if o is None else scaled + o))

        low, high = run_blocks(features, block)
        return torch.relu(self.low_latent(low)), torch.relu(self.high_latent(high)), torch.cat(pooled, dim=1)

    def fuse(self, latents, albedo, anisotropy, gamma):
        """Eqs. 11 and 12: the latents scaled by what albedo, G and gamma ask for, (N, 120)."""
        h1, h2, pooled = latents
        e = torch.cat([pooled, torch.stack([albedo, anisotropy, gamma], dim=1)], dim=1)
        weights = self.albedo_excitation(e).T.unsqueeze(2)
        return torch.cat([*(weights[:3] * h1), *(weights[3:] * h2)], dim=1)

    def feature_graph(self, g, parts, angles):
        pooled = []

        def block(i, f, o):
            mean = g.op("ReduceMean", f, axes=[2], keepdims=0)
            largest = g.op("ReduceMax", f, axes=[2], keepdims=0)
            pooled.append(g.op("Transpose", g.concat([mean, largest], axis=0), perm=[1, 0]))
            weights = g.excitation(g.concat([pooled[-1], angles], axis=1), self.excitations[i])
            weights = g.reshape(g.op("Transpose", weights, perm=[1, 0]), (3, -1, 1))
            scaled = g.op("Mul", f, weights)
            return g.relu(g.channel_linear(scaled if o is None else g.op("Add", scaled, o), self.blocks[i]))

        low, high = block_graph(g, parts, block)
        h1 = g.channels_last(g.relu(g.channel_linear(low, self.low_latent)), 3 * LOW)
        h2 = g.channels_last(g.relu(g.channel_linear(high, self.high_latent)), 3 * HIGH)
        return [(h1, 3 * LOW), (h2, 3 * HIGH), (g.concat(pooled, axis=1), 6 * len(parts))]

    def fuse_graph(self, g, rows, albedo, anisotropy, gamma):
        h1, h2, pooled = rows
        weights = g.excitation(g.concat([pooled, albedo, anisotropy, gamma], axis=1), self.albedo_excitation)
        low, high = g.split(g.reshape(weights, (-1, 6, 1)), (3, 3), axis=1)
        low = g.op("Mul", g.reshape(h1, (-1, 3, LOW)), low)
        high = g.op("Mul", g.reshape(h2, (-1, 3, HIGH)), high)
        return g.concat([g.reshape(low, (-1, 3 * LOW)), g.reshape(high, (-1, 3 * HIGH))], axis=1)
